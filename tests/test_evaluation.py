"""Metrics of a record made by hand, and the Wilson interval against SciPy."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from sfmrl.config import ConfigError, Reward, Simulation
from sfmrl.episodes import Record, play
from sfmrl.evaluation import RATES, episode_rows, evaluate, evaluation_record, metrics, wilson
from sfmrl.lookahead import SarlPolicy
from sfmrl.network import ValueNetwork
from sfmrl.policies import load_policy
from sfmrl.rewards import COLLISION, RUNNING, SUCCESS, TIMEOUT, Transition
from sfmrl.runs.files import csv_text
from sfmrl.scenes import Scenes, sample_scenes
from sfmrl.variants import make_config


@given(st.integers(1, 2000), st.data())
def test_wilson_interval_is_scipy_s(trials, data):
    successes = data.draw(st.integers(0, trials))
    expected = binomtest(successes, trials).proportion_ci(method="wilson")
    low, high = wilson(successes, trials)
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=1e-6)
    assert 0 <= low <= successes / trials <= high <= 1


def test_wilson_interval_without_trials_is_everything():
    assert wilson(0, 0) == (0.0, 1.0)


def hand_made_record() -> Record:
    """Four episodes of at most three steps: two successes, a collision in environment 2, a time-out in 1."""
    outcome = np.array([[RUNNING, SUCCESS, RUNNING], [RUNNING, RUNNING, SUCCESS], [COLLISION, 0, 0], [0, 0, TIMEOUT]])
    steps = np.array([2, 3, 1, 3])
    played = np.arange(3) < steps[:, None]
    gaps = np.where(played[..., None], np.arange(24.0).reshape(4, 3, 2), np.nan)
    gaps[2, 0] = [-0.1, np.inf]
    hollow = np.where(played, 0.0, np.nan)
    still = np.zeros((4, 3, 2))
    step = Transition(hollow, hollow, still, still, still, hollow, hollow, gaps, outcome)
    scenes = Scenes(
        np.zeros((4, 3, 2)), np.ones((4, 3, 2)), environment=np.array(["1", "2", "2", "1"]), episode=[7, 8, 9, 10]
    )
    nowhere = np.zeros((4, 4, 3, 2))
    return Record(scenes, Simulation(), steps, nowhere, nowhere, step, hollow, np.array([0.5, 0.3, -0.25, 0.0]))


def test_metrics_of_a_record_made_by_hand():
    result = metrics(hand_made_record())
    assert (result["episodes"], result["success"], result["collision"], result["timeout"]) == (4, 0.5, 0.25, 0.25)
    assert result["navigation_time"] == pytest.approx((0.5 + 0.75) / 2)
    assert result["total_reward"] == pytest.approx(0.55 / 4)
    assert result["intervals"]["collision"] == pytest.approx(wilson(1, 4))
    assert result["failures"] == [
        {"episode": 9, "environment": "2", "outcome": "collision", "solvable": True},
        {"episode": 10, "environment": "1", "outcome": "timeout", "solvable": True},
    ]
    second = result["environments"]["2"]
    assert (second["episodes"], second["success"], second["collision"], second["timeout"]) == (2, 0.5, 0.5, 0.0)
    assert second["navigation_time"] == 0.75
    assert json.loads(json.dumps(result)) == result


def test_without_a_success_there_is_no_navigation_time():
    assert metrics(hand_made_record().take(np.array([2, 3])))["navigation_time"] is None


def test_a_record_without_episodes_has_counts_of_0_and_neither_rates_nor_means():
    for empty in (hand_made_record().take([]), play(sample_scenes("1", 0), "linear")):
        result = metrics(empty)
        assert (result["episodes"], result["failures"], episode_rows(empty)) == (0, [], [])
        assert all(result[name] is None for name in (*RATES, "navigation_time", "total_reward"))
        assert result["intervals"]["success"] == [0.0, 1.0]


def test_rows_for_a_csv_file():
    rows = episode_rows(hand_made_record())
    assert [row["episode"] for row in rows] == [7, 8, 9, 10]
    assert rows[0] == {
        "episode": 7,
        "environment": "1",
        "outcome": "success",
        "hit": "",
        "steps": 2,
        "time": 0.5,
        "total_reward": 0.5,
        "smallest_separation": 0.0,
    }
    assert rows[2]["smallest_separation"] == -0.1
    assert [row["hit"] for row in rows] == ["", "", "human", ""]
    header, line = ",".join(rows[0]) + "\n", "7,1,success,,2,0.5,0.5,0.0\n"
    assert (csv_text(rows[:1]), csv_text(rows[:1], header=False)) == (header + line, line)


def test_a_robot_that_is_alone_has_rows_too():
    (row,) = episode_rows(evaluation_record("linear", environment="circle", people=0, episodes=1))
    assert (row["outcome"], row["hit"], row["smallest_separation"]) == ("success", "", np.inf)


@pytest.mark.parametrize("mix", ["table1", "table2"])
def test_the_environments_rows_add_up_to_the_whole(mix):
    record = evaluation_record("orca", environment=mix, episodes=40)
    result = metrics(record)
    parts = result["environments"].values()
    assert sum(part["episodes"] for part in parts) == result["episodes"] == len(record.steps) == 40
    for name in ("success", "collision", "timeout", "total_reward"):
        whole = sum(part[name] * part["episodes"] for part in parts) / 40
        assert result[name] == pytest.approx(whole)
    succeeded = [part for part in parts if part["navigation_time"] is not None]
    seconds = sum(part["navigation_time"] * part["success"] * part["episodes"] for part in succeeded)
    assert result["navigation_time"] == pytest.approx(seconds / (result["success"] * 40))
    assert len(result["failures"]) == round(40 * (1 - result["success"]))


def test_one_environment_has_no_rows_of_its_own():
    result = evaluate("linear", environment="2", episodes=3)
    assert "environments" not in result


def test_the_reward_asked_for_is_the_total_reward_s():
    record = evaluation_record("orca", environment="1", episodes=10)
    sparse = metrics(record)
    again = evaluation_record("orca", environment="1", episodes=10, reward=Reward(reward="sfm"))
    dense = metrics(again)
    np.testing.assert_array_equal(record.steps, again.steps)
    assert dense["total_reward"] != sparse["total_reward"]
    assert evaluate("orca", environment="1", episodes=10, reward="sfm") == dense


def test_the_discount_asked_for_is_the_total_reward_s():
    assert (evaluation_record("linear", environment="circle0", episodes=2).discounted_return > 0).all()
    record = evaluation_record("linear", environment="circle0", episodes=2, discount=0)
    assert (record.discounted_return == 0).all()  # that of the first step alone, which is not the last
    with pytest.raises(ConfigError, match="discount is 2; it must be"):
        evaluation_record("linear", episodes=1, discount=2)


def test_orca_does_as_the_project_s_reading_says():
    """About 0.75 success and 0.05 collisions in environment 1, about 0.32 success in environment 2."""
    first = evaluate("orca", environment="1", episodes=200)
    second = evaluate("orca", environment="2", episodes=200)
    assert binomtest(round(200 * first["success"]), 200, 0.75).pvalue > 1e-3
    assert binomtest(round(200 * first["collision"]), 200, 0.05).pvalue > 1e-3
    assert binomtest(round(200 * second["success"]), 200, 0.32).pvalue > 1e-3


def test_a_trained_policy_is_by_default_tested_where_it_was_trained_to_be():
    chosen = make_config(simulation={"crowd": "sfm"}, reinforcement={"test_environment": "circle2"})
    record = evaluation_record(SarlPolicy(ValueNetwork(value_prior=True), chosen), episodes=2)
    assert record.simulation == chosen.simulation
    assert list(record.scenes.environment) == ["circle2", "circle2"]
    assert evaluation_record("linear", episodes=2).simulation == Simulation()


def test_what_was_hit_is_the_element_of_the_smaller_gap():
    record = hand_made_record()
    record = replace(record, scenes=replace(record.scenes, square=np.tile([False, False, True], (4, 1))))
    cases = {(-0.1, 0.3): "human", (0.3, -0.1): "square", (-0.2, -0.1): "human", (-0.1, -0.2): "square"}
    for gaps, hit in cases.items():
        record.transition.separations[2, 0] = gaps
        assert episode_rows(record)[2]["hit"] == hit


def test_a_rate_is_no_count_and_a_policy_that_played_other_episodes_is_refused():
    for successes, trials in ((0.96, 500), (501, 500), (5, -10), (np.nan, 5), (5, np.inf)):
        with pytest.raises(ValueError, match="wilson takes counts"):
            wilson(successes, trials)
    policy = load_policy("sarl")
    record = evaluation_record(policy, environment="circle0", episodes=2)
    assert metrics(record, policy)["recovered"] == 0
    with pytest.raises(ValueError, match="has just played 2 episodes, the record has 1"):
        metrics(record.take(0), policy)
    with pytest.raises(ValueError, match="has just played 0 episodes, the record has 2"):
        metrics(record, load_policy("sarl"))
