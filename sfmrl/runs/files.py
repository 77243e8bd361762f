"""Write files atomically, keep their SHA-256 digests in the folder's SHA256SUMS, and check them when they are read.

SHA256SUMS has the format of the command `sha256sum`, which can check a folder, too.
"""

import csv
import hashlib
import io
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

SUMS = "SHA256SUMS"
TEMPORARY = re.compile(r"\.(.+)\.\d+\.tmp")  # .NAME.PROCESS.tmp, which is renamed to NAME once it is written


class DamagedFile(Exception):
    """A file is not what was written; the text names the file and the remedy."""


def write_atomically(path: Path, data: bytes, *, checked: bool = True) -> str:
    """Write a file that never exists under its name in part; returns its SHA-256.

    With `checked`, its digest enters the folder's SHA256SUMS. Raises OSError, naming `path`; the old file then stays.
    """
    path = Path(path)
    write_together(path.parent, {path.name: data}, checked=checked)
    return _digest(data)


def write_together(folder: Path, files: dict[str, bytes], beside: Iterable[str] = (), *, checked: bool = True) -> None:
    """Write files, by name, to one folder: first temporary files and fsync, then renames in the order of `files`.

    With `checked`, their digests, and those of the existing files `beside`, enter SHA256SUMS in one step before the
    first rename: a crash in between leaves a digest without its file, never a file without its digest.
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
            with suppress(OSError):  # on a read-only file system, where the first error says more
                path.unlink()
        raise
    _sync_folder(folder)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, without a digest; raises OSError, naming it."""
    write_atomically(path, text.encode(), checked=False)


def append(path: Path, data: bytes) -> None:
    """Add bytes to the end of a file; raises OSError, naming it, and DamagedFile if it is not a regular file."""
    with _naming(path), open(regular(path), "ab") as file:
        file.write(data)


def remove_checked(paths: list[Path]) -> None:
    """Remove files of one folder, after their digests: a crash in between leaves files without digests."""
    if paths:
        unlist({path.name for path in paths}, paths[0].parent)
    for path in paths:
        path.unlink(missing_ok=True)


def unlist(names: set[str], folder: Path) -> None:
    """Remove the digests of these files from a folder's SHA256SUMS."""
    sums = read_sums(folder)
    if names & set(sums):
        _write_sums(folder, {name: digest for name, digest in sums.items() if name not in names})


def read_checked(path: Path) -> bytes:
    """Read a file whose digest must be in the folder's SHA256SUMS; raises DamagedFile if it is not, or differs."""
    path = Path(path)
    if path.name not in read_sums(path.parent):
        raise DamagedFile(
            f"{path} has no SHA-256 in {path.with_name(SUMS)}, so it cannot be trusted; put back the whole folder"
        )
    return read_listed(path)


def read_listed(path: Path) -> bytes:
    """Read a file; raises DamagedFile if SHA256SUMS lists it with another digest.

    It need not be listed: runs of earlier versions do not list their tables.
    """
    path = Path(path)
    expected = read_sums(path.parent).get(path.name)
    data = read_regular(path)
    if expected is not None and _digest(data) != expected:
        raise DamagedFile(f"{path} is damaged: its SHA-256 is not the one in {path.with_name(SUMS)}; put back a copy")
    return data


def read_sums(folder: Path) -> dict[str, str]:
    """Read the digests in a folder's SHA256SUMS by file name; empty if there is no such file. Raises DamagedFile."""
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
    """Make every OSError name `path`: it would name a temporary file or, when the disk is full, none."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _sync_folder(folder: Path) -> None:
    """Make renames survive a power cut, where the system can."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def read_regular(path: Path) -> bytes:
    """Read a file; raises DamagedFile if it is a folder, a pipe or a device."""
    return regular(path).read_bytes()


def regular(path: Path) -> Path:
    """The path; raises DamagedFile if it is a folder, a pipe or a device."""
    path = Path(path)
    if path.exists() and not path.is_file():  # opening a pipe would block, and a device may never end
        raise DamagedFile(f"{path} is not a regular file, but a folder, a pipe or a device; name a file")
    return path


def digest_of(path: Path) -> str:
    """The SHA-256 of a file."""
    return _digest(read_regular(path))


def read_table(path: Path) -> list[dict[str, str]]:
    """Read the rows of a CSV file by heading, as `read_listed` does; raises ValueError if a row does not fit them."""
    try:
        rows = list(csv.DictReader(io.StringIO(read_listed(path).decode(), newline="")))
    except csv.Error as error:
        raise ValueError(str(error)) from None
    if any(None in row or None in row.values() for row in rows):
        raise ValueError("a row has not a field for each heading")
    return rows


def csv_text(rows: list[dict[str, Any]], header: bool = True) -> str:
    """Write rows as CSV text; the header is the keys of the first row."""
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        if header:
            writer.writeheader()
        writer.writerows(rows)
    return text.getvalue()
