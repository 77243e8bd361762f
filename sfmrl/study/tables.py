"""The paper's two tables: rows with the paper's figures, the trainings that make them, each seed's metrics.

A table is made from finished run folders, wherever and in whichever order they were trained. All are tested on the same
episodes, with the weights that the training ended with, as in CrowdNav. Training, validation and test episodes are
drawn from separate streams, and never overlap.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sfmrl.config import Config, ConfigError, override, suggest
from sfmrl.runs.create import open_same
from sfmrl.runs.files import read_table
from sfmrl.runs.folders import finished
from sfmrl.study.jobs import Job
from sfmrl.variants import make_config

MOST_SEEDS = 1000  # of a table
VALIDATION_INTERVAL = {"paper": 1000, "quick": 250}  # episodes; the paper's figure has a point every 1000
EARLY = 0.25  # the first part of a training, for the early metrics
REACHED = 0.9  # validation success
TIME_CHARGED = 25.0  # s for a time-out, in `navigation_time_charged`


@dataclass(frozen=True)
class Table:
    """One of the paper's tables: where and how long its rows are trained, how they are tested, and the paper's figures.

    `episodes` are training episodes by preset. `paper` holds a row's success, collision rate, navigation time (s) and
    total reward, each with a value for each of the paper's results (two of SARL).
    """

    environment: str
    episodes: dict[str, int]
    test_episodes: int
    paper: dict[str, dict[str, tuple[float, ...]]]


def _row(*figures: tuple[float, ...]) -> dict[str, tuple[float, ...]]:
    return dict(zip(("success", "collision", "navigation_time", "total_reward"), figures, strict=True))


TABLES = {
    1: Table(
        "table1",
        {"paper": 10_000, "quick": 1000},
        500,
        {
            "sarl": _row((0.96, 0.97), (0.02, 0.01), (10.85, 11.77), (0.3059, 0.2850)),
            "sarl-sfm": _row((0.91,), (0.03,), (11.83,), (0.2417,)),
            "sarl-sfm2": _row((0.86,), (0.02,), (11.92,), (0.2363,)),
            "sarl-sfm3": _row((0.93,), (0.01,), (11.27,), (0.2741,)),
            "sarl-sfm4": _row((0.90,), (0.00,), (11.61,), (0.2646,)),
            "sarl-sfm5": _row((0.96,), (0.03,), (11.69,), (0.2799,)),
            "sarl-sfm6": _row((0.96,), (0.03,), (11.25,), (0.2713,)),
        },
    ),
    2: Table(
        "table2",
        {"paper": 15_000, "quick": 1500},  # 1.5 times as many as for table 1
        1000,
        {
            "sarl": _row((0.901,), (0.001,), (10.54,), (0.3046,)),
            "sarl-sfm6": _row((0.893,), (0.004,), (10.88,), (0.2763,)),
        },
    ),
}


def make_jobs(
    number: int,
    preset: str,
    seeds: list[int],
    rows: list[str],
    folder: Path,
    episodes: int | None = None,
    interval: int | None = None,
) -> list[Job]:
    """Return a table's trainings: for each seed an imitation, which its rows share, and a reinforcement for each row.

    `episodes` of each training and the `interval` of its validations are by default the table's.
    """
    schedule = run_config(number, preset, rows[0], seeds[0], episodes, interval).reinforcement
    changes = ["--no-recover", "--validation-interval", str(schedule.validation_interval)]
    if number == 2:
        changes += ["--environment", schedule.test_environment, "--test-episodes", str(schedule.test_episodes)]
    if number == 2 or episodes:
        changes += ["--episodes", str(schedule.episodes)]
    changes += ["--continue", "--threads", "1"]
    jobs = []
    for seed in seeds:
        source, common = folder / f"{preset}-il-seed{seed}", ("--preset", preset, "--seed", str(seed))
        jobs.append(Job(source, ("il", *common, "--run", str(source), "--continue")))
        for row in rows:
            run = run_folder(folder, number, preset, row, seed)
            folders = ("--from", str(source), "--run", str(run))
            jobs.append(Job(run, ("rl", "--variant", row, *common, *folders, *changes), source, schedule.episodes))
    return jobs


def run_config(
    number: int, preset: str, row: str, seed: int, episodes: int | None = None, interval: int | None = None
) -> Config:
    """Return the config of a row's training with a seed, which its command in `make_jobs` gives."""
    table, plain = TABLES[number], make_config(preset, row)
    schedule = {
        "episodes": episodes or table.episodes[preset],
        "validation_interval": interval or VALIDATION_INTERVAL[preset],
        "test_episodes": table.test_episodes,
        # Within table 1, the variant says where to train: sarl-sfm3 in environment 1 alone.
        "environment": plain.reinforcement.environment if number == 1 else table.environment,
        "test_environment": table.environment,
    }
    return override(plain, {"seed": seed, "planner": {"recover": False}, "reinforcement": schedule})


def run_folder(folder: Path, number: int, preset: str, row: str, seed: int) -> Path:
    """Return the run folder of a row's training with a seed."""
    return folder / f"{preset}-table{number}-{row}-seed{seed}"


def parse_rows(number: int, text: str | None) -> list[str]:
    """Return a table's rows named in `text`, each once, or all by default; raises ConfigError on other names."""
    known = TABLES[number].paper
    rows = list(known if text is None else dict.fromkeys(map(str.strip, text.split(","))))
    for name in rows:
        if name not in known:
            raise ConfigError(f"table {number} has no row {name!r}; it has {', '.join(known)}{suggest(name, known)}")
    return rows


def parse_seeds(text: str) -> list[int]:
    """Return the seeds of "0-9" or "0,3,5-7", each once; raises ConfigError on anything else."""
    seeds: dict[int, None] = {}
    for part in map(str.strip, text.split(",")):
        match = re.fullmatch(r"([0-9]{1,18})(?:-([0-9]{1,18}))?", part)
        first, last = (int(end or match[1]) for end in match.groups()) if match else (0, -1)
        if last < first:
            raise ConfigError(f"--seeds {text}: {part!r} is neither a seed nor a range; write 0-9 or 0,3,5-7")
        if len(seeds) + last - first >= MOST_SEEDS:
            raise ConfigError(f"--seeds {text} are too many; name at most {MOST_SEEDS}")
        seeds |= dict.fromkeys(range(first, last + 1))
    return list(seeds)


@dataclass(frozen=True)
class Trained:
    """A row's finished runs: E test episodes, V validations and T training episodes of each of S seeds."""

    seeds: list[int]
    outcome: np.ndarray  # (S, E) "success", "collision", "timeout"
    hit: np.ndarray  # (S, E) "human", "square" or "" without a collision
    time: np.ndarray  # (S, E) s
    total_reward: np.ndarray  # (S, E)
    episodes: np.ndarray  # (V,) training episodes at which there was a validation
    validation: np.ndarray  # (S, V) its success
    training: np.ndarray  # (S, T) bool, success of the training episodes, exploring
    steps: np.ndarray  # (S, T) steps that they took


def finished_runs(
    folder: Path, number: int, preset: str, row: str, seeds: list[int], **schedule: int | None
) -> dict[int, Path]:
    """Return the folders of a row's finished runs among `seeds`; `schedule` is as for `run_config`.

    Raises ConfigError if a run has other settings than `run_config` gives, DamagedFile if its config.json is damaged.
    """
    remedy = "give the --episodes and --validation-interval of its training, or name another --folder"
    runs = {seed: run_folder(folder, number, preset, row, seed) for seed in seeds}
    runs = {seed: run for seed, run in runs.items() if finished(run)}
    for seed, run in runs.items():
        open_same(run, "rl", run_config(number, preset, row, seed, **schedule), remedy)
    return runs


def read_row(
    folder: Path, number: int, preset: str, row: str, seeds: list[int], **schedule: int | None
) -> Trained | None:
    """Read a row's `finished_runs`; returns None where there is none.

    Raises ConfigError where a run cannot be read, or has other episodes than the others; DamagedFile where one of its
    files is not what was written.
    """
    runs = finished_runs(folder, number, preset, row, seeds, **schedule)
    if not runs:
        return None
    folders = list(runs.values())
    test = _columns(folders, "test.csv", outcome=str, hit=str, time=float, total_reward=float)
    validation = _columns(folders, "validation.csv", success=float)
    metrics = _columns(folders, "metrics.csv", outcome=str, steps=int)
    del test["episode"]
    return Trained(
        seeds=list(runs),
        **test,
        episodes=validation["episode"][0],
        validation=validation["success"],
        training=metrics["outcome"] == "success",
        steps=metrics["steps"],
    )


def _columns(runs: list[Path], name: str, **kinds: type) -> dict[str, np.ndarray]:
    """Read columns of the CSV file `name` of every run, each (S, rows): "episode", and those of the types `kinds`.

    Raises ConfigError if a file cannot be read, or lists other episodes than that of the first run.
    """
    tables: list[dict[str, np.ndarray]] = []
    kinds = {"episode": int, **kinds}
    for run in runs:
        try:
            rows = read_table(run / name)
            table: dict[str, np.ndarray] = {
                key: np.array([row[key] for row in rows]).astype(kinds[key]) for key in kinds
            }
        except (OSError, ValueError, LookupError, TypeError, ArithmeticError) as error:  # on unexpected content
            raise ConfigError(f"{run / name} cannot be read ({error!r}); delete this run and train it again") from error
        if not rows:
            raise ConfigError(f"{run / name} has no rows; delete this run and train it again")
        if tables and not np.array_equal(table["episode"], tables[0]["episode"]):
            raise ConfigError(f"{run / name} lists other episodes than that of {runs[0]}; train the wrong one again")
        tables.append(table)
    return {key: np.stack([table[key] for table in tables]) for key in tables[0]}


@dataclass(frozen=True)
class Figures:
    """A row's metrics, one value per seed: `values` holds an array (S,) for each metric's name, NaN for no value."""

    seeds: list[int]
    test_episodes: int
    values: dict[str, np.ndarray]

    def of(self, metric: str, seeds: list[int]) -> np.ndarray:
        """Return a metric's values for these seeds, in their order."""
        return self.values[metric][[self.seeds.index(seed) for seed in seeds]]


def figures(runs: Trained) -> Figures:
    """Compute the metrics of every seed from its test episodes and the course of its training."""
    success, timeout = runs.outcome == "success", runs.outcome == "timeout"
    first = (runs.episodes > 0) & (runs.episodes <= EARLY * runs.episodes[-1])  # validations; not that of the start
    reached = runs.validation >= REACHED
    until = np.where(reached.any(axis=1), runs.episodes[reached.argmax(axis=1)], np.nan)
    before = np.arange(runs.steps.shape[1]) < until[:, None]  # training episodes
    values = {
        "success": success.mean(axis=1),  # with "collision" and "timeout", it adds up to 1
        "collision": (runs.outcome == "collision").mean(axis=1),  # the sum of the next two
        "human_collision": (runs.hit == "human").mean(axis=1),
        "square_collision": (runs.hit == "square").mean(axis=1),
        "timeout": timeout.mean(axis=1),
        "navigation_time": _mean_where(runs.time, success),  # s, as in CrowdNav
        "navigation_time_charged": _mean_where(np.where(timeout, TIME_CHARGED, runs.time), success | timeout),
        "total_reward": runs.total_reward.mean(axis=1),
        "start_success": runs.validation[:, 0],
        "course_success": runs.validation.mean(axis=1),  # of all, that after imitation included
        "early_success": runs.validation[:, first].mean(axis=1) if first.any() else np.full(len(runs.seeds), np.nan),
        "early_training_success": runs.training[:, : max(1, int(EARLY * runs.training.shape[1]))].mean(axis=1),
        "drops": np.maximum(-np.diff(runs.validation, axis=1), 0).mean(axis=1),  # 0 is steady
        "reached_episodes": until,
        "reached_steps": np.where(np.isnan(until), np.nan, (runs.steps * before).sum(axis=1)),
    }
    return Figures(runs.seeds, runs.outcome.shape[1], values)


def _mean_where(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return the mean of each row's entries in `where`, NaN without any."""
    count = where.sum(axis=1)
    return np.divide((values * where).sum(axis=1), count, out=np.full(len(values), np.nan), where=count > 0)
