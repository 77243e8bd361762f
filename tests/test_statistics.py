"""Intervals and p-values: held to SciPy's, to closed forms, to brute force, and to how often they should be right."""

from itertools import combinations

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from sfmrl.evaluation import wilson
from sfmrl.study.statistics import (
    holm,
    mean_difference,
    mean_interval,
    next_run,
    sign_test,
    success_difference,
    t_quantile,
    t_within,
)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@given(st.integers(0, 200), st.integers(1, 200))
def test_wilson_is_scipys(successes, trials):
    successes = min(successes, trials)
    theirs = scipy.stats.binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert wilson(successes, trials) == pytest.approx((theirs.low, theirs.high), abs=1e-6)


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 9, 10, 499, 10_000])
def test_students_t_is_scipys(degrees):
    assert t_quantile(degrees) == pytest.approx(scipy.stats.t.ppf(0.975, degrees), rel=1e-9)
    for t in (0.0, 0.1, 1.0, 2.5, 20.0):
        assert t_within(t, degrees) == pytest.approx(1 - 2 * scipy.stats.t.sf(t, degrees), abs=1e-12)


@pytest.mark.parametrize("seeds", [2, 3, 5, 10])
def test_the_interval_and_the_p_value_of_a_mean_are_scipys(seeds):
    gaps = rng(seeds).normal(0.02, 0.03, size=seeds)
    theirs = scipy.stats.ttest_1samp(gaps, 0)
    low, high = theirs.confidence_interval()
    expected = {"mean": gaps.mean(), "low": low, "high": high, "p": theirs.pvalue}
    assert mean_difference(gaps) == pytest.approx(expected)
    assert mean_interval(gaps) == pytest.approx((low, high))


@pytest.mark.parametrize("seeds", [3, 5, 10])
def test_the_interval_of_a_mean_holds_the_true_one_in_95_percent_of_simulated_tables(seeds):
    draws = rng(1).normal(size=(8000, seeds))
    tested = rng(2).binomial(500, rng(3).normal(0.95, 0.02, size=(8000, seeds)).clip(0, 1)) / 500
    for values, true in ((draws, 0.0), (tested, 0.95)):
        ends = np.array([mean_interval(value) for value in values], dtype=float)  # none is NaN, and holds nothing
        assert 0.94 <= ((ends[:, 0] <= true) & (true <= ends[:, 1])).mean() <= 0.97


@pytest.mark.parametrize("values", [[], [0.9], [0.994] * 10, [0.996 - 0.994, 0.998 - 0.996]])
def test_values_that_show_no_spread_have_no_interval(values):
    assert mean_interval(values) == (None, None)


def test_an_interval_is_cut_to_what_is_possible():
    assert mean_interval([0.99, 1.0, 0.98], 0.0, 1.0)[1] == 1.0


@given(st.integers(0, 60), st.integers(0, 60))
def test_the_sign_test_is_scipys(ups, downs):
    theirs = scipy.stats.binomtest(ups, ups + downs).pvalue if ups + downs else 1.0
    assert sign_test(ups, downs) == pytest.approx(theirs)


def score(only_one: int, only_other: int, episodes: int, delta: float) -> float:
    """z of a difference `delta`, with the likeliest rates that have it found among very many."""
    q = np.linspace(max(0.0, -delta), min(1.0, (1 - delta) / 2 if delta > -1 else 1.0), 200_001)[1:-1]  # other's alone
    same = np.maximum(1 - 2 * q - delta, 1e-300)
    likelihood = only_other * np.log(q) + (episodes - only_one - only_other) * np.log(same)
    likelihood += only_one * np.log(np.maximum(q + delta, 1e-300))
    best = q[likelihood.argmax()]
    return (only_one - only_other - episodes * delta) / np.sqrt(episodes * (2 * best + delta - delta**2))


@pytest.mark.parametrize(("one", "other", "episodes"), [(12, 2, 50), (37, 9, 200), (1, 13, 30), (8, 0, 100)])
def test_tangos_limits_are_the_differences_whose_score_is_just_significant(one, other, episodes):
    found = success_difference(one, other, episodes)
    z = [score(one, other, episodes, found[end]) for end in ("low", "high")]
    assert z == pytest.approx([1.96, -1.96], abs=0.01)


@pytest.mark.parametrize("alone", [(0.01, 0.01), (0.03, 0.0), (0.05, 0.02), (0.3, 0.2)])
def test_the_interval_of_a_difference_in_success_holds_the_true_one(alone):
    counts = np.array([(one, other, 50 - one - other) for one in range(51) for other in range(51 - one)])
    chances = scipy.stats.multinomial(50, [*alone, 1 - sum(alone)]).pmf(counts)
    likely = chances > 1e-5
    found = [success_difference(*count[:2].tolist(), 50) for count in counts[likely]]
    holds = [gap["low"] <= alone[0] - alone[1] <= gap["high"] for gap in found]
    assert np.average(holds, weights=chances[likely]) >= 0.94
    if alone[0] == alone[1]:
        assert np.average([gap["p"] < 0.05 for gap in found], weights=chances[likely]) <= 0.05


def test_few_differing_episodes_are_no_proof_and_none_leave_much_open():
    assert success_difference(0, 4, 20)["p"] == 0.125
    for episodes in (20, 500):
        most = wilson(0, episodes)[1]
        assert success_difference(0, 0, episodes) == pytest.approx({"mean": 0, "low": -most, "high": most, "p": 1})


@given(st.integers(0, 100), st.integers(0, 100))
def test_the_interval_of_success_leaves_out_0_where_the_exact_test_does(one, other):
    mean, low, high, p = success_difference(one, other, 200).values()
    assert (low <= 0 <= high) == (p > 0.05)
    assert -1 <= low <= mean <= high <= 1
    assert high - low > 0.01


def test_few_pairs_of_times_are_no_proof():
    assert mean_difference([-7.0], 25) == {"mean": -7, "low": None, "high": None, "p": 1}
    mean, low, high, p = mean_difference([-7.0, -7.25], 25).values()
    assert p == 0.5
    assert low < mean < high == 0
    assert mean_difference(np.zeros(500), 25) == {"mean": 0, "low": None, "high": None, "p": 1}


@pytest.mark.parametrize("pairs", [2, 5, 24, 100])
def test_times_that_differ_by_chance_are_rarely_called_different(pairs):
    gaps = np.round(4 * rng(5).standard_t(3, size=(1000, pairs))) / 4  # heavy tails, in steps of 0.25 s
    assert np.mean([mean_difference(gap, 25)["p"] < 0.05 for gap in gaps]) <= 0.06


@given(st.lists(st.floats(0, 1), min_size=1, max_size=6))
def test_holm_is_closed_testing(p_values):
    """The largest Bonferroni p of all sets with the hypothesis in."""
    n, p = len(p_values), np.array(p_values)
    sets = [s for size in range(1, n + 1) for s in combinations(range(n), size)]
    expected = [max(min(1, len(s) * min(p[list(s)])) for s in sets if i in s) for i in range(n)]
    found = [{"p": each} for each in p_values]
    holm(found)
    np.testing.assert_allclose([gap["p_holm"] for gap in found], expected)


@pytest.mark.parametrize("seeds", [5, 10])
def test_another_run_is_found_in_the_range_that_is_expected(seeds):
    tables = rng(6).normal(0.9, 0.03, size=(2000, seeds + 1)).clip(0, 1)
    rates = rng(7).binomial(500, tables) / 500
    ranges = np.array([next_run(row[:-1], 500) for row in rates])
    assert 0.95 <= (abs(rates[:, -1] - ranges[:, 0]) <= ranges[:, 1]).mean() <= 0.99
    assert next_run([1.0] * 5, 100)[1] > 0
