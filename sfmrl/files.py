"""Files that are whole or not there: atomic writes, and a SHA-256 of each in its folder's SHA256SUMS.

SHA256SUMS has the format of the command `sha256sum`, which can check a folder too.
"""

import csv
import hashlib
import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

SUMS = "SHA256SUMS"


class DamagedFile(Exception):
    """A file that is not what was written; its text names the file and the remedy."""


def write_atomically(path: Path, write: Callable[[BinaryIO], None], *, checked: bool = True) -> str:
    """Write a file so that its name only ever stands for a whole one; returns its SHA-256.

    Temporary file in the same folder, fsync, rename. With `checked` its digest enters the folder's SHA256SUMS first:
    a crash in between leaves a digest without a file, never a file without a digest.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "w+b") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
            file.seek(0)
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        if checked:
            sums = read_sums(path.parent) | {path.name: digest}
            text = "".join(f"{value}  {name}\n" for name, value in sorted(sums.items())).encode()
            write_atomically(path.with_name(SUMS), lambda file: file.write(text), checked=False)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    _sync_folder(path.parent)
    return digest


def read_checked(path: Path) -> bytes:
    """A file's bytes, held to its folder's SHA256SUMS; raises DamagedFile where they differ or no digest is known."""
    path = Path(path)
    expected = read_sums(path.parent).get(path.name)
    if expected is None:
        raise DamagedFile(f"{path} has no SHA-256 in {path.with_name(SUMS)}, so it cannot be trusted")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != expected:
        raise DamagedFile(f"{path} is damaged: its SHA-256 is not the one in {path.with_name(SUMS)}")
    return data


def read_sums(folder: Path) -> dict[str, str]:
    """Digests by file name from a folder's SHA256SUMS; empty where there is none."""
    try:
        lines = (Path(folder) / SUMS).read_text().splitlines()
    except FileNotFoundError:
        return {}
    pairs = [line.split("  ", 1) for line in lines]
    return {pair[1]: pair[0] for pair in pairs if len(pair) == 2}


def _sync_folder(folder: Path) -> None:
    """Make a rename last through a power cut, where the system can."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def csv_text(rows: list[dict[str, Any]], header: bool = True) -> str:
    """Rows as CSV, with their keys as the first line."""
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        if header:
            writer.writeheader()
        writer.writerows(rows)
    return text.getvalue()
