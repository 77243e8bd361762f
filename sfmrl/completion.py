"""What the shell completes: names of policies, environments, rewards and runs; NumPy is imported where it is needed."""

from collections.abc import Callable, Iterable
from pathlib import Path

from sfmrl.folders import KINDS, finished, in_training, run_folders
from sfmrl.variants import MIXES, VARIANTS

Completion = Callable[[str], list[str]]


def among(*names: str) -> Completion:
    """Completes to one of these names."""
    return lambda incomplete: _fitting(names, incomplete)


variants = among(*VARIANTS)


def environments(incomplete: str) -> list[str]:
    """Environments, and the mixes of the paper's tables."""
    from sfmrl.scenes import ENVIRONMENTS

    return _fitting([*ENVIRONMENTS, *MIXES], incomplete)


def rewards(incomplete: str) -> list[str]:
    """The rewards with a name."""
    from sfmrl.rewards import REWARDS

    return _fitting(REWARDS, incomplete)


def policies(incomplete: str) -> list[str]:
    """The policies with a name, networks that come with sfmrl, and the finished runs."""
    from sfmrl.models import model_names
    from sfmrl.policies import POLICIES

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
