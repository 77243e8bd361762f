"""Playing: an episode has the same bits whatever shares its batch, and its returns are the sums that they claim."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfmrl.actions import ACTIONS
from sfmrl.config import Config, ConfigError, Reward, Simulation
from sfmrl.episodes import Record, play, play_episodes, returns_of
from sfmrl.lookahead import SarlPolicy
from sfmrl.network import ValueNetwork
from sfmrl.policies import load_policy
from sfmrl.scenes import Scenes, sample_scenes
from sfmrl.states import robot_states
from sfmrl.world import reset


def still(world, crowd_velocity):
    return np.zeros((len(world), 2))


def assert_same_episode(whole: Record, e: int, alone: Record) -> None:
    """One episode of a record has the bits that it has alone."""
    steps = alone.steps[0]
    assert whole.steps[e] == steps
    np.testing.assert_array_equal(whole.position[e, : steps + 1], alone.position[0])
    np.testing.assert_array_equal(whole.velocity[e, : steps + 1], alone.velocity[0])
    for name, value in vars(alone.transition).items():
        np.testing.assert_array_equal(getattr(whole.transition, name)[e, :steps], value[0], err_msg=name)
    np.testing.assert_array_equal(whole.reward[e, :steps], alone.reward[0])
    assert whole.discounted_return[e] == alone.discounted_return[0]
    assert np.isnan(whole.position[e, steps + 1 :]).all()
    assert np.isnan(whole.reward[e, steps:]).all()


@pytest.mark.parametrize("crowd", ["orca", "sfm"])
@pytest.mark.parametrize("policy", ["orca", "sfm", "linear"])
def test_an_episode_alone_and_among_300_with_refilling(policy, crowd):
    scenes = sample_scenes("1:0.5,2:0.2,4:0.2,5:0.1", 300, seed=1)
    simulation, reward = Simulation(crowd=crowd), Reward(reward="sfm")
    whole = play_episodes(scenes, load_policy(policy), reward, simulation, batch=64)
    for e in (0, 17, 63, 64, 65, 100, 150, 151, 200, 299):
        assert_same_episode(whole, e, play_episodes(scenes.take([e]), load_policy(policy), reward, simulation))


@pytest.mark.parametrize(("value_prior", "threads"), [(False, 1), (False, 2), (True, 2)])
def test_an_episode_alone_and_in_a_batch_with_a_network(value_prior, threads):
    scenes = sample_scenes("table1", 30, seed=1)
    simulation, reward = Simulation(time_limit=2.0), Reward()
    policy = SarlPolicy(ValueNetwork(value_prior=value_prior), Config(value_prior=value_prior), threads)
    whole = play_episodes(scenes, policy, reward, simulation, batch=13)
    for e in range(0, 30, 6):
        assert_same_episode(whole, e, play_episodes(scenes.take([e]), policy, reward, simulation))


@pytest.mark.parametrize("threads", [1, 2])
def test_a_network_s_values_have_the_same_bits_whatever_shares_the_batch(threads):
    """Values, not only the actions taken: also of scenes with absent rows, whose batch has some without."""
    scenes = sample_scenes("circle4:0.5,1:0.5", 30)
    policy = SarlPolicy(ValueNetwork(value_prior=True), Config(value_prior=True), threads)
    worlds = play(scenes, "linear").worlds().take(np.arange(0, 600, 15))
    moves = worlds.velocity
    whole = policy.lookahead(worlds, moves).values
    for size in (1, 3, 4, 5):
        rows = [np.arange(first, min(first + size, 40)) for first in range(0, 40, size)]
        parts = np.concatenate([policy.lookahead(worlds.take(r), moves[r]).values for r in rows])
        np.testing.assert_array_equal(parts, whole)


def test_a_network_takes_the_action_of_highest_reward_plus_discounted_value_of_what_follows():
    """One decision from the definition: each action's next state from the people's next places, valued on its own."""
    scenes = sample_scenes("1", 1, seed=2)
    config = Config(forces=True, reward=Reward(reward="sfm"), discount=0.8)
    policy = SarlPolicy(ValueNetwork(forces=True, seed=3), config)
    record = play(scenes, policy, reward="sfm", discount=0.8)
    world = record.worlds().take(np.array([4]))
    moves = record.velocity[:, 5].copy()  # what everybody did next
    look = policy.lookahead(world, moves)
    taken = record.transition.velocity[0, 4]
    np.testing.assert_array_equal(look.actions[0, look.best[0]], taken)
    for a in (0, 7, 40, 80):
        action = ACTIONS[a]
        state = robot_states(
            world.position[:, 0] + 0.25 * action,
            action[None],
            world.goal[:, 0],
            world.radius[:, 0],
            world.v_pref[:, 0],
            world.position[:, 1:] + 0.25 * moves[:, 1:],
            moves[:, 1:],
            world.radius[:, 1:],
            forces=True,
        )
        value = float(policy.network.evaluate(state)[0][0])
        gap = math.inf
        for share in np.linspace(0, 0.25, 201):
            robot = world.position[0, 0] + share * action
            others = world.position[0, 1:] + share * world.velocity[0, 1:]
            gap = min(gap, np.hypot(*(others - robot).T).min() - 0.6)
        assert gap > 0.21  # nobody near in this scene, so the reward is the dense one
        way = world.goal[0, 0] - world.position[0, 0]
        off = action - way / np.hypot(*way)
        reward = 0.001 - 0.001 * np.hypot(*off) / 2 - 0.0001 * np.hypot(*(way - 0.25 * action))
        assert look.values[0, a] == pytest.approx(reward + 0.8**0.25 * value, abs=1e-6)


def test_a_network_finds_its_way_alone_as_among_absent_people():
    config = Config(value_prior=True)
    policy = SarlPolicy(ValueNetwork(value_prior=True), config)
    empty = Scenes([[[0, -2]]], [[[0, 2]]])
    hole = Scenes([[[0, -2], [np.nan, np.nan]]], [[[0, 2], [0, 0]]])
    alone, absent = (play(scenes, policy, reward="sfm") for scenes in (empty, hole))
    np.testing.assert_array_equal(alone.position[:, :, 0], absent.position[:, :, 0])
    np.testing.assert_array_equal(alone.reward, absent.reward)
    assert np.ptp(policy.lookahead(reset(empty), np.zeros((1, 1, 2))).values) > 1e-3


@given(st.integers(0, 1000), st.floats(0, 1), st.sampled_from([0.0, 0.4]))
def test_returns_are_discounted_sums_up_to_the_end_or_to_a_guess_that_stands_for_the_rest(seed, discount, guesses):
    rng = np.random.default_rng(seed)
    rewards, steps = rng.normal(size=(3, 6)), rng.integers(1, 7, 3)
    rewards[np.arange(6) >= steps[:, None]] = np.nan
    guess = np.where(rng.random((3, 6)) < guesses, rng.normal(size=(3, 6)), np.nan)
    guess[np.arange(6) >= steps[:, None]] = np.nan
    found = returns_of(rewards, np.full(3, discount), guess if guesses else None)
    for e in range(3):
        assert np.isnan(found[e, steps[e] :]).all()
        for t in range(steps[e]):
            total, factor = 0.0, 1.0
            for u in range(t, steps[e]):
                if u > t and not np.isnan(guess[e, u]):
                    total += factor * guess[e, u]
                    break
                total += factor * rewards[e, u]
                factor *= discount
            assert found[e, t] == pytest.approx(total)


def test_the_discount_is_per_second_at_1_m_s():
    scenes = Scenes([[[0, -2.0]]] * 2, [[[0, 2.0]]] * 2, v_pref=[[1.0], [0.5]])
    record = play(scenes, "linear", discount=0.8)
    for e, v_pref in enumerate((1.0, 0.5)):
        assert record.outcome[e] == "success"
        last = record.steps[e] - 1
        assert record.discounted_return[e] == pytest.approx(0.8 ** (0.25 * v_pref * last))


def test_a_robot_that_stands_still_is_timed_out_after_24_seconds():
    record = play(Scenes([[[0, -4], [3, 3]]], [[[0, 4], [3, 3]]]), still)
    assert list(record.outcome) == ["timeout"]
    assert record.steps[0] == 97  # the step that starts at 24 s is judged, and is the last
    assert record.discounted_return[0] == 0.0


@pytest.mark.parametrize(
    ("time_limit", "time_step"), [(25.0, 0.25), (8.8, 0.15), (1.1, 0.1), (1.0, 0.25), (9.3, 0.1), (1.5, 1.0)]
)
def test_any_time_step_and_limit_end_in_a_timeout(time_limit, time_step):
    simulation = Simulation(time_limit=time_limit, time_step=time_step)
    record = play_episodes(sample_scenes("5", 2), still, Reward(), simulation)
    assert (record.outcome == "timeout").all()
    assert (record.steps <= simulation.longest).all()
    assert (record.time - time_step >= time_limit - 1 - 1e-9).all()


def test_a_record_s_worlds_and_states_are_those_before_each_step():
    record = play(sample_scenes("table1", 5, seed=3), "orca")
    worlds, states = record.worlds(), record.states(Config(forces=True))
    assert len(worlds) == len(states) == record.steps.sum() == record.played.sum()
    episode, step = np.nonzero(record.played)
    s = int(np.flatnonzero((episode == 2) & (step == 9))[0])
    np.testing.assert_array_equal(worlds.position[s], record.position[2, 9])
    assert worlds.time[s] == 9 * 0.25
    to_goal = record.scenes.goal[2, 0] - record.position[2, 9, 0]
    assert states[s, 0, 0] == pytest.approx(np.hypot(*to_goal))
    part = record.take(np.array([2]))
    np.testing.assert_array_equal(part.states(Config(forces=True)), states[episode == 2])


def test_progress_hears_of_every_episode():
    heard = []
    play_episodes(sample_scenes("1", 30), load_policy("linear"), Reward(), Simulation(), batch=7, progress=heard.append)
    assert sum(heard) == 30
    assert len(heard) > 1


@pytest.mark.parametrize("policy", ["linear", "orca", "sfm"])
def test_no_episodes_at_all_make_an_empty_record(policy):
    record = play(sample_scenes("1", 0), policy)
    assert record.outcome.shape == record.steps.shape == record.discounted_return.shape == (0,)


def test_a_trained_policy_plays_in_the_simulation_of_its_training_but_for_what_is_named():
    trained = Simulation(squares="disc", time_step=0.5, time_limit=3.0, crowd="sfm", robot_visible=False)
    policy, scenes = SarlPolicy(ValueNetwork(), Config(simulation=trained)), sample_scenes("2", 2)
    assert play(scenes, policy).simulation == trained
    named = play(scenes, policy, robot_visible=True, safety_space=0.1, crowd="orca", kinematics="unicycle").simulation
    others = {"robot_visible": True, "safety_space": 0.1, "crowd": "orca", "kinematics": "unicycle"}
    assert named == replace(trained, **others)
    assert play(scenes, "linear").simulation == Simulation()


@pytest.mark.parametrize(
    ("call", "remedy"),
    [
        (lambda scenes: play(scenes, "orac"), "did you mean orca"),
        (lambda scenes: play(scenes, "linear", crowd="sfn"), "did you mean sfm"),
        (lambda scenes: play(scenes, "linear", reward="sfn"), "did you mean sfm"),
        (lambda scenes: play(scenes, "linear", safety_space=-1.0), "safety-space is -1.0; it must be at least 0"),
    ],
)
def test_wrong_names_and_numbers_are_found_before_anything_is_played(call: Callable, remedy):
    with pytest.raises(ConfigError, match=remedy):
        call(sample_scenes("1", 1))
