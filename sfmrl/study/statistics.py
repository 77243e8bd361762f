"""95 % intervals, tests of differences with their p-values, and the statistics of a table's runs.

Means over training seeds have Student's t interval, rates of test episodes Wilson's. Two policies on the same episodes
are compared in pairs: success by Tango's interval and the exact McNemar test, navigation time by Student's t. Rows of a
table are paired by seed; their intervals say what other training seeds would change on the same test episodes.

A figure is a dict of plain values: its `mean`, the ends `low` and `high` of the mean's interval (None where the values
show no spread), and for a difference the two-sided p-value `p` of no difference.
"""

import math
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np

from sfmrl.evaluation import Z, wilson
from sfmrl.study.tables import Figures, Table

LEVEL = 0.95
ROUNDING = 1e-9  # values that differ by less are equal
HALVINGS = 60  # in a bisection, to the last bits of a float
SEEDS_NEEDED = 5  # for a verdict on the paper
WIDEST = 0.1  # a figure within a wider range of expected success is inconclusive
UNDECIDED = {"expected": None, "verdict": "inconclusive"}
NO_RATES = ("navigation_time", "total_reward", "reached")  # prefixes of metrics that are no rates
# The effect of an ingredient: the mean, over pairs of table 1's rows, of the first row less the second.
CONTRASTS = {
    "forces in the state": (("sarl-sfm5", "sarl"), ("sarl-sfm6", "sarl-sfm2")),
    "SFM reward": (("sarl-sfm2", "sarl"), ("sarl-sfm6", "sarl-sfm5")),
}
CONTRASTED = {
    "success": "success in the test",
    "collision": "collisions in the test",
    "start_success": "validation after imitation",
    "early_success": "validation, first quarter",
    "course_success": "validation, mean of all",
    "early_training_success": "exploration, first quarter",
    "drops": "drop between validations",
    "reached_episodes": "episodes until validation 0.9",
    "navigation_time": "navigation time, s",
}


def t_within(t: float, degrees: int) -> float:
    """Return P(|T| <= t) of Student's t with `degrees` of freedom (Abramowitz and Stegun, 26.7.3 and 26.7.4)."""
    angle, odd = math.atan(t / math.sqrt(degrees)), degrees % 2
    first = 0.0 if degrees == 1 else math.cos(angle) if odd else 1.0
    k = np.arange(2 + odd, degrees, 2)
    series = math.sin(angle) * first * (1 + float(np.cumprod((k - 1) / k * math.cos(angle) ** 2).sum()))
    return 2 / math.pi * (angle + series) if odd else series


@cache
def t_quantile(degrees: int) -> float:
    """Return the t for which P(|T| <= t) is 0.95, by bisection of the angle atan(t / sqrt(degrees))."""
    root = math.sqrt(degrees)
    return root * math.tan(_last(lambda angle: t_within(root * math.tan(angle), degrees) < LEVEL, 0.0, math.pi / 2))


def _last(holds: Callable[[float], bool], near: float, far: float) -> float:
    """Return the farthest number from `near` towards `far` for which a condition holds, by bisection."""
    for _ in range(HALVINGS):
        middle = (near + far) / 2
        near, far = (middle, far) if holds(middle) else (near, middle)
    return near


def mean_interval(
    values: np.ndarray, least: float = -math.inf, most: float = math.inf
) -> tuple[float, float] | tuple[None, None]:
    """Return Student's t interval of the mean of `values` (S,), cut to the possible values `least` to `most`.

    The interval is (None, None) for fewer than two values and for equal ones, which show no spread.
    """
    values = np.asarray(values, dtype=float)
    if len(values) < 2 or np.ptp(values) < ROUNDING:
        return None, None
    mean, half = float(values.mean()), t_quantile(len(values) - 1) * _standard_error(values)
    return max(mean - half, least), min(mean + half, most)


def _standard_error(values: np.ndarray) -> float:
    return float(values.std(ddof=1)) / math.sqrt(len(values))


def mean_difference(gaps: np.ndarray, exact_below: int = 0, most: float = math.inf) -> dict[str, Any]:
    """Return the figure of paired differences `gaps` (N,), N >= 1: Student's t interval, p of the t-test.

    The interval is cut to differences from -`most` to `most`. Where there is none, p is that of the exact sign test: 1
    for a single pair. With fewer than `exact_below` pairs, p is the larger of the two, for differences that are far
    from normal, such as multiples of a time step.
    """
    gaps = np.asarray(gaps, dtype=float)
    mean, (low, high) = float(gaps.mean()), mean_interval(gaps, -most, most)
    exact = sign_test(int((gaps > ROUNDING).sum()), int((gaps < -ROUNDING).sum()))
    if low is None or high is None:  # both or none
        return {"mean": mean, "low": None, "high": None, "p": exact}
    p = max(0.0, 1 - t_within(abs(mean) / _standard_error(gaps), len(gaps) - 1))
    return _difference(mean, low, high, max(p, exact) if len(gaps) < exact_below else p)


def success_difference(only_one: int, only_other: int, episodes: int) -> dict[str, Any]:
    """Return the figure of one policy's success rate less another's in the same `episodes`.

    `only_one` and `only_other` count the episodes in which one policy alone succeeds. The interval is Tango's (1998);
    p is that of the exact McNemar test, which is the sign test on the episodes that differ.
    """

    def accepted(delta: float) -> bool:
        """Return whether the score test, with the likeliest rates whose difference is `delta`, does not reject it."""
        # The likeliest rate q of `only_other` solves 2 n q^2 + b q = only_other delta (1 - delta).
        b = (2 * episodes - only_one + only_other) * delta - only_one - only_other
        root = math.sqrt(max(b * b + 8 * episodes * only_other * delta * (1 - delta), 0.0))
        likeliest = (root - b) / (4 * episodes)
        variance = episodes * (2 * likeliest + delta * (1 - delta))
        return (only_one - only_other - episodes * delta) ** 2 < Z * Z * variance

    mean = (only_one - only_other) / episodes
    return _difference(mean, _last(accepted, mean, -1.0), _last(accepted, mean, 1.0), sign_test(only_one, only_other))


def _difference(mean: float, low: float, high: float, p: float) -> dict[str, Any]:
    """Return a figure whose interval is widened to 0 where p, which may come from another test, does not reject 0."""
    if p > 1 - LEVEL:
        low, high = min(low, 0.0), max(high, 0.0)
    return {"mean": mean, "low": low, "high": high, "p": p}


def sign_test(ups: int, downs: int) -> float:
    """Return the exact two-sided p-value of `ups` and `downs`, if both were equally likely."""
    n = ups + downs
    logs = (math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1) for k in range(min(ups, downs) + 1))
    return min(1.0, 2 * sum(math.exp(log - n * math.log(2)) for log in logs))


def holm(differences: Iterable[dict[str, Any] | None]) -> None:
    """Add to each difference that is not None its p-value adjusted for being one of several (Holm, 1979), `p_holm`."""
    known, adjusted = sorted(filter(None, differences), key=lambda difference: difference["p"]), 0.0
    for rank, difference in enumerate(known):
        adjusted = min(1.0, max(adjusted, difference["p"] * (len(known) - rank)))
        difference["p_holm"] = adjusted


def next_run(rates: np.ndarray, trials: int) -> tuple[float, float]:
    """Return the mean of the seeds' `rates` (S,), S >= 2, and the half-width of the 95 % range of one more run's rate.

    That run is tested on `trials` other episodes. The variance adds up the spread of the seeds, the error of their
    mean, and the chance of a test, whose rate has Agresti and Coull's (1998) correction away from 0 and 1. This is an
    approximation: the spread already holds the chance of each seed's test, but not of the episodes that all share.
    """
    rates = np.asarray(rates, dtype=float)
    mean = float(rates.mean())
    likely = (mean * trials + 2) / (trials + 4)
    variance = rates.var(ddof=1) * (1 + 1 / len(rates)) + likely * (1 - likely) / trials
    return mean, t_quantile(len(rates) - 1) * math.sqrt(variance)


def summarise(table: Table, rows: dict[str, Figures]) -> list[dict[str, Any]]:
    """Return each row's name, the paper's figures and ours as plain values, ready for JSON; None for no value."""
    summary = []
    for name, row in rows.items():
        hits = np.round(row.values["success"] * row.test_episodes)
        summary.append(
            {
                "row": name,
                "paper": table.paper[name],
                "seeds": row.seeds,
                "test_episodes": row.test_episodes,
                "figures": {m: _over_seeds(v, *_bounds(m, 0.0)) for m, v in row.values.items()},
                "wilson": [list(wilson(int(count), row.test_episodes)) for count in hits],
                "wilson_of_mean": list(wilson(round(hits.mean()), row.test_episodes)),
                **_verdict(table, name, row.values["success"]),
                "difference": _less_sarl(table, name, rows),
            }
        )
    holm(row["difference"] for row in summary)
    return summary


def _bounds(metric: str, least: float) -> tuple[float, float]:
    """Return the possible values of a metric: `least` to 1 for a rate, any for others."""
    return (-math.inf, math.inf) if metric.startswith(NO_RATES) else (least, 1.0)


def _over_seeds(values: np.ndarray, least: float, most: float) -> dict[str, Any]:
    """Return the figure of the seeds that have a value, with their standard `deviation` and all `values`."""
    known = values[np.isfinite(values)]
    low, high = mean_interval(known, least, most)
    mean = float(known.mean()) if len(known) else None
    deviation = float(known.std(ddof=1)) if len(known) > 1 else None
    every = [float(value) if np.isfinite(value) else None for value in values]
    return {"mean": mean, "low": low, "high": high, "deviation": deviation, "values": every}


def _verdict(table: Table, name: str, rates: np.ndarray) -> dict[str, Any]:
    """Judge whether one more run of ours, tested on as many episodes as the paper's, could have the paper's success."""
    if len(rates) < SEEDS_NEEDED:
        return UNDECIDED
    mean, half = next_run(rates, table.test_episodes)
    reported = table.paper[name]["success"]
    return _judge(max(mean - half, 0.0), min(mean + half, 1.0), reported, _rounding(reported))


def _rounding(reported: tuple[float, ...]) -> float:
    """Return how far the figures that the paper gives, to two or three digits, may be from its exact ones."""
    return 0.005 if all(abs(value - round(value, 2)) < ROUNDING for value in reported) else 0.0005


def _judge(low: float, high: float, reported: tuple[float, ...], rounding: float) -> dict[str, Any]:
    """Return whether all the reported figures, exact up to `rounding`, are consistent with the expected range."""
    if not all(low - rounding <= value <= high + rounding for value in reported):
        verdict = "inconsistent"
    else:
        verdict = "inconclusive" if high - low > WIDEST else "consistent"
    return {"expected": [low, high], "verdict": verdict}


def _less_sarl(table: Table, name: str, rows: dict[str, Figures]) -> dict[str, Any] | None:
    """Return a row's success minus SARL's, paired by seed; None for SARL itself and where nothing can be paired.

    That is so without shared seeds, and if the two were tested on different numbers of episodes. The verdict is on one
    more run of each row, which are not paired, as the paper's are not.
    """
    if name == "sarl" or "sarl" not in rows:
        return None
    ours, sarl = rows[name], rows["sarl"]
    shared = [seed for seed in ours.seeds if seed in sarl.seeds]
    if not shared or ours.test_episodes != sarl.test_episodes:
        return None
    one, other = (row.of("success", shared) for row in (ours, sarl))
    reported, baseline = table.paper[name]["success"], table.paper["sarl"]["success"]
    paper = float(np.mean(reported) - np.mean(baseline))
    difference = mean_difference(one - other, most=1.0) | {"seeds": shared, "paper": paper} | UNDECIDED
    if len(shared) >= SEEDS_NEEDED:
        (mean, half), (sarl_mean, sarl_half) = (next_run(rates, table.test_episodes) for rates in (one, other))
        low, high = (mean - sarl_mean + sign * math.hypot(half, sarl_half) for sign in (-1, 1))
        difference |= _judge(low, high, (paper,), _rounding(reported) + _rounding(baseline))
    return difference


def contrasts(rows: dict[str, Figures]) -> list[dict[str, Any]]:
    """Return the effect of each ingredient on each metric, paired by the seeds that all four rows have.

    Its mean is None if one of these trainings lacks the metric: it would be that of the better ones alone.
    """
    names = {name for pairs in CONTRASTS.values() for pair in pairs for name in pair}
    if not names <= set(rows):
        return []
    shared = [seed for seed in rows["sarl"].seeds if all(seed in rows[name].seeds for name in names)]
    effects = []
    for ingredient, pairs in CONTRASTS.items():
        for metric in CONTRASTED:
            by_seed = np.mean([rows[a].of(metric, shared) - rows[b].of(metric, shared) for a, b in pairs], axis=0)
            by_seed = by_seed if np.isfinite(by_seed).all() else np.full(len(by_seed), np.nan)
            figure = _over_seeds(by_seed, *_bounds(metric, -1.0))
            p = None if figure["low"] is None else mean_difference(by_seed)["p"]
            effects.append({"of": ingredient, "in": metric, **figure, "p": p})
    holm(effect for effect in effects if effect["p"] is not None)
    return effects
