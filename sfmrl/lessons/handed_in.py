"""Runs that were handed in: folders, or archives, which are unpacked into a temporary folder."""

import tarfile
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import accumulate
from pathlib import Path

from sfmrl.config import ConfigError
from sfmrl.lessons.verify import require_run
from sfmrl.runs.files import DamagedFile, regular
from sfmrl.runs.folders import WEIGHTS
from sfmrl.runs.weights import load_weights

LARGEST = 2**30  # bytes that an archive may unpack to: a run takes some megabytes


@contextmanager
def runs_in(paths: list[Path]) -> Iterator[tuple[dict[str, Path], list[Exception]]]:
    """The run folders at the paths by their names: folders themselves, and those in archives (.zip, .tar, .tar.gz ...).

    Beside them, the errors about paths where there is no run: ConfigError, DamagedFile, OSError.
    """
    with tempfile.TemporaryDirectory() as name:
        runs: dict[str, Path] = {}
        errors: list[Exception] = []
        for number, path in enumerate(paths):
            try:
                runs |= _runs_at(path, Path(name) / str(number))
            except (ConfigError, DamagedFile, OSError) as error:
                errors.append(error)
        yield runs, errors


def _runs_at(path: Path, place: Path) -> dict[str, Path]:
    """The run folder at a path, or those in the archive there, which is unpacked into the folder `place`."""
    if path.is_dir() or not path.exists():
        require_run(path)
        return {str(path): path}
    _unpack(regular(path), place)
    found = sorted(place.rglob("run.json"))
    if not found:
        raise ConfigError(f"{path} holds no run folder; pack one with its run.json")
    return {f"{path}: {run.parent.relative_to(place)}": run.parent for run in found}


def same_weights(folders: dict[str, Path]) -> dict[str, str]:
    """The name of each run that has the weights of an earlier one, and that one's name.

    Copies have the same weights, but so have two runs of the same command, seed and version on like processors. A copy
    in which a single bit of the weights was changed is not found.
    """
    first: dict[bytes, str] = {}
    same = {}
    for name, folder in folders.items():
        with suppress(ConfigError, DamagedFile, OSError):  # which `verify` reports
            network, _ = load_weights(folder / WEIGHTS)  # the file's digest would change with the config in it
            earlier = first.setdefault(network.flat.tobytes(), name)
            if earlier != name:
                same[name] = earlier
    return same


def _unpack(path: Path, folder: Path) -> None:
    """Unpack an archive into an empty folder; members that would leave the folder, links and devices are refused."""
    try:
        if tarfile.is_tarfile(path):  # first: a tar file that holds an .npz looks like a .zip, too
            if not hasattr(tarfile, "data_filter"):
                raise ConfigError(f"unpacking {path} safely needs Python 3.11.4; update Python, or pack a .zip")
            with tarfile.open(path) as tar:
                _check_size(path, (member.size for member in tar))
                tar.extractall(folder, filter="data")
        else:
            with zipfile.ZipFile(path) as packed:
                _check_size(path, (member.file_size for member in packed.infolist()))
                for member in packed.infolist():
                    member.filename = member.filename.replace("\\", "/")  # Windows PowerShell writes \ between folders
                    packed.extract(member, folder)
    except ConfigError:
        raise
    except Exception as error:  # damaged archives can raise anything, such as zlib.error or LZMAError
        raise ConfigError(f"{path} is neither a run folder nor an archive that can be unpacked: {error}") from None


def _check_size(path: Path, sizes: Iterable[int]) -> None:
    """Raise ConfigError once the sizes add up to too much: to read on to the end could take hours."""
    for size in accumulate(sizes):
        if size > LARGEST:
            unpacked = f"{path} would unpack to {size / 2**30:.1f} GiB or more"
            raise ConfigError(f"{unpacked}; pack the run folder alone, a few megabytes")
