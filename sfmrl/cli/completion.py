"""The names that the shell completes; Typer selects those that begin with the typed word. NumPy is imported late."""

from collections.abc import Callable

from sfmrl.runs.folders import finished, in_training, run_folders
from sfmrl.variants import MIXES


def among(*names: str) -> Callable[[], list[str]]:
    """Complete to one of these names."""
    return lambda: list(names)


def environments() -> list[str]:
    """Return the environments, and the mixes of the paper's tables."""
    from sfmrl.scenes import ENVIRONMENTS

    return [*ENVIRONMENTS, *MIXES]


def rewards() -> list[str]:
    """Return the built-in rewards."""
    from sfmrl.rewards import REWARDS

    return list(REWARDS)


def policies() -> list[str]:
    """Return the built-in policies, the networks that come with sfmrl, and the finished runs."""
    from sfmrl.policies import POLICIES
    from sfmrl.runs.weights import model_names

    return [*POLICIES, *model_names(), *(folder.as_posix() for folder in run_folders() if finished(folder))]


def runs() -> list[str]:
    """Return every run under runs/, the newest first."""
    return [folder.as_posix() for folder in run_folders()]


def unfinished_runs() -> list[str]:
    """Return the runs that can be resumed: unfinished, and not in training now."""
    return [folder.as_posix() for folder in run_folders() if not finished(folder) and not in_training(folder)]


def beginnings() -> list[str]:
    """Return what a reinforcement run can start from: finished imitation runs, and models."""
    from sfmrl.runs.weights import model_names

    return [*(folder.as_posix() for folder in run_folders("il") if finished(folder)), *model_names()]


KNOBS = {"reward": rewards, "environment": environments, "test_environment": environments}  # knobs with such names
