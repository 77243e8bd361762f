"""Summarise a table's runs: means over seeds with 95 % intervals, differences from SARL, and the paper beside them.

All statistics follow from one value per seed and metric (`Figures`), which a table's CSV file holds, too. Differences
are paired by seed. Intervals say what other training seeds would change on the same test episodes.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sfmrl.intervals import holm, mean_difference, mean_interval, next_run, wilson
from sfmrl.study.results import Trained
from sfmrl.study.tables import Table

TIME_CHARGED = 25.0  # s, what a time-out costs in the navigation time that counts them
SEEDS_NEEDED = 5  # for a verdict on the paper
WIDEST = 0.1  # a wider range of expected success is no basis for a verdict
RATES = {"success", "human_collision", "square_collision", "timeout", "best_success", "start_success"}  # from 0 to 1
RATES |= {"early_success", "early_training_success", "drops"}


@dataclass(frozen=True)
class Figures:
    """A row's metrics, one value per seed: `values` holds an array (S,) for each metric's name, NaN for no value."""

    seeds: list[int]
    test_episodes: int
    values: dict[str, np.ndarray]

    def of(self, metric: str, seeds: list[int]) -> np.ndarray:
        """A metric's values for these seeds, in their order."""
        return self.values[metric][[self.seeds.index(seed) for seed in seeds]]


def figures(tested: Trained) -> Figures:
    """Compute the metrics of every seed from its test episodes and the course of its training.

    Success and the next three metrics add up to 1. `navigation_time` (s) is the mean over successes, as in the paper;
    `navigation_time_charged` includes time-outs, each as 25 s.
    """
    reached, steps = tested.reached
    success, timeout = tested.success, tested.outcome == "timeout"
    charged = np.where(timeout, TIME_CHARGED, tested.time)
    values = {
        "success": success.mean(axis=1),
        "human_collision": (tested.hit == "human").mean(axis=1),
        "square_collision": (tested.hit == "square").mean(axis=1),
        "timeout": timeout.mean(axis=1),
        "navigation_time": _mean_where(tested.time, success),
        "navigation_time_charged": _mean_where(charged, success | timeout),
        "total_reward": tested.total_reward.mean(axis=1),
        "best_success": tested.best,
        "best_episode": tested.best_episode.astype(float),
        "start_success": tested.validation[:, 0],
        "early_success": tested.early,
        "early_training_success": tested.early_training,
        "drops": tested.drops,
        "reached_episodes": reached,
        "reached_steps": steps,
    }
    return Figures(tested.seeds, tested.outcome.shape[1], values)


def _mean_where(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """The mean of each row's entries in `where`, NaN without any."""
    count = where.sum(axis=1)
    return np.divide((values * where).sum(axis=1), count, out=np.full(len(values), np.nan), where=count > 0)


def summarise(table: Table, rows: dict[str, Figures]) -> list[dict[str, Any]]:
    """Return each row's name, the paper's figures and ours as plain values, ready for JSON; None for no value."""
    found = []
    for name, row in rows.items():
        hits = np.round(row.values["success"] * row.test_episodes)
        found.append(
            {
                "row": name,
                "paper": table.paper[name],
                "seeds": row.seeds,
                "test_episodes": row.test_episodes,
                "figures": {metric: _over_seeds(v, metric in RATES) for metric, v in row.values.items()},
                "wilson": [list(wilson(int(count), row.test_episodes)) for count in hits],
                "wilson_of_mean": list(wilson(round(hits.mean()), row.test_episodes)),
                **_verdict(table, name, row.values["success"]),
                "difference": _from_sarl(table, name, rows),
            }
        )
    compared = [row["difference"] for row in found if row["difference"]]
    for difference, p in zip(compared, holm(np.array([d["p"] for d in compared])), strict=True):
        difference["p_holm"] = float(p)
    return found


def _over_seeds(values: np.ndarray, is_rate: bool = False) -> dict[str, Any]:
    """Mean over the seeds that have a value, its 95 % interval, their standard deviation, and every value."""
    known = values[np.isfinite(values)]
    low, high = mean_interval(known, 0.0, 1.0) if is_rate else mean_interval(known)
    mean = float(known.mean()) if len(known) else None
    deviation = float(known.std(ddof=1)) if len(known) > 1 else None
    every = [float(value) if np.isfinite(value) else None for value in values]
    return {"mean": mean, "low": low, "high": high, "deviation": deviation, "values": every}


def _verdict(table: Table, name: str, rates: np.ndarray) -> dict[str, Any]:
    """Judge whether one more run of ours, tested on as many episodes as the paper's, could have the paper's success."""
    if len(rates) < SEEDS_NEEDED:
        return {"expected": None, "verdict": "inconclusive"}
    mean, half = next_run(rates, table.test_episodes)
    low, high = max(mean - half, 0.0), min(mean + half, 1.0)
    return {"expected": [low, high], "verdict": _judge(low, high, table.paper[name]["success"])}


def _judge(low: float, high: float, reported: tuple[float, ...]) -> str:
    """Return consistent, inconsistent or inconclusive; allows for the rounding of the reported figures."""
    half = 0.5 * 10.0 ** -max(len(f"{value:.6f}".rstrip("0").partition(".")[2]) for value in (*reported, 0.01))
    if all(low - half <= value <= high + half for value in reported):
        return "inconclusive" if high - low > WIDEST else "consistent"
    return "inconsistent"


def _from_sarl(table: Table, name: str, rows: dict[str, Figures]) -> dict[str, Any] | None:
    """A row's success less SARL's, paired by seed; None for SARL itself and where nothing can be paired."""
    if name == "sarl" or "sarl" not in rows:
        return None
    ours, sarl = rows[name], rows["sarl"]
    shared = [seed for seed in ours.seeds if seed in sarl.seeds]
    if not shared or ours.test_episodes != sarl.test_episodes:
        return None
    one, other = (row.of("success", shared) for row in (ours, sarl))
    reported = [np.mean(table.paper[row]["success"]) for row in (name, "sarl")]
    difference = vars(mean_difference(one - other)) | {
        "seeds": shared,
        "paper": float(reported[0] - reported[1]),
        "verdict": "inconclusive",
    }
    if len(shared) >= SEEDS_NEEDED:
        (mean, half), (sarl_mean, sarl_half) = (next_run(rates, table.test_episodes) for rates in (one, other))
        low, high = (mean - sarl_mean + sign * math.hypot(half, sarl_half) for sign in (-1, 1))
        difference |= {"expected": [low, high], "verdict": _judge(low, high, (difference["paper"],))}
    return difference


# Two ingredients that the paper judges, as differences between table 1's rows: the mean, over the pairs, of the first
# row less the second.
CONTRASTS = {
    "forces in the state": (("sarl-sfm5", "sarl"), ("sarl-sfm6", "sarl-sfm2")),
    "SFM reward": (("sarl-sfm2", "sarl"), ("sarl-sfm6", "sarl-sfm5")),
}
CONTRASTED = {
    "success": "success",
    "start_success": "validation after imitation",
    "early_success": "validation, first quarter",
    "early_training_success": "training, first quarter",
    "drops": "drop between validations",
    "reached_episodes": "episodes until validation 0.9",
    "navigation_time": "navigation time, s",
}


def contrasts(rows: dict[str, Figures]) -> list[dict[str, Any]]:
    """Return the effects of forces in the state and of the SFM reward, paired by the seeds that all their rows have."""
    found = []
    for ingredient, pairs in CONTRASTS.items():
        if not all(name in rows for pair in pairs for name in pair):
            continue
        shared = [s for s in rows["sarl"].seeds if all(s in rows[name].seeds for pair in pairs for name in pair)]
        for metric in CONTRASTED:
            by_seed = np.mean([rows[a].of(metric, shared) - rows[b].of(metric, shared) for a, b in pairs], axis=0)
            found.append({"of": ingredient, "in": metric, **_over_seeds(by_seed)})
    return found
