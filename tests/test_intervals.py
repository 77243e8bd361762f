"""Intervals and p-values: held to SciPy's, to closed forms, to brute force, and to how often they should be right."""

from itertools import combinations

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from sfmrl.intervals import RESAMPLES, holm, mean_interval, new_runs, paired_difference, percentiles, wilson


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@given(st.integers(0, 200), st.integers(1, 200))
def test_wilson_is_scipys(successes, trials):
    successes = min(successes, trials)
    theirs = scipy.stats.binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert wilson(successes, trials) == pytest.approx((theirs.low, theirs.high), abs=1e-6)


def test_the_interval_of_a_mean_is_scipys_percentile_bootstrap():
    values = rng(3).normal(0.9, 0.05, size=10)
    theirs = scipy.stats.bootstrap(
        (values,), np.mean, method="percentile", n_resamples=100_000, rng=rng(1)
    ).confidence_interval
    assert mean_interval(values, rng()) == pytest.approx((theirs.low, theirs.high), abs=1.5e-3)


def test_of_one_value_there_is_no_interval():
    assert np.isnan(mean_interval([0.9], rng())).all()
    assert np.isnan(mean_interval([], rng())).all()


def test_with_one_seed_a_difference_is_the_bootstrap_of_its_episodes():
    draws = rng(5)
    one, other = draws.random((1, 300)) < 0.9, draws.random((1, 300)) < 0.8
    found = paired_difference(one, other, rng())
    gaps = (one.astype(float) - other)[0]
    theirs = scipy.stats.bootstrap(
        (gaps,), np.mean, method="percentile", n_resamples=50_000, rng=rng(1)
    ).confidence_interval
    assert found.mean == pytest.approx(gaps.mean())
    assert (found.low, found.high) == pytest.approx((theirs.low, theirs.high), abs=4e-3)


def test_seeds_and_episodes_both_widen_a_difference():
    seeds, episodes = 6, 80
    draws = rng(2)
    by_seed, by_episode = draws.normal(size=(seeds, 1)), draws.normal(size=(1, episodes))
    gaps = by_seed + by_episode
    found = paired_difference(gaps, np.zeros_like(gaps), rng())
    spread = np.sqrt(by_seed.var() / seeds + by_episode.var() / episodes)  # both sums are resampled independently
    assert (found.high - found.low) / (2 * 1.96) == pytest.approx(spread, rel=0.05)


def test_seeds_and_episodes_are_drawn_as_if_one_by_one():
    gaps = rng(7).normal(size=(3, 4))
    found = paired_difference(gaps, np.zeros_like(gaps), rng())
    draws = rng(8)
    plain = [gaps[draws.integers(3, size=3)][:, draws.integers(4, size=4)].mean() for _ in range(20_000)]
    assert (found.low, found.high) == pytest.approx(percentiles(np.array(plain)), abs=0.03)


def test_p_is_small_where_all_agree_and_one_where_nothing_differs():
    same = paired_difference(np.ones((4, 50)), np.ones((4, 50)), rng())
    assert (same.mean, same.low, same.high, same.p) == (0, 0, 0, 1)
    apart = paired_difference(np.ones((4, 50)), np.zeros((4, 50)), rng())
    assert (apart.mean, apart.low, apart.high) == (1, 1, 1)
    assert apart.p == pytest.approx(2 / (1 + RESAMPLES))


def test_differences_of_nothing_are_rarely_called_significant():
    """Where seeds and episodes differ, about one in twenty; where all is chance, fewer (see `paired_difference`)."""
    draws = rng(11)
    called = {"effects": 0, "chance": 0}
    for trial in range(100):
        effects = draws.normal(size=(12, 1)) + draws.normal(size=(1, 30))
        chance = draws.normal(size=(12, 30))
        for kind, gaps in (("effects", effects), ("chance", chance)):
            called[kind] += paired_difference(gaps, np.zeros_like(gaps), rng(trial)).p < 0.05
    assert 1 <= called["effects"] <= 12
    assert called["chance"] <= 5


def closed_testing(p_values: np.ndarray) -> np.ndarray:
    """Holm's adjusted p-values by their definition: the largest Bonferroni p of all sets with the hypothesis in."""
    n = len(p_values)
    sets = [s for size in range(1, n + 1) for s in combinations(range(n), size)]
    return np.array([max(min(1, len(s) * min(p_values[list(s)])) for s in sets if i in s) for i in range(n)])


@given(st.lists(st.floats(0, 1), min_size=1, max_size=6))
def test_holm_is_closed_testing(p_values):
    p_values = np.array(p_values)
    np.testing.assert_allclose(holm(p_values), closed_testing(p_values))


def test_new_runs_spread_as_seeds_and_a_binomial_test_do():
    rates = rng(4).normal(0.7, 0.05, size=200).clip(0, 1)
    draws = new_runs(rates, 100, rng())
    assert draws.mean() == pytest.approx(rates.mean(), abs=0.005)
    variance = rates.var(ddof=1) * (1 + 1 / len(rates)) + np.mean(rates * (1 - rates)) / 100
    assert draws.var() == pytest.approx(variance, rel=0.1)
    assert new_runs([1.0, 1.0], 100, rng()).min() == 1


def test_resampling_is_repeatable():
    values = np.array([0.9, 0.95, 0.8])
    assert mean_interval(values, rng(1)) == mean_interval(values, rng(1))
