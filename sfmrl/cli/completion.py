"""What the shell completes: names of policies, environments, rewards and runs; NumPy is imported where it is needed.

Typer keeps those names that begin as the word that is typed.
"""

from collections.abc import Callable

from sfmrl.runs.folders import finished, in_training, run_folders
from sfmrl.variants import MIXES, VARIANTS

Completion = Callable[[], list[str]]


def among(*names: str) -> Completion:
    """Complete to one of these names."""
    return lambda: list(names)


variants = among(*VARIANTS)


def environments() -> list[str]:
    """Return environments, and the mixes of the paper's tables."""
    from sfmrl.scenes import ENVIRONMENTS

    return [*ENVIRONMENTS, *MIXES]


def rewards() -> list[str]:
    """Return the rewards with a name."""
    from sfmrl.rewards import REWARDS

    return list(REWARDS)


def policies() -> list[str]:
    """Return the policies with a name, networks that come with sfmrl, and the finished runs."""
    from sfmrl.policies import POLICIES
    from sfmrl.runs.weights import model_names

    return [*POLICIES, *model_names(), *(folder.as_posix() for folder in run_folders() if finished(folder))]


def runs() -> list[str]:
    """Return every run under runs/, the newest first."""
    return [folder.as_posix() for folder in run_folders()]


def unfinished_runs() -> list[str]:
    """Return the runs that can be gone on with: no process is training them now."""
    return [folder.as_posix() for folder in run_folders() if not finished(folder) and not in_training(folder)]


def imitation_runs() -> list[str]:
    """Return the runs that a reinforcement can start from."""
    return [folder.as_posix() for folder in run_folders("il") if finished(folder)]
