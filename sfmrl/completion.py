"""What the shell completes: names of policies, environments, rewards and runs, without importing NumPy or torch."""

from collections.abc import Callable, Iterable
from pathlib import Path

from sfmrl.folders import KINDS, finished, in_training, run_folders
from sfmrl.variants import MIXES, VARIANTS

ENVIRONMENTS = ("1", "2", "3", "4", "5", "circle", "circle5", "maps", *MIXES)
REWARDS = ("crowd", "sfm", "sfm-discount")
POLICIES = ("linear", "orca", "sfm")

Completion = Callable[[str], list[str]]


def among(*names: str) -> Completion:
    """Completes to one of these names."""
    return lambda incomplete: _fitting(names, incomplete)


variants, environments, rewards = among(*VARIANTS), among(*ENVIRONMENTS), among(*REWARDS)


def policies(incomplete: str) -> list[str]:
    """The policies with a name, networks that come with sfmrl, and the finished runs."""
    from sfmrl.models import model_names

    return _fitting([*POLICIES, *model_names(), *_runs(*KINDS, ended=True)], incomplete)


def runs(incomplete: str) -> list[str]:
    """Every run under runs/, the newest first."""
    return _fitting(_runs(*KINDS), incomplete)


def unfinished_runs(incomplete: str) -> list[str]:
    """Those that can be gone on with: no process is training them now."""
    return _fitting([folder for folder in _runs(*KINDS, ended=False) if not in_training(Path(folder))], incomplete)


def imitation_runs(incomplete: str) -> list[str]:
    """Those that a reinforcement can start from."""
    return _fitting(_runs("il", ended=True), incomplete)


def _runs(*kinds: str, ended: bool | None = None) -> list[str]:
    folders = [folder for kind in kinds for folder in run_folders(kind)]
    return [folder.as_posix() for folder in folders if ended is None or finished(folder) == ended]


def _fitting(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
