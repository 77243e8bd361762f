"""Files that are whole or not there: atomic writes, and a SHA-256 of each in its folder's SHA256SUMS.

SHA256SUMS has the format of the command `sha256sum`, which can check a folder too.
"""

import csv
import hashlib
import io
import json
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

SUMS = "SHA256SUMS"
TEMPORARY = re.compile(r"\.(.+)\.\d+\.tmp")  # .NAME.PROCESS.tmp, what is to become the file NAME


class DamagedFile(Exception):
    """A file that is not what was written; its text names the file and the remedy."""


def write_atomically(path: Path, data: bytes, *, checked: bool = True) -> str:
    """Write a file so that its name only ever stands for a whole one; returns its SHA-256.

    With `checked` its digest enters the folder's SHA256SUMS. Raises OSError, naming `path`, and leaves the old file.
    """
    path = Path(path)
    write_together(path.parent, {path.name: data}, checked=checked)
    return _digest(data)


def write_together(folder: Path, files: dict[str, bytes], beside: Iterable[str] = (), *, checked: bool = True) -> None:
    """Write files of one folder by name, in their order: temporary file, fsync, rename.

    With `checked` their digests, and those of the files `beside` that are there already, enter SHA256SUMS in one step
    before the first rename: a crash in between leaves a digest without its file, never a file without its digest.
    """
    temporary = {name: folder / f".{name}.{os.getpid()}.tmp" for name in files}
    try:
        for name, data in files.items():
            with _naming(folder / name), open(temporary[name], "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        if checked:
            sums = {name: digest_of(folder / name) for name in beside}
            _write_sums(folder, read_sums(folder) | sums | {name: _digest(data) for name, data in files.items()})
        for name in files:
            with _naming(folder / name):
                os.replace(temporary[name], folder / name)
    except BaseException:
        for path in temporary.values():
            with suppress(OSError):  # of a file system that cannot be written to, whose error is on its way
                path.unlink()
        raise
    _sync_folder(folder)


def write_text(path: Path, text: str) -> None:
    """Write a user's text file, whole or as it was; raises OSError, naming it."""
    write_atomically(path, text.encode(), checked=False)


def append(path: Path, data: bytes) -> None:
    """Add bytes at the end of a file; raises OSError, naming it, and DamagedFile where it is no regular file."""
    with _naming(path), open(regular(path), "ab") as file:
        file.write(data)


def remove_checked(paths: list[Path]) -> None:
    """Remove files of one folder, and their digests before them: a crash in between leaves unlisted files."""
    if paths:
        unlist({path.name for path in paths}, paths[0].parent)
    for path in paths:
        path.unlink(missing_ok=True)


def unlist(names: set[str], folder: Path) -> None:
    """Remove files' digests from a folder's SHA256SUMS."""
    sums = read_sums(folder)
    if names & set(sums):
        _write_sums(folder, {name: digest for name, digest in sums.items() if name not in names})


def read_checked(path: Path) -> bytes:
    """A file's bytes, held to its folder's SHA256SUMS; raises DamagedFile where they differ or no digest is known."""
    path = Path(path)
    if path.name not in read_sums(path.parent):
        raise DamagedFile(
            f"{path} has no SHA-256 in {path.with_name(SUMS)}, so it cannot be trusted; put back the whole folder"
        )
    return read_listed(path)


def read_listed(path: Path) -> bytes:
    """A file's bytes, held to its folder's SHA256SUMS if it is listed there; raises DamagedFile where they differ.

    Runs of earlier versions do not list their tables.
    """
    path = Path(path)
    expected = read_sums(path.parent).get(path.name)
    data = read_regular(path)
    if expected is not None and _digest(data) != expected:
        raise DamagedFile(f"{path} is damaged: its SHA-256 is not the one in {path.with_name(SUMS)}; put back a copy")
    return data


def read_sums(folder: Path) -> dict[str, str]:
    """Digests by file name from a folder's SHA256SUMS; empty where there is none. Raises DamagedFile."""
    path = Path(folder) / SUMS
    try:
        lines = read_regular(path).decode().split("\n")
    except FileNotFoundError:
        return {}
    except UnicodeDecodeError:
        raise DamagedFile(f"{path} is damaged: it is not text; put back a copy") from None
    pairs = [line.split("  ", 1) for line in lines]
    return {pair[1]: pair[0] for pair in pairs if len(pair) == 2}


def _write_sums(folder: Path, sums: dict[str, str]) -> None:
    text = "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items()))
    write_together(folder, {SUMS: text.encode()}, checked=False)


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Let every OSError name this file, instead of a temporary one or (where the disk is full) no file."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


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
    with open(regular(path), "rb") as file:
        return file.read(most)


def regular(path: Path) -> Path:
    """The path; raises DamagedFile where it is a folder, a pipe or a device."""
    path = Path(path)
    if path.exists() and not path.is_file():  # a pipe would be waited for, and a device may have no end
        raise DamagedFile(f"{path} is not a regular file, but a folder, a pipe or a device; name a file")
    return path


def digest_of(path: Path) -> str:
    """A file's SHA-256."""
    return _digest(read_regular(path))


def json_object(text: str | bytes) -> dict[str, Any]:
    """The object that a JSON text holds; raises ValueError where it holds none."""
    try:
        found = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        raise ValueError("it is not JSON") from None
    if not isinstance(found, dict):
        raise ValueError("it is not a JSON object")
    return found


def read_table(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file, as `read_listed`, by their headings; raises ValueError where a row does not fit them."""
    try:
        rows = list(csv.DictReader(io.StringIO(read_listed(path).decode(), newline="")))
    except csv.Error as error:
        raise ValueError(str(error)) from None
    if any(None in row or None in row.values() for row in rows):
        raise ValueError("a row has not a field for each heading")
    return rows


def csv_text(rows: list[dict[str, Any]], header: bool = True) -> str:
    """Rows as CSV, with their keys as the first line."""
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        if header:
            writer.writeheader()
        writer.writerows(rows)
    return text.getvalue()
