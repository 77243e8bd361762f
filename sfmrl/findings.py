"""What a table's runs say: means over seeds with intervals, differences from SARL, and how the paper's figures fit in.

Everything random here is resampling, from a fixed seed: the same folders give the same numbers.
"""

from typing import Any

import numpy as np

from sfmrl.intervals import holm, mean_interval, new_runs, paired_difference, percentiles, wilson
from sfmrl.results import Trained
from sfmrl.tables import Table

TIME_CHARGED = 25.0  # s, what a time-out costs in the navigation time that counts them
SEEDS_NEEDED = 3  # fewer say nothing of their spread
WIDEST = 0.1  # an expected range of success wider than this excludes nothing of interest


def figures(tested: Trained) -> dict[str, np.ndarray]:
    """The metrics of every seed by name, each (S,); NaN where there is nothing to take a mean of.

    Success and the three that follow add up to 1. `navigation_time` is over successes, as in the paper; with
    `navigation_time_charged` a time-out counts as 25 s.
    """
    reached, steps = tested.reached
    success, timeout = tested.success, tested.outcome == "timeout"
    charged = np.where(timeout, TIME_CHARGED, tested.time)
    return {
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


def _mean_where(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """The mean of each row's entries in `where`, NaN without any."""
    count = where.sum(axis=1)
    return np.divide((values * where).sum(axis=1), count, out=np.full(len(values), np.nan), where=count > 0)


def summarise(table: Table, rows: dict[str, Trained]) -> list[dict[str, Any]]:
    """A row's name, the paper's figures and ours; plain values, ready for JSON, None where there is none."""
    found = []
    for name, tested in rows.items():
        rng = np.random.default_rng(0)
        by_seed = figures(tested)
        successes, trials = tested.success.sum(axis=1), tested.outcome.shape[1]
        found.append(
            {
                "row": name,
                "paper": table.paper[name],
                "seeds": tested.seeds,
                "test_episodes": trials,
                "figures": {metric: _over_seeds(values, rng) for metric, values in by_seed.items()},
                "wilson": [list(wilson(int(hits), trials)) for hits in successes],
                "wilson_of_mean": list(wilson(round(successes.mean()), trials)),
                **_verdict(table, name, by_seed["success"], rng),
                **_from_sarl(table, name, rows, rng),
            }
        )
    compared = [row["difference"] for row in found if row["difference"]]
    for difference, p in zip(compared, holm(np.array([d["p"] for d in compared])), strict=True):
        difference["p_holm"] = float(p)
    return found


def _over_seeds(values: np.ndarray, rng: np.random.Generator) -> dict[str, Any]:
    """Mean over the seeds that have a value, its bootstrap interval, their standard deviation, and every value."""
    known = values[np.isfinite(values)]
    low, high = mean_interval(known, rng)
    deviation = known.std(ddof=1) if len(known) > 1 else np.nan
    mean = known.mean() if len(known) else np.nan
    numbers = {"mean": mean, "low": low, "high": high, "deviation": deviation}
    return {n: _plain(v) for n, v in numbers.items()} | {"values": [_plain(v) for v in values]}


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _verdict(table: Table, name: str, rates: np.ndarray, rng: np.random.Generator) -> dict[str, Any]:
    """Whether one more run of ours, tested on as many episodes as the paper's, might have had the paper's success."""
    if len(rates) < SEEDS_NEEDED:
        return {"expected": None, "verdict": "inconclusive"}
    low, high = percentiles(new_runs(rates, table.test_episodes, rng))
    return {"expected": [low, high], "verdict": _judge(low, high, table.paper[name]["success"])}


def _judge(low: float, high: float, reported: tuple[float, ...]) -> str:
    """Consistent, inconsistent or inconclusive; figures are held to the precision that they are reported with."""
    half = 0.5 * 10.0 ** -max(len(f"{value:.6f}".rstrip("0").partition(".")[2]) for value in (*reported, 0.01))
    if all(low - half <= value <= high + half for value in reported):
        return "inconclusive" if high - low > WIDEST else "consistent"
    return "inconsistent"


def _from_sarl(table: Table, name: str, rows: dict[str, Trained], rng: np.random.Generator) -> dict[str, Any]:
    """The success that a row has over SARL, on the same episodes and seeds; nothing for SARL itself."""
    nothing = {"difference": None}
    if name == "sarl" or "sarl" not in rows:
        return nothing
    ours, sarl = rows[name], rows["sarl"]
    shared = [seed for seed in ours.seeds if seed in sarl.seeds]
    if not shared or ours.outcome.shape[1] != sarl.outcome.shape[1]:
        return nothing
    one, other = (t.success[[t.seeds.index(seed) for seed in shared]] for t in (ours, sarl))
    found = paired_difference(one, other, rng)
    reported = [np.mean(table.paper[row]["success"]) for row in (name, "sarl")]
    difference = {**vars(found), "seeds": shared, "paper": float(reported[0] - reported[1]), "verdict": "inconclusive"}
    if len(shared) >= SEEDS_NEEDED:
        new = (new_runs(rates.mean(axis=1), table.test_episodes, rng) for rates in (one, other))
        low, high = percentiles(next(new) - next(new))
        difference |= {"expected": [low, high], "verdict": _judge(low, high, (difference["paper"],))}
    return {"difference": difference}


# What the paper says forces in the state and the SFM reward do, as differences between table 1's rows: the mean, over
# the pairs, of the first less the second.
CONTRASTS = {
    "forces in the state": (("sarl-sfm5", "sarl"), ("sarl-sfm6", "sarl-sfm2")),
    "SFM reward": (("sarl-sfm2", "sarl"), ("sarl-sfm6", "sarl-sfm5")),
}
CONTRASTED = (
    "success",
    "start_success",
    "early_success",
    "early_training_success",
    "drops",
    "reached_episodes",
    "navigation_time",
)


def contrasts(rows: dict[str, Trained]) -> list[dict[str, Any]]:
    """What forces in the state and the SFM reward change, with intervals over the seeds that all their rows have."""
    found = []
    for what, pairs in CONTRASTS.items():
        if not all(name in rows for pair in pairs for name in pair):
            continue
        shared = [s for s in rows["sarl"].seeds if all(s in rows[name].seeds for pair in pairs for name in pair)]
        values = {name: figures(rows[name]) for pair in pairs for name in pair}
        for metric in CONTRASTED:
            rng = np.random.default_rng(0)
            by_seed = np.mean(
                [_of(values, rows, a, metric, shared) - _of(values, rows, b, metric, shared) for a, b in pairs], axis=0
            )
            found.append({"of": what, "in": metric, **_over_seeds(by_seed, rng)})
    return found


def _of(values: dict, rows: dict[str, Trained], name: str, metric: str, seeds: list[int]) -> np.ndarray:
    return values[name][metric][[rows[name].seeds.index(seed) for seed in seeds]]
