"""Write files atomically, list their SHA-256 digests in the folder's SHA256SUMS, and check them on reading.

SHA256SUMS has the format of the command `sha256sum`, so that command can check a folder, too.
"""

import csv
import errno
import hashlib
import io
import os
import re
import shutil
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from sfmrl.config import WINDOWS

SUMS = "SHA256SUMS"
TEMPORARY = re.compile(r"^\.(.+)\.\d+\.tmp$")  # .NAME.PROCESS.tmp, renamed to NAME once it is written


class DamagedFile(Exception):
    """A file is not what was written; the text names the file and the remedy."""


def write_together(folder: Path, files: dict[str, bytes], *, checked: bool = True) -> None:
    """Write files, by name, atomically: first temporary files and fsync, then renames in the order of `files`.

    With `checked`, their digests enter SHA256SUMS in one step before the first rename: a crash leaves a digest without
    its file, never a file without its digest. Raises OSError, naming a file.
    """
    temporary = {name: folder / f".{name}.{os.getpid()}.tmp" for name in files}
    try:
        for name, data in files.items():
            with _naming(folder / name), open(temporary[name], "wb") as file:
                with suppress(FileNotFoundError):
                    shutil.copymode(folder / name, temporary[name])
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        if checked:
            _write_sums(folder, read_sums(folder) | {name: sha256(data) for name, data in files.items()})
        for name in files:
            with _naming(folder / name):
                retried(os.replace, temporary[name], folder / name)
    except BaseException:
        for path in temporary.values():
            with suppress(OSError):  # on a read-only file system, where the first error says more
                path.unlink()
        raise
    if os.name == "posix":  # the renames, too, must survive a power cut
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        except OSError as error:
            if error.errno != errno.EINVAL:  # of file systems that cannot sync a folder, as some network shares
                raise
        finally:
            os.close(descriptor)


def retried(operation: Callable[..., None], *arguments: Any) -> None:
    """Rename or remove a file; on Windows, retry for up to 3 s while another process (a scanner) has it open."""
    deadline = time.monotonic() + 3.0
    while True:
        try:
            return operation(*arguments)
        except PermissionError:
            if not WINDOWS or time.monotonic() > deadline:
                raise
            time.sleep(0.02)


def remove(path: Path) -> None:
    """Remove a file, if it is there."""
    retried(path.unlink, True)


def write_atomically(path: Path, data: bytes, *, checked: bool = True) -> str:
    """Write one file as `write_together` does, and return its SHA-256.

    A symbolic link is replaced if `checked`; otherwise, the file that it names is written.
    """
    if path.is_symlink() and not checked:
        path = Path(os.path.realpath(path))  # resolve() fails on a link to itself
    write_together(path.parent, {path.name: data}, checked=checked)
    return sha256(data)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, without a digest."""
    data = text.encode(errors="backslashreplace")  # names of files need not be UTF-8
    write_atomically(path, data, checked=False)


def remove_checked(paths: list[Path]) -> None:
    """Remove files of one folder, their digests first: a crash leaves files without digests."""
    if paths:
        unlist({path.name for path in paths}, paths[0].parent)
    for path in paths:
        remove(path)


def unlist(names: set[str], folder: Path) -> None:
    """Remove the digests of these files from a folder's SHA256SUMS."""
    sums = read_sums(folder)
    if names & set(sums):
        _write_sums(folder, {name: digest for name, digest in sums.items() if name not in names})


def read_checked(path: Path) -> bytes:
    """Read a file; raises DamagedFile unless it is there, and the folder's SHA256SUMS lists it with its digest."""
    if path.name not in read_sums(path.parent):
        sums = path.with_name(SUMS)
        raise DamagedFile(f"{path} has no SHA-256 in {sums}, so it cannot be trusted; put back the whole folder")
    if not path.exists():
        raise DamagedFile(f"{path} is missing; put it back")
    return read_listed(path)


def read_listed(path: Path) -> bytes:
    """Read a file that need not be listed; raises DamagedFile if SHA256SUMS lists it with another digest."""
    data, listed = read_regular(path), read_sums(path.parent).get(path.name)
    if listed not in (None, sha256(data)):
        raise DamagedFile(f"{path} is damaged: its SHA-256 is not the one in {path.with_name(SUMS)}; put back a copy")
    return data


def read_regular(path: Path) -> bytes:
    """Read a file; raises DamagedFile if it is a folder, a pipe or a device."""
    return regular(path).read_bytes()


def regular(path: Path) -> Path:
    """The path; raises DamagedFile if it is a folder, a pipe or a device."""
    if path.exists() and not path.is_file():  # opening a pipe would block, and a device may never end
        raise DamagedFile(f"{path} is not a regular file, but a folder, a pipe or a device; name a file")
    return path


def read_arrays(data: bytes) -> dict[str, Any]:
    """The arrays in the bytes of an .npz file that numpy.savez wrote; raises ValueError and others for other bytes.

    Such a file is not compressed, so its arrays take no more memory than the file; one that unpacks to more is refused.
    """
    import numpy as np

    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        if sum(part.file_size for part in packed.infolist()) > len(data):
            raise ValueError("it is compressed")
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        return dict(arrays)


def read_sums(folder: Path) -> dict[str, str]:
    """The digests in a folder's SHA256SUMS by file name, empty without that file; raises DamagedFile."""
    path = folder / SUMS
    try:
        lines = read_regular(path).decode().split("\n")
    except FileNotFoundError:
        return {}
    except UnicodeDecodeError:
        raise DamagedFile(f"{path} is damaged: it is not text; put back a copy") from None
    pairs = [line.split("  ", 1) for line in lines]
    return {pair[1]: pair[0] for pair in pairs if len(pair) == 2}


def _write_sums(folder: Path, sums: dict[str, str]) -> None:
    write_text(folder / SUMS, "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items())))


def sha256(data: bytes) -> str:
    """The SHA-256 of bytes, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def digest_of(path: Path) -> str:
    """The SHA-256 of a file."""
    return sha256(read_regular(path))


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Make every OSError name `path`: it would name a temporary file or, on a full disk, none."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def csv_text(rows: list[dict[str, Any]], header: bool = True) -> str:
    """Rows as CSV text; the header is the keys of the first row."""
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        if header:
            writer.writeheader()
        writer.writerows(rows)
    return text.getvalue()


def append_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    """Add rows to the end of a CSV file, which is made if it does not exist."""
    header = not path.exists() or path.stat().st_size == 0
    with _naming(path), open(regular(path), "ab") as file:
        file.write(csv_text(rows, header).encode())


def read_table(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file by heading.

    Raises ValueError if a row does not fit the header, DamagedFile if the file is not what was written.
    """
    try:
        rows = list(csv.DictReader(io.StringIO(read_listed(path).decode(), newline="")))
    except csv.Error as error:
        raise ValueError(str(error)) from None
    if any(None in row or None in row.values() for row in rows):
        raise ValueError("a row does not have a field for each heading")
    return rows
