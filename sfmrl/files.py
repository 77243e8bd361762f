"""Files that are whole or not there: atomic writes, and a SHA-256 of each in its folder's SHA256SUMS.

SHA256SUMS has the format of the command `sha256sum`, which can check a folder too.
"""

import csv
import hashlib
import io
import json
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
            _write_sums(path.parent, read_sums(path.parent) | {path.name: digest})
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    _sync_folder(path.parent)
    return digest


def remove_checked(paths: list[Path]) -> None:
    """Remove files of one folder, and their digests."""
    for path in paths:
        path.unlink(missing_ok=True)
    if paths:
        gone = {path.name for path in paths}
        sums = read_sums(paths[0].parent)
        _write_sums(paths[0].parent, {name: digest for name, digest in sums.items() if name not in gone})


def read_checked(path: Path) -> bytes:
    """A file's bytes, held to its folder's SHA256SUMS; raises DamagedFile where they differ or no digest is known."""
    path = Path(path)
    expected = read_sums(path.parent).get(path.name)
    if expected is None:
        raise DamagedFile(
            f"{path} has no SHA-256 in {path.with_name(SUMS)}, so it cannot be trusted; put back the whole folder"
        )
    data = read_regular(path)
    if hashlib.sha256(data).hexdigest() != expected:
        raise DamagedFile(f"{path} is damaged: its SHA-256 is not the one in {path.with_name(SUMS)}; put back a copy")
    return data


def read_sums(folder: Path) -> dict[str, str]:
    """Digests by file name from a folder's SHA256SUMS; empty where there is none. Raises DamagedFile."""
    path = Path(folder) / SUMS
    try:
        lines = read_regular(path).decode().splitlines()
    except FileNotFoundError:
        return {}
    except UnicodeDecodeError:
        raise DamagedFile(f"{path} is damaged: it is not text; put back a copy") from None
    pairs = [line.split("  ", 1) for line in lines]
    return {pair[1]: pair[0] for pair in pairs if len(pair) == 2}


def _write_sums(folder: Path, sums: dict[str, str]) -> None:
    text = "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items())).encode()
    write_atomically(folder / SUMS, lambda file: file.write(text), checked=False)


def _sync_folder(folder: Path) -> None:
    """Make a rename last through a power cut, where the system can."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def read_regular(path: Path, most: int = -1) -> bytes:
    """A file's bytes, or its first `most`; raises DamagedFile where it is a folder, a pipe or a device."""
    path = Path(path)
    if path.exists() and not path.is_file():  # a pipe would be waited for, and a device may have no end
        raise DamagedFile(f"{path} is not a regular file, but a folder, a pipe or a device; name a file")
    with open(path, "rb") as file:
        return file.read(most)


def digest_of(path: Path) -> str:
    """A file's SHA-256."""
    return hashlib.sha256(read_regular(path)).hexdigest()


def json_object(text: str | bytes) -> dict[str, Any]:
    """The object that a JSON text holds; raises ValueError where it holds none."""
    try:
        found = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        raise ValueError("it is not JSON") from None
    if not isinstance(found, dict):
        raise ValueError("it is not a JSON object")
    return found


def csv_text(rows: list[dict[str, Any]], header: bool = True) -> str:
    """Rows as CSV, with their keys as the first line."""
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        if header:
            writer.writeheader()
        writer.writerows(rows)
    return text.getvalue()
