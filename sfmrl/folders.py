"""Which runs are there: folders by what lies in them, without opening one, and without NumPy or torch."""

from pathlib import Path
from typing import Any

from sfmrl.files import DamagedFile, json_object, read_regular

RUNS = Path("runs")
KINDS = ("il", "rl")
WEIGHTS = "weights.pt"  # a run's trained network, in its folder once it has ended


def run_folders(kind: str | None = None) -> list[Path]:
    """Folders under runs/ that hold a run (of a kind), the newest first."""
    found = []
    for path in RUNS.glob("*/run.json"):
        if kind_of(path.parent) in (KINDS if kind is None else (kind,)):
            found.append((str(facts_of(path.parent).get("created")), path.parent))
    return [folder for _, folder in sorted(found, reverse=True)]


def kind_of(folder: Path) -> str | None:
    """Which kind of run a folder holds; None where it holds none that can be told."""
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
