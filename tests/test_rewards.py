"""The paper's rewards by scalar formulas of our own, and a student's own reward from a file or a module."""

import math
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfmrl.cli.session import READS, check_read
from sfmrl.config import ConfigError, Reward
from sfmrl.episodes import play
from sfmrl.rewards import (
    COLLISION,
    REWARDS,
    RUNNING,
    SUCCESS,
    TIMEOUT,
    Transition,
    reward_terms,
    total,
)
from sfmrl.scenes import sample_scenes

NAMES = ("crowd", "sfm", "sfm-discount")


def one_transition(
    outcome: int, gap: float = np.inf, time=5.0, v=(0.5, 0.5), v_pref=(0.0, 1.0), d_g=3.0, dt=0.25
) -> Transition:
    """A batch of one, with two elements of which the second is farther away."""
    gaps = [[gap, gap + 1.0]]
    return Transition(*map(np.array, ([time], [dt], [v], [v], [v_pref], [d_g + 0.1], [d_g], gaps, [outcome])))


def crowd_reward(outcome: int, gap: float) -> float:
    if outcome == TIMEOUT:
        return 0.0
    if outcome == COLLISION:
        return -0.25
    if outcome == SUCCESS:
        return 1.0
    return 0.25 * (-0.1 + gap / 2) if gap < 0.2 else 0.0


def sfm_reward(outcome: int, gap: float, v, v_pref, d_g: float, k: float = 0.001) -> float:
    if outcome in (TIMEOUT, COLLISION, SUCCESS):
        return {TIMEOUT: 0.0, COLLISION: -0.25, SUCCESS: 1.0}[outcome]
    if gap < 0.2:
        return -0.03 * math.exp(-10 * gap)
    return k - math.hypot(k * (v[0] - v_pref[0]), k * (v[1] - v_pref[1])) / 2 - 0.0001 * d_g


def expected_reward(name: str, transition: Transition, settings: Reward) -> list[float]:
    found = []
    for t in range(len(transition.outcome)):
        outcome, gap = int(transition.outcome[t]), float(min(transition.separations[t]))
        if name == "crowd":
            found.append(crowd_reward(outcome, gap))
            continue
        reward = sfm_reward(
            outcome,
            gap,
            transition.velocity[t],
            transition.preferred_velocity[t],
            float(transition.goal_distance[t]),
            settings.k,
        )
        if name == "sfm-discount" and outcome == SUCCESS and transition.time[t] >= 10:
            reward -= 0.02 * (transition.time[t] - 10)
        found.append(reward)
    return found


def random_transitions(seed: int, count: int = 200, elements: int = 4) -> Transition:
    rng = np.random.default_rng(seed)
    outcome = rng.choice([RUNNING, RUNNING, RUNNING, SUCCESS, COLLISION, TIMEOUT], count)
    separations = rng.uniform(0, 0.6, (count, elements))
    separations[rng.random((count, elements)) < 0.3] = np.inf
    separations[outcome == COLLISION, 0] = -rng.uniform(0, 0.6, (outcome == COLLISION).sum())
    return Transition(
        time=0.25 * rng.integers(1, 98, count),
        time_step=np.full(count, 0.25),
        velocity_before=rng.normal(size=(count, 2)),
        velocity=rng.normal(size=(count, 2)),
        preferred_velocity=rng.normal(size=(count, 2)),
        goal_distance_before=rng.uniform(0, 9, count),
        goal_distance=rng.uniform(0, 9, count),
        separations=separations,
        outcome=outcome,
    )


@given(st.integers(0, 10_000), st.sampled_from(NAMES), st.sampled_from([0.001, 0.003]))
def test_rewards_equal_the_paper_s_formulas_one_by_one(seed, name, k):
    transition, settings = random_transitions(seed), Reward(reward=name, k=k)
    found = total(reward_terms(settings)(transition))
    np.testing.assert_allclose(found, expected_reward(name, transition, settings), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    ("gap", "crowd", "sfm"),
    [
        (0.0, -0.025, -0.03),  # touching, but no overlap: no collision
        (0.1, -0.0125, -0.03 * math.exp(-1)),
        (0.2, 0.0, None),  # 0.2 m is far enough
        (np.nextafter(0.2, 0), 0.0, -0.03 * math.exp(-2)),
        (np.inf, 0.0, None),  # nobody there
    ],
)
def test_discomfort_at_its_boundaries(gap, crowd, sfm):
    transition = one_transition(RUNNING, gap, v=(0.0, 1.0), d_g=3.0)
    assert total(reward_terms(Reward())(transition)) == pytest.approx(crowd, abs=1e-15)
    if sfm is None:
        sfm = 0.001 - 0.0001 * 3.0  # at the preferred velocity nothing is taken off k
    assert total(reward_terms(Reward(reward="sfm"))(transition)) == pytest.approx(sfm)


@pytest.mark.parametrize("name", NAMES)
def test_what_is_paid_on_the_way_counts_by_the_time_it_lasts(name):
    """A second at a gap of 0.1 m, or far from everybody, is worth the same in steps of any length."""
    terms = reward_terms(Reward(reward=name))
    for gap in (0.1, 3.0):
        second = [total(terms(one_transition(RUNNING, gap, dt=dt)))[0] / dt for dt in (0.05, 0.25, 0.5)]
        assert second == pytest.approx([second[1]] * 3, rel=1e-12)


@pytest.mark.parametrize("dt", [0.25, 0.1, 0.05])
def test_discomfort_counts_by_the_time_it_lasts(dt):
    """CrowdNav: (gap - 0.2) * 0.5 * time_step; at 0.25 s the formula of the paper, to the bit."""
    found = total(reward_terms(Reward())(one_transition(RUNNING, 0.1, dt=dt)))
    assert found == pytest.approx((0.1 - 0.2) * 0.5 * dt, rel=1e-12)
    assert dt != 0.25 or found == 0.125 * (0.1 - 0.2)


def test_a_discomfort_of_slope_0_is_0_also_where_nobody_is_around():
    with np.errstate(all="raise"):
        record = play(sample_scenes("circle0", 1), "linear", reward=Reward(discomfort_slope=0.0))
    assert record.reward[0].tolist() == [0.0] * (record.steps[0] - 1) + [1.0]


@pytest.mark.parametrize(("time", "cost"), [(9.75, 0.0), (10.0, 0.0), (10.25, 0.005), (20.0, 0.2)])
def test_arriving_late_costs_from_ten_seconds_on(time, cost):
    assert total(reward_terms(Reward(reward="sfm-discount"))(one_transition(SUCCESS, time=time))) == 1.0 - cost
    assert total(reward_terms(Reward(reward="sfm"))(one_transition(SUCCESS, time=time))) == 1.0
    late_hit = one_transition(COLLISION, gap=-0.1, time=time)
    assert total(reward_terms(Reward(reward="sfm-discount"))(late_hit)) == -0.25


@pytest.mark.parametrize("name", NAMES)
def test_a_timeout_is_worth_nothing_even_in_contact(name):
    assert total(reward_terms(Reward(reward=name))(one_transition(TIMEOUT, gap=-0.1))) == 0.0


def test_terms_by_name_and_only_those_that_apply():
    near = reward_terms(Reward(reward="sfm"))(one_transition(RUNNING, 0.1))
    assert set(near) == {"collision", "goal", "discomfort", "velocity", "distance"}
    assert {name for name, value in near.items() if value != 0} == {"discomfort"}
    free = reward_terms(Reward(reward="sfm"))(one_transition(RUNNING))
    assert {name for name, value in free.items() if value != 0} == {"velocity", "distance"}
    assert set(reward_terms(Reward())(one_transition(RUNNING))) == {"collision", "goal", "discomfort"}


@pytest.mark.parametrize("name", NAMES)
def test_any_leading_axes_and_the_caller_s_numbers(name):
    transition = random_transitions(1, count=24)
    settings = Reward(reward=name, success=5.0, collision=-2.0)
    flat = total(reward_terms(settings)(transition))
    assert (flat[transition.outcome == COLLISION] == -2.0).all()
    shaped = Transition(
        *(value.reshape(2, 3, 4, *value.shape[1:]) for value in (getattr(transition, n) for n in vars(transition)))
    )
    np.testing.assert_array_equal(total(reward_terms(settings)(shaped)), flat.reshape(2, 3, 4))


def test_separation_is_the_smallest_gap_and_infinite_without_elements():
    transition = random_transitions(2, elements=3)
    np.testing.assert_array_equal(transition.separation, transition.separations.min(1))
    alone = Transition(*(getattr(transition, n)[:5] for n in vars(transition)))
    alone = Transition(**{**vars(alone), "separations": np.empty((5, 0))})
    assert (alone.separation == np.inf).all()
    assert np.isfinite(total(REWARDS["sfm"](alone, Reward()))).all()


OWN = """
import numpy as np

def good(transition, settings):
    return np.where(transition.outcome == 1, settings.success, -transition.goal_distance)

not_a_function = 3
"""


@pytest.fixture
def own_file(tmp_path: Path) -> Path:
    path = tmp_path / "my_reward.py"
    path.write_text(OWN)
    return path


def test_an_own_reward_from_a_file_and_from_a_module(own_file, monkeypatch):
    transition = random_transitions(4)
    expected = np.where(transition.outcome == SUCCESS, 3.0, -transition.goal_distance)
    terms = reward_terms(Reward(reward=f"{own_file}:good", success=3.0))(transition)
    assert list(terms) == ["reward"]
    np.testing.assert_array_equal(total(terms), expected)
    monkeypatch.syspath_prepend(own_file.parent)
    np.testing.assert_array_equal(
        total(reward_terms(Reward(reward="my_reward:good", success=3.0))(transition)), expected
    )


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("smf", "choose crowd, sfm, sfm-discount, or your own as file.py:function; did you mean sfm?"),
        ("nowhere.py:good", "there is no file nowhere.py"),
        ("no_such_module:good", "cannot be imported: ModuleNotFoundError"),
        ("{file}:godo", "has no function 'godo'; did you mean good?"),
        ("{file}:not_a_function", "has no function 'not_a_function'"),
        ("{broken}:good", "broken.py:good (line 1) cannot be imported: SyntaxError"),
        ("{stopping}:good", "(line 3) cannot be imported: SystemExit: 3"),
    ],
)
def test_an_own_reward_that_is_not_there_is_an_error_with_the_way_out(own_file, name, message):
    broken, stopping = own_file.with_name("broken.py"), own_file.with_name("stopping.py")
    broken.write_text("def good(:\n")
    stopping.write_text("import sys\n\nsys.exit(3)\n")
    with pytest.raises(ConfigError, match=re.escape(message)):
        reward_terms(Reward(reward=name.format(file=own_file, broken=broken, stopping=stopping)))


@pytest.mark.parametrize("name", NAMES)
def test_a_record_s_rewards_are_those_of_its_transitions(name):
    record = play(sample_scenes("table1", 12, seed=4), "orca", reward=name)
    assert set(record.outcome) >= {"success", "timeout"}
    for e, steps in enumerate(record.steps):
        transition = record.transition[e, :steps]
        expected = expected_reward(name, transition, Reward(reward=name))
        np.testing.assert_allclose(record.reward[e, :steps], expected, rtol=1e-12, atol=1e-15)
        assert np.isnan(record.reward[e, steps:]).all()


def test_a_record_s_transitions_follow_from_its_trajectories():
    """Velocity, goal distance and gaps of each step from the positions alone, by dense sampling of the step."""
    record = play(sample_scenes("1", 6, seed=4), "orca")
    half = np.where(record.scenes.square, record.scenes.radius, 0.0)[:, 1:, None]  # of a square's side, 0 for people
    radii = np.where(record.scenes.square, 0.0, record.scenes.radius)[:, 1:] + record.scenes.radius[:, :1]
    share = np.linspace(0, 1, 101)[:, None, None]
    for e, steps in enumerate(record.steps):
        for t in range(steps):
            here, there = record.position[e, t], record.position[e, t + 1]
            step, goal = record.transition[e, t], record.scenes.goal[e, 0]
            np.testing.assert_allclose(step.velocity, (there[0] - here[0]) / 0.25, atol=1e-12)
            np.testing.assert_array_equal(step.velocity_before, record.transition[e, t - 1].velocity if t else 0.0)
            assert step.goal_distance == pytest.approx(np.hypot(*(there[0] - goal)))
            way = goal - here[0]
            np.testing.assert_allclose(step.preferred_velocity, way / np.hypot(*way), atol=1e-12)
            assert step.goal_distance_before == pytest.approx(np.hypot(*way))
            assert (step.time, step.time_step) == (0.25 * (t + 1), 0.25)
            robot = here[0] + share * 0.25 * step.velocity
            others = here[1:] + share * 0.25 * record.velocity[e, t, 1:]  # as people moved before the step
            outside = np.maximum(np.abs(others - robot) - half[e], 0.0)
            gaps = np.hypot(*np.moveaxis(outside, -1, 0)).min(0) - radii[e]
            np.testing.assert_allclose(step.separations, gaps, atol=2e-3)


def test_a_reward_for_progress_adds_up_to_the_way_that_was_made():
    def progress(transition, settings):
        return transition.goal_distance_before - transition.goal_distance

    record = play(sample_scenes("1", 6, seed=4), "orca", reward=progress)
    end = record.position[np.arange(6), record.steps, 0] - record.scenes.goal[:, 0]
    start = record.scenes.start[:, 0] - record.scenes.goal[:, 0]
    np.testing.assert_allclose(np.nansum(record.reward, 1), np.hypot(*start.T) - np.hypot(*end.T))


def test_a_setting_that_the_reward_does_not_read_is_refused():
    """What a reward reads is found out by changing each setting; all outcomes, near and far, early and late."""
    rng = np.random.default_rng(0)
    many = rng.integers(0, 4, size=400)
    step = Transition(
        time=rng.uniform(1, 24, 400),
        time_step=np.full(400, 0.25),
        velocity_before=rng.normal(size=(400, 2)),
        velocity=rng.normal(size=(400, 2)),
        preferred_velocity=rng.normal(size=(400, 2)),
        goal_distance_before=rng.uniform(0, 9, 400),
        goal_distance=rng.uniform(0, 9, 400),
        separations=rng.uniform(0, 0.6, (400, 3)),
        outcome=many,
    )
    for name in REWARDS:
        plain = Reward(reward=name)
        for item in fields(Reward):
            if item.name == "reward":
                continue
            changed = replace(plain, **{item.name: getattr(plain, item.name) * 1.5})
            differs = not np.array_equal(total(reward_terms(plain)(step)), total(reward_terms(changed)(step)))
            assert differs == (item.name in READS[name]), (name, item.name)
            if differs:
                check_read(plain, [item.name])
            else:
                with pytest.raises(ConfigError, match=f"--{item.name.replace('_', '-')} changes nothing with"):
                    check_read(plain, [item.name])


def test_gaps_without_an_axis_of_elements_are_refused():
    transition = random_transitions(5, elements=1)
    flat = replace(transition, separations=transition.separations[:, 0])
    for terms in (REWARDS["crowd"], REWARDS["sfm"]):
        with pytest.raises(ValueError, match="and one more axis"):
            terms(flat, Reward())
