"""An episode taken apart: its terms are the reward's own, they add up to the return, and the table fits."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from sfmrl.config import Config, ConfigError, Reward
from sfmrl.episodes import play_episodes
from sfmrl.lessons.explain import PAPER_REWARDS, chosen_steps, explain_episode, mark
from sfmrl.lookahead import SarlPolicy
from sfmrl.network import ValueNetwork
from sfmrl.policies import orca_policy
from sfmrl.recovery import with_recovery
from sfmrl.scenes import sample_scenes
from sfmrl.variants import make_config

OWN = replace(PAPER_REWARDS["sfm-discount"], k=0.002, discount_start=5.0)


@pytest.mark.parametrize("reward", [*PAPER_REWARDS.values(), OWN], ids=[*PAPER_REWARDS, "own"])
@pytest.mark.parametrize("environment", ["1", "2", "circle0"])
def test_the_terms_add_up_to_the_record_s_return_whatever_the_reward(reward, environment):
    for discount in (0.9, 0.97):
        record = play_episodes(
            sample_scenes(environment, 4), orca_policy, reward, Config().simulation, discount=discount
        )
        for row in range(4):
            explained = explain_episode(record, row, orca_policy, reward, discount)
            steps, returned = explained.steps, pytest.approx(record.discounted_return[row], abs=1e-12)
            assert explained.sums()["return"] == returned
            assert sum(step["discounted_reward"] for step in steps) == returned
            assert steps[-1]["return_so_far"] == returned
            for step, paid in zip(steps, record.reward[row], strict=False):
                assert sum(step[term] for term in explained.plain) == pytest.approx(paid, abs=1e-15)
            for term, paid in explained.plain.items():
                assert sum(step[term] for step in steps) == pytest.approx(paid, abs=1e-12)
            factors = discount ** (0.25 * np.arange(len(steps)))  # at 1 m/s
            for name, terms in explained.discounted.items():
                by_step = {term: [step[f"{name}: {term}"] for step in steps] for term in terms}
                assert {term: factors @ paid for term, paid in by_step.items()} == pytest.approx(terms, abs=1e-12)
            names = (["own sfm-discount"] if reward is OWN else []) + list(PAPER_REWARDS)
            assert list(explained.discounted) == names


def test_the_other_rewards_pay_what_the_same_episode_played_under_them_does():
    scenes = sample_scenes("1", 3)
    records = {
        name: play_episodes(scenes, orca_policy, reward, Config().simulation) for name, reward in PAPER_REWARDS.items()
    }
    for row in range(3):
        explained = explain_episode(records["crowd"], row, orca_policy, Reward(), 0.9)
        for name, paid in explained.discounted.items():
            assert sum(paid.values()) == pytest.approx(records[name].discounted_return[row], abs=1e-12)


def test_a_step_s_numbers_are_those_of_the_record_and_of_the_network():
    config = make_config("quick", "sarl-sfm2")
    policy = SarlPolicy(ValueNetwork(value_prior=True, seed=3), config)
    record = play_episodes(sample_scenes("2", 2), policy, config.reward, config.simulation, keep=True)
    explained = explain_episode(record, 1, policy, config.reward, config.discount)
    assert len(explained.steps) == record.steps[1]
    worlds = record.take(np.array([1])).worlds()
    look = policy.lookahead(worlds, record.velocity[1, 1 : record.steps[1] + 1])
    for t, step in enumerate(explained.steps):
        ordered = np.sort(look.values[t])
        if "passed over" in step["event"]:
            assert step["value"] < ordered[-1] == pytest.approx(step["runner_up"])
        else:
            assert (step["value"], step["runner_up"]) == pytest.approx((ordered[-1], ordered[-2]))
        position, others = record.position[1, t, 0], record.position[1, t, 1:]
        away = position - others[np.isfinite(others).all(1)]
        far = np.hypot(*away.T)[:, None]
        push = (np.exp(-far) * away / far).sum(0)  # equation 2 with the paper's numbers
        assert (step["repulsion_x"], step["repulsion_y"]) == pytest.approx(tuple(push))
        assert step["gap"] == pytest.approx(record.transition.separation[1, t])
        assert step["time"] == pytest.approx(0.25 * step["step"])


def test_what_happened_is_told_step_by_step():
    recovering = with_recovery(orca_policy, make_config("quick").planner)
    record = play_episodes(sample_scenes("2", 12), recovering, Reward(), Config().simulation, keep=True)
    stuck = int(np.flatnonzero(recovering.helped)[0])
    events = [row["event"] for row in explain_episode(record, stuck, recovering, Reward(), 0.9).steps]
    assert sum("stuck" in event for event in events) >= 1
    for row in range(12):
        steps = explain_episode(record, row, orca_policy, Reward(), 0.9).steps
        ends = {"success": "*", "collision": "X", "timeout": "T"}
        assert mark(steps[-1]["event"]) == ends[record.outcome[row]]
        assert all(step["discomfort"] < 0 for step in steps if "too close" in step["event"])
        assert all("too close" in step["event"] for step in steps if step["discomfort"] < 0)


def rows(*events: str) -> list[dict]:
    return [{"step": k, "event": event} for k, event in enumerate(events, 1)]


def test_every_nth_step_and_the_events_are_shown():
    quiet = rows(*[""] * 29, "goal reached")
    assert [row["step"] for row in chosen_steps(quiet)] == [*range(1, 31, 3), 30]
    assert [row["step"] for row in chosen_steps(quiet, every=10)] == [1, 11, 21, 30]
    assert [row["step"] for row in chosen_steps(quiet, steps="10:13")] == [10, 11, 12, 13]
    assert [row["step"] for row in chosen_steps(quiet, every=2, steps="10:13")] == [10, 12]
    assert [row["step"] for row in chosen_steps(quiet, steps="28:99")] == [28, 29, 30]
    assert [row["step"] for row in chosen_steps(quiet, steps="7")] == [7]
    few, many = ["", *["too close to person 1"] * 6, ""], ["", *["too close to person 1"] * 20, ""]
    assert [row["step"] for row in chosen_steps(rows(*few), every=50)] == [1, *range(2, 8)]
    assert [row["step"] for row in chosen_steps(rows(*many), every=50)] == [1, 2, 21]


@pytest.mark.parametrize("steps", ["20:10", "31", "0:5", "a:b", "1:2:3", "-3"])
def test_steps_that_the_episode_does_not_have_are_an_error(steps):
    with pytest.raises(ConfigError, match="--steps is"):
        chosen_steps(rows(*[""] * 30), steps=steps)


def test_the_command_prints_json_csv_and_a_table_of_eighty_columns(sfmrl, tmp_path):
    words = ("explain", "orca", "--environment", "1", "--episode", "4", "--reward", "sfm-discount")
    done = sfmrl(*words, "--csv", "steps.csv", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    with open(tmp_path / "steps.csv", newline="") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(told["steps"]) == round(told["time"] / 0.25)
    for line, step in zip(lines, told["steps"], strict=True):
        assert all(line[name] == ("" if value is None else str(value)) for name, value in step.items())
    assert told["return"] == pytest.approx(math.fsum(told["totals"]["discounted"].values()))
    evaluated = sfmrl("eval", "orca", "--environment", "1", "--episodes", "5", "--reward", "sfm-discount", "--csv", "e")
    assert evaluated.returncode == 0
    with open(tmp_path / "e", newline="") as file:
        assert told["return"] == pytest.approx(float(list(csv.DictReader(file))[4]["total_reward"]), abs=1e-12)

    refused = sfmrl(*words, "--csv", "steps.csv")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "--overwrite" in refused.stderr
    table = sfmrl(*words, "--csv", "steps.csv", "--overwrite")
    assert table.returncode == 0, table.stderr
    assert max(map(len, table.stdout.splitlines())) <= 80
    assert "…" not in table.stdout
    assert f"{told['return']:+.5f}" in table.stdout
