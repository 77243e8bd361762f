"""95 % intervals of rates and means, and differences between policies with their p-values.

Means over training seeds have Student's t interval, rates of test episodes Wilson's. Two policies on the same episodes
are compared in pairs: success by Tango's interval and the exact McNemar test, navigation time by Student's t. Where
values are too few to show a spread, there is no interval (None).
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

LEVEL = 0.95
Z = 1.959964  # the normal distribution's quantile for LEVEL, two-sided
EXACT_BELOW = 25  # pairs; for fewer, p is at least that of the exact sign test
ROUNDING = 1e-9  # values that differ by less are equal
HALVINGS = 60  # in a bisection, to the last bits of a float


def wilson(successes: int, trials: int, z: float = Z) -> tuple[float, float]:
    """Return the Wilson score interval of a rate, 95 % by default (Wilson, 1927)."""
    if trials == 0:
        return 0.0, 1.0
    rate, spread = successes / trials, z * z / trials
    centre = (rate + spread / 2) / (1 + spread)
    half = z * math.sqrt(rate * (1 - rate) / trials + spread / (4 * trials)) / (1 + spread)
    return max(centre - half, 0.0), min(centre + half, 1.0)


def t_within(t: float, degrees: int) -> float:
    """Return P(|T| <= t) of Student's t with `degrees` of freedom (Abramowitz and Stegun, 26.7.3 and 26.7.4)."""
    angle, odd = math.atan(t / math.sqrt(degrees)), degrees % 2
    first = 0.0 if degrees == 1 else math.cos(angle) if odd else 1.0
    k = np.arange(2 + odd, degrees, 2)
    series = math.sin(angle) * first * (1 + float(np.cumprod((k - 1) / k * math.cos(angle) ** 2).sum()))
    return 2 / math.pi * (angle + series) if odd else series


@cache
def t_quantile(degrees: int) -> float:
    """Find the t for which P(|T| <= t) is 0.95, by bisection of the angle atan(t / sqrt(degrees))."""
    low, high = 0.0, math.pi / 2
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        below = t_within(math.sqrt(degrees) * math.tan(middle), degrees) < LEVEL
        low, high = (middle, high) if below else (low, middle)
    return math.sqrt(degrees) * math.tan(low)


def mean_interval(
    values: np.ndarray, least: float = -math.inf, most: float = math.inf
) -> tuple[float, float] | tuple[None, None]:
    """Return Student's t interval of the mean of `values` (S,), cut to the possible values `least` to `most`.

    Fewer than two values, or equal ones, show no spread: the interval is then (None, None).
    """
    values = np.asarray(values, dtype=float)
    if len(values) < 2 or np.ptp(values) < ROUNDING:
        return None, None
    mean, half = float(values.mean()), t_quantile(len(values) - 1) * _standard_error(values)
    return max(mean - half, least), min(mean + half, most)


def _standard_error(values: np.ndarray) -> float:
    return float(values.std(ddof=1)) / math.sqrt(len(values))


@dataclass(frozen=True)
class Difference:
    """A mean difference, its 95 % interval (None where there is none), and the two-sided p-value of no difference."""

    mean: float
    low: float | None
    high: float | None
    p: float


def mean_difference(gaps: np.ndarray) -> Difference:
    """Return the mean of paired differences `gaps` (N,), N >= 1, Student's t interval and the t-test's p-value.

    Where there is no interval, p is that of the sign test: 1 for a single pair.
    """
    gaps = np.asarray(gaps, dtype=float)
    mean, (low, high) = float(gaps.mean()), mean_interval(gaps)
    if low is None:
        return Difference(mean, None, None, _sign_test_of(gaps))
    return Difference(mean, low, high, max(0.0, 1 - t_within(abs(mean) / _standard_error(gaps), len(gaps) - 1)))


def episode_difference(gaps: np.ndarray) -> Difference:
    """Return `mean_difference` of episodes, whose `gaps` (N,) are multiples of a time step and not normal.

    With fewer than 25 pairs, p is the larger of the t-test's and the exact sign test's.
    """
    found = mean_difference(gaps)
    if len(gaps) >= EXACT_BELOW:
        return found
    return _with_exact(found.mean, found.low, found.high, max(found.p, _sign_test_of(np.asarray(gaps))))


def success_difference(only_one: int, only_other: int, episodes: int) -> Difference:
    """Return the success rate of one policy less that of another in the same `episodes`.

    `only_one` and `only_other` count the episodes in which one policy alone succeeds. The interval is Tango's (1998);
    p is that of the exact McNemar test, which is the sign test on the episodes that differ.
    """
    low, high = (_tango_limit(only_one, only_other, episodes, bound) for bound in (-1.0, 1.0))
    return _with_exact((only_one - only_other) / episodes, low, high, sign_test(only_one, only_other))


def _tango_limit(only_one: int, only_other: int, episodes: int, bound: float) -> float:
    """Find the last difference on the way to `bound` (1 or -1) that the score test does not reject, by bisection.

    The test of a difference `delta` takes its variance from the likeliest rates whose difference is `delta`.
    """
    near, far = (only_one - only_other) / episodes, bound
    for _ in range(HALVINGS):
        delta = (near + far) / 2
        b = (2 * episodes - only_one + only_other) * delta - only_one - only_other
        root = math.sqrt(max(b * b + 8 * episodes * only_other * delta * (1 - delta), 0.0))
        likeliest = (root - b) / (4 * episodes)  # rate of episodes in which the other one alone succeeds
        variance = episodes * (2 * likeliest + delta * (1 - delta))
        inside = (only_one - only_other - episodes * delta) ** 2 < Z * Z * variance
        near, far = (delta, far) if inside else (near, delta)
    return near


def _with_exact(mean: float, low: float | None, high: float | None, p: float) -> Difference:
    """Return a difference with the p-value of an exact test, and its interval widened to 0 unless p rejects 0."""
    if low is not None and p > 1 - LEVEL:
        low, high = min(low, 0.0), max(high, 0.0)
    return Difference(mean, low, high, p)


def sign_test(ups: int, downs: int) -> float:
    """Return the exact two-sided p-value of `ups` and `downs`, if both were equally likely."""
    n = ups + downs
    logs = (math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1) for k in range(min(ups, downs) + 1))
    return min(1.0, 2 * sum(math.exp(log - n * math.log(2)) for log in logs))


def _sign_test_of(gaps: np.ndarray) -> float:
    return sign_test(int((gaps > ROUNDING).sum()), int((gaps < -ROUNDING).sum()))


def holm(p_values: np.ndarray) -> np.ndarray:
    """Return p-values (n,) adjusted for being several (Holm, 1979)."""
    p_values = np.asarray(p_values, dtype=float)
    order = np.argsort(p_values)
    adjusted = np.maximum.accumulate(p_values[order] * np.arange(len(order), 0, -1))
    result = np.empty_like(p_values)
    result[order] = np.minimum(adjusted, 1.0)
    return result


def next_run(rates: np.ndarray, trials: int) -> tuple[float, float]:
    """Return the mean of the seeds' `rates` (S,), S >= 2, and the half-width of the 95 % range of one more run's rate.

    That run is tested on `trials` other episodes. The variance adds up the spread of the seeds, the error of their
    mean, and the chance of a test, whose rate has Agresti and Coull's (1998) correction away from 0 and 1.
    """
    rates = np.asarray(rates, dtype=float)
    mean = float(rates.mean())
    likely = (mean * trials + 2) / (trials + 4)
    variance = rates.var(ddof=1) * (1 + 1 / len(rates)) + likely * (1 - likely) / trials
    return mean, t_quantile(len(rates) - 1) * math.sqrt(variance)
