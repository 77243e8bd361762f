"""What the run folders of a table's row hold: test episodes, validations and the trainings' courses, over all seeds.

Only finished folders are read, so where and in which order they were trained does not matter. All are tested on the
same episodes, with the weights that the training ended with, as in the paper; those of the best validation are tested
beside them. Validation, test and training episodes are drawn from streams of their own, and never overlap.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sfmrl.config import ConfigError
from sfmrl.files import json_object, read_listed, read_table
from sfmrl.folders import finished
from sfmrl.study.tables import run_folder

EARLY = 0.25  # the first part of a training that its early course is taken from
REACHED = 0.9  # validation success


@dataclass(frozen=True)
class Trained:
    """Test episodes of one row, S seeds by E episodes, and the trainings' courses."""

    seeds: list[int]
    outcome: np.ndarray  # (S, E) "success", "collision", "timeout"
    hit: np.ndarray  # (S, E) "human", "square" or "" without a collision
    time: np.ndarray  # (S, E) s
    total_reward: np.ndarray  # (S, E)
    best: np.ndarray  # (S,) success with the weights of the best validation
    best_episode: np.ndarray  # (S,) the episode of that validation
    episodes: np.ndarray  # (V,) at which there was a validation
    validation: np.ndarray  # (S, V) its success
    training: np.ndarray  # (S, T) bool, success of the training episodes, exploring
    steps: np.ndarray  # (S, T) steps that they took

    @property
    def success(self) -> np.ndarray:
        """(S, E) bool."""
        return self.outcome == "success"

    @property
    def early(self) -> np.ndarray:
        """(S,) mean validation success in the first quarter of the training, its start left out."""
        first = (self.episodes > 0) & (self.episodes <= EARLY * self.episodes[-1])
        return self.validation[:, first].mean(axis=1) if first.any() else np.full(len(self.seeds), np.nan)

    @property
    def early_training(self) -> np.ndarray:
        """(S,) success of the first quarter of the training episodes themselves, exploring."""
        return self.training[:, : int(EARLY * self.training.shape[1])].mean(axis=1)

    @property
    def drops(self) -> np.ndarray:
        """(S,) mean loss of success from one validation to the next, gains counted as none: 0 is steady."""
        return np.maximum(-np.diff(self.validation, axis=1), 0).mean(axis=1)

    @property
    def reached(self) -> tuple[np.ndarray, np.ndarray]:
        """Training episodes and steps until the first validation success of 0.9, each (S,); NaN where never."""
        there = self.validation >= REACHED
        at = np.where(there.any(axis=1), self.episodes[there.argmax(axis=1)], np.nan)
        count = np.concatenate([np.zeros((len(at), 1)), self.steps.cumsum(axis=1)], axis=1)
        steps = [row[int(n)] if np.isfinite(n) else np.nan for row, n in zip(count, at, strict=True)]
        return at, np.array(steps)


def read_row(folder: Path, number: int, preset: str, row: str, seeds: list[int]) -> Trained | None:
    """The finished runs of a row among `seeds`; None where there is none.

    Raises ConfigError where a run was tested or validated on other episodes than the others, or cannot be read;
    DamagedFile where one of its files is not what was written.
    """
    runs = {seed: run_folder(folder, number, preset, row, seed) for seed in seeds}
    runs = {seed: run for seed, run in runs.items() if finished(run)}
    if not runs:
        return None
    try:
        return _trained(runs)
    except (OSError, ValueError, LookupError, TypeError, ArithmeticError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"a run of row {row} under {folder} cannot be read ({error!r}); train it again") from error


def _trained(runs: dict[int, Path]) -> Trained:
    """The runs of a row by seed; raises ConfigError where they differ, and whatever odd content leads to."""
    tests, validations, metrics = (
        [_columns(run / name) for run in runs.values()] for name in ("test.csv", "validation.csv", "metrics.csv")
    )
    best = [json_object(read_listed(run / "result.json"))["best_validation"] for run in runs.values()]
    for name, group, key in (("tested", tests, "episode"), ("validated", validations, "episode")):
        for run, columns in zip(runs.values(), group, strict=True):
            if columns[key] != group[0][key]:
                raise ConfigError(f"{run} was {name} on other episodes than the row's other runs; train it again")

    def stacked(group: list[dict[str, list[str]]], column: str, kind: type) -> np.ndarray:
        return np.array([columns[column] for columns in group]).astype(kind)

    return Trained(
        seeds=list(runs),
        outcome=stacked(tests, "outcome", str),
        hit=stacked(tests, "hit", str),
        time=stacked(tests, "time", float),
        total_reward=stacked(tests, "total_reward", float),
        best=np.array([float(result["success"]) for result in best]),
        best_episode=np.array([int(result["episode"]) for result in best]),
        episodes=stacked(validations, "episode", int)[0],
        validation=stacked(validations, "success", float),
        training=stacked(metrics, "outcome", str) == "success",
        steps=stacked(metrics, "steps", int),
    )


def _columns(path: Path) -> dict[str, list[str]]:
    rows = read_table(path)
    return {name: [row[name] for row in rows] for name in rows[0]} if rows else {}
