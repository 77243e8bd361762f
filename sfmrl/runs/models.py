"""Trained networks that come with sfmrl, a weights file and a model card each, under the names of the tables' rows.

A card says how its network was made (variant, preset, seed, commands, versions), what it does (figures with intervals),
and the SHA-256 of its weights.
"""

from pathlib import Path
from typing import Any

from sfmrl.runs.files import DamagedFile, digest_of, json_object, read_regular

FOLDER = Path(__file__).parent.parent / "models"


def model_names() -> list[str]:
    """What `load_policy` takes for the networks that come with sfmrl."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def model_card(name: str) -> dict[str, Any]:
    """A network's card; raises DamagedFile where it is none."""
    path = FOLDER / f"{name}.json"
    try:
        return json_object(read_regular(path))
    except ValueError:
        raise DamagedFile(f"{path} is not what sfmrl came with; install sfmrl again") from None


def model_weights(name: str) -> Path:
    """A network's weights file; raises DamagedFile where it is not the one that its card describes."""
    path = FOLDER / f"{name}.npz"
    if not path.exists() or digest_of(path) != model_card(name).get("sha256"):
        raise DamagedFile(f"{path} is not what sfmrl came with; install sfmrl again")
    return path
