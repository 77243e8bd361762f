"""Find runs, list their files, and tell which are being trained. Imports neither NumPy nor torch."""

import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sfmrl.config import ConfigError, as_typed, json_object
from sfmrl.runs.files import SUMS, TEMPORARY, DamagedFile, read_listed, read_regular, regular

try:
    import fcntl
except ImportError:  # on Windows, where nothing keeps a second process from training the same run
    fcntl = None  # type: ignore[assignment]  # for mypy, a module is never None

RUNS = Path("runs")
KINDS = ("il", "rl")
WEIGHTS = "weights.npz"  # the trained network; the training has finished when this file exists
BEST = "best.npz"  # the network of the best validation
DEMONSTRATIONS = "demonstrations.npz"
MAP = "map.txt"  # the map, if the run trains on one
TABLES = ("metrics.csv", "validation.csv", "test.csv", "result.json")
TESTED = {"validation.csv", "test.csv", "result.json", BEST, "best.pt"}  # what an imitation run does not have
LOCK = ".lock"  # locked by the process that trains the run
CHECKPOINT = re.compile(r"checkpoint-\d{6}\.npz")
FIRST = ("config.json", MAP, "run.json")  # files of a new run, in this order: run.json makes a folder a run
WRITTEN = {*FIRST, *TABLES, WEIGHTS, BEST, DEMONSTRATIONS, SUMS, "weights.pt", "best.pt"}  # .pt: before version 0.3


def run_folders(kind: str | None = None) -> list[Path]:
    """The folders under runs/ that hold a run (of this kind), newest first."""
    return [folder for folder in newest_first() if kind_of(folder) in ([kind] if kind else KINDS)]


def newest_run(say: Callable[[str], None]) -> Path:
    """The newest finished run under runs/; raises ConfigError if there is none.

    A folder with a damaged run.json is skipped, and named by `say` unless it is older than the run returned.
    """
    for folder in filter(finished, newest_first()):
        try:
            read_listed(folder / "run.json")
        except (DamagedFile, OSError) as error:
            say(f"{folder} is skipped: {error}")
            continue
        if kind_of(folder):
            return folder
    raise ConfigError("there is no finished run under runs/ yet: type sfmrl il, or name a policy such as orca")


def newest_first(place: Path = RUNS) -> list[Path]:
    """The folders in `place` with a run.json, newest first; one that states no time counts as the newest."""
    folders = [path.parent for path in place.glob("[!.]*/run.json")]
    return sorted(folders, key=lambda folder: (str(facts_of(folder).get("created", "unknown")), folder), reverse=True)


def kind_of(folder: Path) -> str | None:
    """The kind of run that a folder holds, from its run.json; None if it holds none."""
    kind = facts_of(folder).get("kind")
    return kind if kind in KINDS else None


def facts_of(folder: Path) -> dict[str, Any]:
    """The contents of a folder's run.json; empty if there is none that can be read."""
    try:
        return json_object(read_regular(folder / "run.json"))
    except (OSError, ValueError, DamagedFile):
        return {}


def finished(folder: Path) -> bool:
    """Whether the training in a folder has finished."""
    return (folder / WEIGHTS).exists()


def why_unfinished(folder: Path) -> str:
    """Why a run cannot be used yet: it is being trained now, or has stopped; with what to type."""
    if in_training(folder):
        return f"{folder} is being trained now; wait until it is finished"
    return f"{folder} is not finished; resume it: sfmrl {kind_of(folder) or 'rl'} --resume {as_words(folder)}"


def as_words(folder: Path) -> str:
    """A run folder as typed in a shell, with --trust-reward if its reward is the user's own function."""
    try:
        reward = json_object(read_regular(folder / "config.json"))["reward"]["reward"]
    except (OSError, ValueError, LookupError, TypeError, DamagedFile):
        reward = ""  # opening the run reports the error
    name = f"./{folder}" if str(folder).startswith("-") else str(folder)  # a leading "-" would make it an option
    return as_typed([name, "--trust-reward"] if ":" in str(reward) else [name])


def as_options(settings: dict[str, Any]) -> list[str]:
    """Settings, nested as `override` takes them, as the words to type."""
    words = []
    for name, value in settings.items():
        flag = name.replace("_", "-")
        if isinstance(value, dict):
            words += as_options(value)
        elif isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            words += [f"--{flag}", str(value)]
    return words


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes from training in a folder, where the system can; raises ConfigError if one does."""
    with open(regular(folder / LOCK), "a") as lock:
        deadline = time.monotonic() + 0.2  # `in_training`, in another process, holds the lock for a moment
        while fcntl:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > deadline:
                    said = f"{folder} is being trained by another process; wait for it, or stop it"
                    raise ConfigError(said) from None
                time.sleep(0.05)
            except OSError:  # of a file system without locks
                break
        yield


def in_training(folder: Path) -> bool:
    """Whether a process is training the run in a folder; False where the system cannot tell."""
    try:
        with open(regular(folder / LOCK)) as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except (OSError, AttributeError, DamagedFile):
        pass
    return False


def files_of_run(folder: Path) -> list[Path]:
    """The files in a folder that have the names of a run's files, or of its temporary files."""
    names = {path: TEMPORARY.sub(r"\1", path.name) for path in folder.iterdir()}
    written = WRITTEN - TESTED if kind_of(folder) == "il" else WRITTEN
    return [path for path, name in names.items() if name in written or CHECKPOINT.fullmatch(name)]


def leftovers(folder: Path) -> list[Path]:
    """The temporary files of a run that killed processes left in its folder."""
    return [path for path in files_of_run(folder) if TEMPORARY.fullmatch(path.name)]
