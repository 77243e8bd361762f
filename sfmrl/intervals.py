"""How sure is a number: intervals of rates and of means over training seeds, and differences between policies.

Rates are from test episodes, which are the same for every policy and every training seed. So a difference is taken
episode by episode, and what it would be with other seeds and other episodes is estimated by resampling both.
"""

import math
from dataclasses import dataclass

import numpy as np

RESAMPLES = 10_000
CHUNK = 1_000  # resamples held in memory at a time


def wilson(successes: int, trials: int, z: float = 1.959964) -> tuple[float, float]:
    """The Wilson score interval of a rate, 95 % by default (Wilson, 1927)."""
    if trials == 0:
        return 0.0, 1.0
    rate, spread = successes / trials, z * z / trials
    centre = (rate + spread / 2) / (1 + spread)
    half = z * math.sqrt(rate * (1 - rate) / trials + spread / (4 * trials)) / (1 + spread)
    return max(centre - half, 0.0), min(centre + half, 1.0)


def mean_interval(values: np.ndarray, rng: np.random.Generator, level: float = 0.95) -> tuple[float, float]:
    """The percentile bootstrap interval of the mean of `values` (S,), one a training seed (Efron, 1979).

    A single value says nothing of its spread: the interval is then (NaN, NaN), as it is of no value at all.
    """
    values = np.asarray(values, dtype=float)
    if len(values) < 2:
        return math.nan, math.nan
    means = values[rng.integers(len(values), size=(RESAMPLES, len(values)))].mean(axis=1)
    return percentiles(means, level)


@dataclass(frozen=True)
class Difference:
    """A mean difference, its interval, and the two-sided p-value of no difference."""

    mean: float
    low: float
    high: float
    p: float


def paired_difference(one: np.ndarray, other: np.ndarray, rng: np.random.Generator, level: float = 0.95) -> Difference:
    """The mean of `one` - `other`, both (S, E): a row a training seed, a column a test episode.

    Seeds and then episodes are drawn with replacement, the same of both, so that all that seeds share with each other
    (the episodes) and policies share with each other (seed's demonstrations, episodes) is kept (Owen, 2007). What is
    chance in a single episode of a single seed is counted up to three times over: the interval errs on the wide side.
    The p-value is twice the share of resamples on the far side of 0. With one seed only episodes are drawn.
    """
    gaps = np.asarray(one, dtype=float) - np.asarray(other, dtype=float)
    means = np.concatenate([_resampled(gaps, rng, min(CHUNK, RESAMPLES - at)) for at in range(0, RESAMPLES, CHUNK)])
    below, above = (means <= 0).sum(), (means >= 0).sum()
    p = min(1.0, 2 * (1 + min(below, above)) / (1 + RESAMPLES))
    return Difference(float(gaps.mean()), *percentiles(means, level), float(p))


def _resampled(gaps: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """So many resampled means of (S, E), (count,); how often each row and column is drawn is multinomial."""
    by_seed, by_episode = (rng.multinomial(n, np.full(n, 1 / n), size=count) for n in gaps.shape)
    return np.einsum("be,be->b", by_seed @ gaps, by_episode) / gaps.size


def holm(p_values: np.ndarray) -> np.ndarray:
    """p-values (n,) adjusted for being the smallest of several (Holm, 1979)."""
    p_values = np.asarray(p_values, dtype=float)
    order = np.argsort(p_values)
    adjusted = np.maximum.accumulate(p_values[order] * np.arange(len(order), 0, -1))
    result = np.empty_like(p_values)
    result[order] = np.minimum(adjusted, 1.0)
    return result


def new_runs(rates: np.ndarray, trials: int, rng: np.random.Generator) -> np.ndarray:
    """Which rates further training runs would be found at, in a test of `trials` episodes: (RESAMPLES,) draws.

    `rates` (S,) are those of S >= 2 training seeds. A new seed's rate is a mean of resampled seeds plus one seed's
    departure from the mean (widened by sqrt(S / (S - 1)), as the S departures share their mean); its successes are
    binomial.
    """
    rates = np.asarray(rates, dtype=float)
    seeds = len(rates)
    means = rates[rng.integers(seeds, size=(RESAMPLES, seeds))].mean(axis=1)
    departures = (rates - rates.mean()) * math.sqrt(seeds / (seeds - 1))
    new = np.clip(means + departures[rng.integers(seeds, size=RESAMPLES)], 0, 1)
    return rng.binomial(trials, new) / trials


def percentiles(values: np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """The interval that holds the middle `level` of values (n,)."""
    low, high = np.quantile(values, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)
