"""Which runs are there: folders by what lies in them, without opening one, and without NumPy or torch."""

import json
from pathlib import Path

RUNS = Path("runs")
KINDS = ("il", "rl")
WEIGHTS = "weights.pt"  # a run's trained network, in its folder once it has ended


def run_folders(kind: str | None = None) -> list[Path]:
    """Folders under runs/ that hold a run (of a kind), the newest first."""
    found = []
    for path in RUNS.glob("*/run.json"):
        if kind_of(path.parent) in (KINDS if kind is None else (kind,)):
            found.append((str(json.loads(path.read_text()).get("created")), path.parent))
    return [folder for _, folder in sorted(found, reverse=True)]


def kind_of(folder: Path) -> str | None:
    """Which kind of run a folder holds; None where it holds none that can be told."""
    try:
        facts = json.loads((folder / "run.json").read_text())
    except (OSError, ValueError):
        return None
    return facts.get("kind") if isinstance(facts, dict) and facts.get("kind") in KINDS else None


def finished(folder: Path) -> bool:
    """Whether the training in a folder has come to its end."""
    return (folder / WEIGHTS).exists()
