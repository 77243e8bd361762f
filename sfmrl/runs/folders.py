"""Run folders by what lies in them: which runs there are, and which is being trained. Without NumPy or torch."""

import shlex
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sfmrl.config import ConfigError
from sfmrl.runs.files import DamagedFile, json_object, read_regular, regular

try:
    import fcntl
except ImportError:  # not on Windows, where a second process is not kept out
    fcntl = None

RUNS = Path("runs")
KINDS = ("il", "rl")
WEIGHTS = "weights.npz"  # a run's trained network, in its folder once it has ended
BEST = "best.npz"  # the network of the best validation
DEMONSTRATIONS = "demonstrations.npz"
MAP = "map.txt"  # the drawing, of a run that trains on one
TABLES = ("metrics.csv", "validation.csv", "test.csv", "test-best.csv", "result.json")
OLD = ("weights.pt", "best.pt")  # the same two in runs of versions before 0.3
LOCK = ".lock"  # locked by the process that trains the run


def run_folders(kind: str | None = None) -> list[Path]:
    """Folders under runs/ that hold a run (of a kind), the newest first."""
    found = []
    for path in RUNS.glob("[!.]*/run.json"):
        if kind_of(path.parent) in (KINDS if kind is None else (kind,)):
            found.append((str(facts_of(path.parent).get("created")), path.parent))
    return [folder for _, folder in sorted(found, reverse=True)]


def kind_of(folder: Path) -> str | None:
    """Which kind of run a folder holds; None without a run.json that says so."""
    kind = facts_of(folder).get("kind")
    return kind if kind in KINDS else None


def facts_of(folder: Path) -> dict[str, Any]:
    """What the run.json in a folder says; nothing where there is none that can be read."""
    try:
        return json_object(read_regular(folder / "run.json"))
    except (OSError, ValueError, DamagedFile):
        return {}


def finished(folder: Path) -> bool:
    """Whether the training in a folder has come to its end."""
    return (folder / WEIGHTS).exists()


def in_training(folder: Path) -> bool:
    """Whether a process is training the run in a folder; False where the system cannot tell."""
    try:
        with open(regular(folder / LOCK)) as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except (OSError, AttributeError, DamagedFile):
        return False
    return False


def unfinished(folder: Path) -> str:
    """What to say of a run that has not ended: what to type, or that it is being trained now."""
    if in_training(folder):
        return f"{folder} is being trained now; wait until it has ended"
    return f"{folder} has not ended; go on with it: sfmrl {kind_of(folder) or 'rl'} --resume {as_words(folder)}"


def as_words(folder: Path) -> str:
    """What to type to name a run folder, quoted for the shell, with --trust-reward where its reward is the user's."""
    try:
        reward = json_object(read_regular(folder / "config.json"))["reward"]["reward"]
    except (OSError, ValueError, LookupError, TypeError, DamagedFile):
        reward = ""  # whoever opens the run says what is wrong
    name = f"./{folder}" if str(folder).startswith("-") else str(folder)  # which would be an option
    return shlex.join([name, *["--trust-reward"] * (":" in str(reward))])


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes from training in a folder, where the system can; raises ConfigError where one does."""
    with open(regular(folder / LOCK), "a") as lock:
        for attempt in range(5):  # `in_training` holds the lock, too, for a moment
            try:
                if fcntl:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if attempt == 4:
                    raise ConfigError(
                        f"{folder} is being trained by another process; wait for it, or stop it"
                    ) from None
                time.sleep(0.05)
        yield
