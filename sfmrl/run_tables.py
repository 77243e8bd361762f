"""Whether a run's tables fit its config and each other: functions that say what they found, or raise Disagreement.

Independent of what wrote them: rates, means and intervals are computed anew from the lines of test.csv.
"""

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sfmrl.config import Config
from sfmrl.evaluation import RATES
from sfmrl.files import json_object, read_regular
from sfmrl.intervals import wilson
from sfmrl.scenarios import sample_scenes

Rows = list[dict[str, str]]


class Disagreement(Exception):
    """What does not agree, in words."""


def table(path: Path) -> Rows:
    """The lines of a CSV file by their headings."""
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def epochs(folder: Path, config: Config) -> str:
    """metrics.csv of an imitation run: a line an epoch."""
    rows, count = table(folder / "metrics.csv"), config.imitation.epochs
    _numbered(rows, "epoch", range(1, count + 1), "epochs in config.json")
    if not all(math.isfinite(float(row["loss"])) for row in rows):
        raise Disagreement("a loss is not finite")
    return f"all {count} epochs, the last with a loss of {float(rows[-1]['loss']):.5f}"


def training(folder: Path, config: Config) -> str:
    """metrics.csv of a reinforcement: a line an episode, in the environments that the seed draws."""
    rows, settings = table(folder / "metrics.csv"), config.reinforcement
    _numbered(rows, "episode", range(settings.episodes), "training episodes in config.json")
    _possible(rows, config)
    drawn = sample_scenes(settings.environment, settings.episodes, config.seed, phase="train").environment
    if [row["environment"] for row in rows] != list(drawn):
        raise Disagreement(f"its environments are not those that seed {config.seed} draws")
    return f"all {settings.episodes} training episodes, in the environments that the seed draws"


def validations(folder: Path, config: Config) -> str:
    """validation.csv: a line for each that was due, its rates those of so many episodes."""
    rows, settings = table(folder / "validation.csv"), config.reinforcement
    due = sorted({*range(0, settings.episodes, settings.validation_interval), settings.episodes})
    _numbered(rows, "episode", due, "validations that config.json asks for")
    for row in rows:
        counts = [float(row[name]) * settings.validation_episodes for name in RATES]
        whole = all(math.isclose(count, round(count), abs_tol=1e-6) and count >= 0 for count in counts)
        if not whole or round(sum(counts)) != settings.validation_episodes:
            raise Disagreement(f"the rates at {row['episode']} are not of {settings.validation_episodes} episodes")
    best = max(rows, key=lambda row: float(row["success"]))
    return f"all {len(rows)} validations; the best has success {float(best['success']):.3f}, at {best['episode']}"


def tests(folder: Path, config: Config, name: str) -> str:
    """A table of test episodes: each is there, and possible."""
    rows, count = table(folder / name), config.reinforcement.test_episodes
    _numbered(rows, "episode", range(count), "test episodes in config.json")
    _possible(rows, config)
    return f"all {count} test episodes"


def result(folder: Path, config: Config) -> str:
    """result.json: its numbers follow from test.csv, or, in older runs without it, fit its own list of failures."""
    found = json_object(read_regular(folder / "result.json"))
    settings, told = config.reinforcement, []
    for part, name in ((found, "test.csv"), (found.get("best_validation"), "test-best.csv")):
        if part is not None and (folder / name).exists():
            _same(_figures(table(folder / name)), part, "")
            told.append(name)
    for part in (found, found.get("with_recovery")):
        if part is not None:
            _same(_counted(part, settings.test_episodes), part, "")
    if "best_validation" in found:
        best = max(table(folder / "validation.csv"), key=lambda row: (float(row["success"]), int(row["episode"])))
        _same({"episode": int(best["episode"])}, found["best_validation"], "best_validation.")
    if config.planner.recover and "with_recovery" not in found:
        raise Disagreement("config.json asks for recovery, and there is no result with it")
    rates = ", ".join(f"{name} {found[name]:.3f}" for name in RATES)
    return f"{rates}: follows from {' and '.join(told) or 'its list of failures; there is no test.csv'}"


def outcomes(part: dict[str, Any], episodes: int) -> list[str]:
    """The outcome of every test episode that follows from a result's list of failures."""
    ends = ["success"] * episodes
    for failure in part["failures"]:
        ends[failure["episode"]] = failure["outcome"]
    return ends


def _numbered(rows: Rows, column: str, numbers: Sequence[int], what: str) -> None:
    """Hold a table to one line for each number, in order."""
    if [row[column] for row in rows] != [str(number) for number in numbers]:
        raise Disagreement(f"its {len(rows)} lines are not one for each of the {len(numbers)} {what}, in order")


def _possible(rows: Rows, config: Config) -> None:
    """Hold each episode's line to itself: its time and steps, its outcome and gap."""
    step, longest = config.simulation.time_step, config.simulation.longest
    for row in rows:
        steps, gap = int(row["steps"]), float(row["smallest_separation"])
        right = row["outcome"] in RATES and 1 <= steps <= longest and math.isclose(float(row["time"]), steps * step)
        right &= math.isfinite(float(row["total_reward"]))
        right &= row["outcome"] != "collision" or gap < 0
        right &= row["outcome"] != "timeout" or steps == longest
        if not right:
            raise Disagreement(f"episode {row['episode']}: outcome, steps, time and gap cannot be those of one episode")


def _figures(rows: Rows) -> dict[str, Any]:
    """What result.json says of episodes, computed from their lines."""
    figures = _summary(rows)
    names = sorted({row["environment"] for row in rows})
    if len(names) > 1:
        figures["environments"] = {name: _summary([r for r in rows if r["environment"] == name]) for name in names}
    figures["failures"] = [
        {"episode": int(row["episode"]), "environment": row["environment"], "outcome": row["outcome"]}
        for row in rows
        if row["outcome"] != "success"
    ]
    return figures


def _summary(rows: Rows) -> dict[str, Any]:
    counts = {name: sum(row["outcome"] == name for row in rows) for name in RATES}
    times = [float(row["time"]) for row in rows if row["outcome"] == "success"]
    return {
        **_rates(counts, len(rows)),
        "navigation_time": math.fsum(times) / len(times) if times else None,
        "total_reward": math.fsum(float(row["total_reward"]) for row in rows) / len(rows),
    }


def _counted(part: dict[str, Any], episodes: int) -> dict[str, Any]:
    """The rates that follow from a result's own list of failures."""
    ends = outcomes(part, episodes)
    return _rates({name: ends.count(name) for name in RATES}, episodes)


def _rates(counts: dict[str, int], episodes: int) -> dict[str, Any]:
    rates = {name: count / episodes for name, count in counts.items()}
    return {"episodes": episodes, **rates, "intervals": {n: list(wilson(c, episodes)) for n, c in counts.items()}}


def _same(expected: Any, found: Any, where: str) -> None:
    """Hold all that is in `expected` to what was found, numbers but for rounding; raises Disagreement naming it."""
    if isinstance(expected, dict):
        for name, value in expected.items():
            if not isinstance(found, dict) or name not in found:
                raise Disagreement(f"there is no {where}{name}")
            _same(value, found[name], f"{where}{name}.")
    elif isinstance(expected, list):
        if not isinstance(found, list) or len(found) != len(expected):
            raise Disagreement(f"{where.rstrip('.')} has not the {len(expected)} entries that follow from the episodes")
        for k, value in enumerate(expected):
            _same(value, found[k], f"{where}{k}.")
    elif isinstance(expected, float) and isinstance(found, int | float):
        if not math.isclose(expected, found, rel_tol=1e-9, abs_tol=1e-12):
            raise Disagreement(f"{where.rstrip('.')} is {found:g}, but {expected:g} follows from the episodes")
    elif expected != found:
        raise Disagreement(f"{where.rstrip('.')} is {found!r}, but {expected!r} follows from the episodes")
