"""The paper's two tables: their rows, with the paper's own figures, and the trainings that make them."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from sfmrl.config import ConfigError, suggest
from sfmrl.folders import finished


@dataclass(frozen=True)
class Table:
    """One of the paper's tables; what a row's runs add to variant and preset, and the paper's own figures.

    `paper` holds, for each row, the success, collision rate, navigation time (s) and total reward that the paper
    reports, one for each of its runs (it trained SARL twice). `episodes` are training episodes by preset.
    """

    environment: str
    episodes: dict[str, int]
    test_episodes: int
    paper: dict[str, dict[str, tuple[float, ...]]]


def _row(success: tuple, collision: tuple, navigation_time: tuple, total_reward: tuple) -> dict[str, tuple]:
    return {
        "success": success,
        "collision": collision,
        "navigation_time": navigation_time,
        "total_reward": total_reward,
    }


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
        {"paper": 15_000, "quick": 1500},  # half as many again as for table 1
        1000,
        {
            "sarl": _row((0.901,), (0.001,), (10.54,), (0.3046,)),
            "sarl-sfm6": _row((0.893,), (0.004,), (10.88,), (0.2763,)),
        },
    ),
}
SEEDS = 1000  # of a table at most
VALIDATION_INTERVAL = {"paper": 1000, "quick": 250}  # episodes; the paper's figure has a point every 1000


@dataclass(frozen=True)
class Job:
    """A training as one plain command: `words` follow "sfmrl". It can be given again, and then goes on."""

    name: str
    words: tuple[str, ...]
    folder: Path  # the run folder that it makes
    needs: Path | None  # the run folder that has to be finished before
    episodes: int  # of reinforcement

    @property
    def command(self) -> str:
        """What to type."""
        return shlex.join(["sfmrl", *self.words])

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return finished(self.folder)


def make_jobs(number: int, preset: str, seeds: list[int], rows: list[str], folder: Path) -> list[Job]:
    """The trainings of a table: an imitation run for each seed, which its rows share, and a run for each row."""
    table, jobs = TABLES[number], []
    for seed in seeds:
        source = folder / f"{preset}-il-seed{seed}"
        common = ("--preset", preset, "--seed", str(seed))
        words = ("il", *common, "--run", str(source), "--continue", "--threads", "1")
        jobs.append(Job(source.name, words, source, None, 0))
        for row in rows:
            run = run_folder(folder, number, preset, row, seed)
            words = ["rl", "--variant", row, *common, "--from", str(source), "--run", str(run), "--no-recover"]
            words += ["--validation-interval", str(VALIDATION_INTERVAL[preset]), "--test-best"]
            if number == 2:
                words += ["--environment", table.environment, "--episodes", str(table.episodes[preset])]
                words += ["--test-episodes", str(table.test_episodes)]
            words += ["--continue", "--threads", "1"]
            jobs.append(Job(run.name, tuple(words), run, source, table.episodes[preset]))
    return jobs


def run_folder(folder: Path, number: int, preset: str, row: str, seed: int) -> Path:
    """Where a row's run of a seed has its place."""
    return folder / f"{preset}-table{number}-{row}-seed{seed}"


def parse_rows(number: int, text: str | None) -> list[str]:
    """Names of rows, separated by commas, all of the table's by default; raises ConfigError on others."""
    known = TABLES[number].paper
    rows = list(known) if text is None else [name.strip() for name in text.split(",")]
    for name in rows:
        if name not in known:
            raise ConfigError(f"table {number} has no row {name!r}; it has {', '.join(known)}{suggest(name, known)}")
    return rows


def parse_seeds(text: str) -> list[int]:
    """Seeds from "0-9" or "0,3,5-7", each once; raises ConfigError on what is neither."""
    seeds: dict[int, None] = {}
    for part in text.split(","):
        match = re.fullmatch(r"([0-9]{1,18})(?:-([0-9]{1,18}))?", part.strip())
        first, last = (int(end or match[1]) for end in match.groups()) if match else (0, -1)
        if last < first:
            raise ConfigError(f"--seeds {text}: {part.strip()!r} is neither a seed nor a range; write 0-9 or 0,3,5-7")
        if len(seeds) + last - first >= SEEDS:
            raise ConfigError(f"--seeds {text} are too many; name at most {SEEDS}")
        seeds |= dict.fromkeys(range(first, last + 1))
    return list(seeds)
