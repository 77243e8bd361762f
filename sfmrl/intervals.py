"""How sure is a number: 95 % intervals of rates and of means, and differences between policies with their p-values.

Means over training seeds use Student's t; rates of test episodes Wilson's interval. Two policies that play the same
episodes are compared in pairs: by Tango's interval and the exact sign (McNemar) test for their success, by Student's t
for their times. Too few values have no interval (None), rather than one that pretends to be sure.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

LEVEL = 0.95
Z = 1.959964  # the normal distribution's quantile for LEVEL, two-sided
FEW = 25  # below so many pairs, the exact sign test has a say on means, too
EQUAL = 1e-9  # values within this range are the same but for rounding
HALVINGS = 60  # of a bisection: to the last bits of a float


def wilson(successes: int, trials: int, z: float = Z) -> tuple[float, float]:
    """The Wilson score interval of a rate, 95 % by default (Wilson, 1927)."""
    if trials == 0:
        return 0.0, 1.0
    rate, spread = successes / trials, z * z / trials
    centre = (rate + spread / 2) / (1 + spread)
    half = z * math.sqrt(rate * (1 - rate) / trials + spread / (4 * trials)) / (1 + spread)
    return max(centre - half, 0.0), min(centre + half, 1.0)


def t_within(t: float, degrees: int) -> float:
    """P(|T| <= t) of Student's t with `degrees` of freedom (Abramowitz and Stegun, 26.7.3 and 26.7.4)."""
    angle, odd = math.atan(t / math.sqrt(degrees)), degrees % 2
    first = 0.0 if degrees == 1 else math.cos(angle) if odd else 1.0
    k = np.arange(2 + odd, degrees, 2)
    series = math.sin(angle) * first * (1 + float(np.cumprod((k - 1) / k * math.cos(angle) ** 2).sum()))
    return 2 / math.pi * (angle + series) if odd else series


@cache
def t_quantile(degrees: int) -> float:
    """The t for which P(|T| <= t) is 0.95, by bisection over the angle atan(t / sqrt(degrees))."""
    low, high = 0.0, math.pi / 2
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        below = t_within(math.sqrt(degrees) * math.tan(middle), degrees) < LEVEL
        low, high = (middle, high) if below else (low, middle)
    return math.sqrt(degrees) * math.tan(low)


def mean_interval(
    values: np.ndarray, least: float = -math.inf, most: float = math.inf
) -> tuple[float, float] | tuple[None, None]:
    """Student's t interval of the mean of `values` (S,), cut to what is possible, `least` to `most`.

    Fewer than two values, or equal ones, say nothing of their spread: the interval is then (None, None).
    """
    values = np.asarray(values, dtype=float)
    if len(values) < 2 or np.ptp(values) < EQUAL:
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
    """The mean of paired differences `gaps` (N,), N >= 1, with Student's t interval and the p-value of the t-test.

    Where there is no interval, p is the sign test's: 1 for a single pair.
    """
    gaps = np.asarray(gaps, dtype=float)
    mean, (low, high) = float(gaps.mean()), mean_interval(gaps)
    if low is None:
        return Difference(mean, None, None, _sign_test_of(gaps))
    return Difference(mean, low, high, max(0.0, 1 - t_within(abs(mean) / _standard_error(gaps), len(gaps) - 1)))


def episode_difference(gaps: np.ndarray) -> Difference:
    """`mean_difference` for episodes, whose gaps (N,) are in steps and far from normal.

    Of fewer than 25 pairs, p is the larger one of the t-test's and the exact sign test's.
    """
    found = mean_difference(gaps)
    if len(gaps) >= FEW:
        return found
    return _with_exact(found.mean, found.low, found.high, max(found.p, _sign_test_of(np.asarray(gaps))))


def success_difference(only_one: int, only_other: int, episodes: int) -> Difference:
    """The success rate of one policy less that of another in the same `episodes`.

    `only_one` and `only_other` count the episodes in which one alone succeeds. The interval is Tango's (1998), p that
    of the exact McNemar test, which is the sign test on the episodes that differ.
    """
    mean = (only_one - only_other) / episodes
    limits = _tango(only_one, only_other, episodes, mean, 1.0), _tango(only_one, only_other, episodes, mean, -1.0)
    return _with_exact(mean, limits[1], limits[0], sign_test(only_one, only_other))


def _tango(only_one: int, only_other: int, episodes: int, mean: float, bound: float) -> float:
    """The difference between `mean` and `bound` (1 or -1) whose score test just rejects, by bisection.

    The score of a difference is that of the observed one under the likeliest rates that have this difference.
    """
    near, far = mean, bound
    for _ in range(HALVINGS):
        delta = (near + far) / 2
        b = (2 * episodes - only_one + only_other) * delta - only_one - only_other
        root = math.sqrt(max(b * b + 8 * episodes * only_other * delta * (1 - delta), 0.0))
        variance = episodes * (2 * (root - b) / (4 * episodes) + delta * (1 - delta))
        inside = (only_one - only_other - episodes * delta) ** 2 < Z * Z * variance
        near, far = (delta, far) if inside else (near, delta)
    return near


def _with_exact(mean: float, low: float | None, high: float | None, p: float) -> Difference:
    """A difference with the p-value of an exact test; the interval has 0 in it where p does not exclude it."""
    if low is not None and p > 1 - LEVEL:
        low, high = min(low, 0.0), max(high, 0.0)
    return Difference(mean, low, high, p)


def sign_test(ups: int, downs: int) -> float:
    """The exact two-sided p-value of so many ups and downs, were both equally likely."""
    n = ups + downs
    logs = (math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1) for k in range(min(ups, downs) + 1))
    return min(1.0, 2 * sum(math.exp(log - n * math.log(2)) for log in logs))


def _sign_test_of(gaps: np.ndarray) -> float:
    return sign_test(int((gaps > EQUAL).sum()), int((gaps < -EQUAL).sum()))


def holm(p_values: np.ndarray) -> np.ndarray:
    """p-values (n,) adjusted for being the smallest of several (Holm, 1979)."""
    p_values = np.asarray(p_values, dtype=float)
    order = np.argsort(p_values)
    adjusted = np.maximum.accumulate(p_values[order] * np.arange(len(order), 0, -1))
    result = np.empty_like(p_values)
    result[order] = np.minimum(adjusted, 1.0)
    return result


def next_run(rates: np.ndarray, trials: int) -> tuple[float, float]:
    """The mean of `rates` (S,), S >= 2, of training seeds, and how far from it another run's rate may be found (95 %).

    That run is tested on `trials` other episodes, so that the spread of the seeds, the error of their mean and the
    chance of a test (of a rate a little nearer to 0.5, as Agresti and Coull, 1998, have it) add up.
    """
    rates = np.asarray(rates, dtype=float)
    mean = float(rates.mean())
    likely = (mean * trials + 2) / (trials + 4)
    variance = rates.var(ddof=1) * (1 + 1 / len(rates)) + likely * (1 - likely) / trials
    return mean, t_quantile(len(rates) - 1) * math.sqrt(variance)
