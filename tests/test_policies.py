"""The 81 actions, SARL's care (collisions, traps, nothing within reach), and the policy that goes straight."""

import multiprocessing
import os
import pickle

import numpy as np
import pytest
from conftest import DATA

from sfmrl.actions import ACTIONS
from sfmrl.config import Config, ConfigError
from sfmrl.episodes import play, play_episodes
from sfmrl.fast import new_network
from sfmrl.geometry import length
from sfmrl.lookahead import SarlPolicy, world_states
from sfmrl.network import ValueNetwork
from sfmrl.policies import load_policy
from sfmrl.recovery import with_recovery
from sfmrl.rewards import COLLISION, reward_terms, total
from sfmrl.scenes import Scenes, sample_scenes
from sfmrl.states import robot_states
from sfmrl.variants import make_config
from sfmrl.world import World, crowd_velocities, reset, transition


def crowded(episodes: int, seed: int) -> World:
    """The robot among six people close by, who walk in all directions."""
    rng = np.random.default_rng(seed)
    angle, reach = rng.uniform(0, 2 * np.pi, (episodes, 6)), rng.uniform(0.62, 0.9, (episodes, 6))
    around = reach[..., None] * np.stack((np.cos(angle), np.sin(angle)), -1)
    start = np.concatenate((np.zeros((episodes, 1, 2)), around), axis=1)
    world = reset(Scenes(start, start + 3))
    velocity = rng.uniform(-1, 1, world.velocity.shape)
    return World(**{**vars(world), "velocity": velocity})


def test_nothing_follows_a_collision_and_traps_are_avoided_only_when_the_config_says_so():
    world, network = crowded(40, seed=3), ValueNetwork()
    moves = crowd_velocities(world)
    bold = SarlPolicy(network, Config()).lookahead(world, moves)
    careful = SarlPolicy(network, Config(careful=True)).lookahead(world, moves)
    hit = transition(world, bold.actions).outcome == COLLISION
    assert hit.any()
    np.testing.assert_array_equal(bold.values[~hit], careful.values[~hit])
    np.testing.assert_array_equal(careful.values[hit], -0.25)
    np.testing.assert_array_equal(bold.best, bold.values.argmax(1))
    assert (careful.best != careful.values.argmax(1)).any()


@pytest.mark.parametrize("far", [np.zeros((0, 2)), np.array([[30.0, 0.0], [0.0, -25.0]])])
@pytest.mark.parametrize("forces", [False, True])
def test_a_robot_with_nothing_within_reach_goes_straight_whatever_its_network(far, forces):
    """Eight headings, three distances; an untrained network, which would wander."""
    angle, distance = np.meshgrid(np.arange(8) * np.pi / 4, [4.0, 8.0, 12.0])
    goal = (distance * np.stack((np.cos(angle), np.sin(angle)))).reshape(2, 24, 1).transpose(1, 2, 0)
    start = np.concatenate((np.zeros((24, 1, 2)), np.tile(far, (24, 1, 1))), axis=1)
    goal = np.concatenate((goal, start[:, 1:]), axis=1)
    scenes = Scenes(start, goal, v_pref=np.r_[1.0, np.zeros(len(far))])
    policy = SarlPolicy(ValueNetwork(forces=forces), Config(careful=True, forces=forces))
    record = play(scenes, policy)
    assert (record.outcome == "success").all()
    straight = np.ceil((distance.ravel() - 0.3) / 0.25) * 0.25  # s at 1 m/s
    assert (record.time <= 1.15 * straight).all()


def test_linear_walks_at_v_pref_up_to_its_goal_as_crowdnav_s_does():
    record = play(Scenes([[[0, -4], [9, 9]]], [[[0, 4], [9, 9]]]), "linear")
    np.testing.assert_allclose(record.transition.velocity[0], np.tile([0.0, 1.0], (31, 1)))
    assert record.time[0] == 7.75


def test_the_81_actions_are_stop_and_five_speeds_in_sixteen_headings():
    with np.load(DATA / "crowdnav_sarl.npz") as reference:
        np.testing.assert_allclose(ACTIONS, reference["actions"], atol=1e-12)


@pytest.mark.parametrize("dt", [0.25, 0.4])
def test_a_choice_and_what_is_learnt_from_it_by_definition_with_other_sizes_speeds_and_time_steps(dt):
    start = np.array([[[0.0, -4.0], [2.0, 0.0], [-1.5, 1.0], [30.0, 0.0]]])
    scenes = Scenes(start, -start, radius=[0.4, 0.35, 0.5, 0.3], v_pref=[0.8, 0.6, 1.2, 0.5])
    config = make_config("quick", "sarl-sfm6", discount=0.8, simulation={"time_step": dt})
    policy = SarlPolicy(new_network(config, seed=3), config)
    record = play_episodes(scenes, policy, config.reward, config.simulation, discount=0.8)
    world, moves, actions = record.worlds().take([6]), record.velocity[:, 7], 0.8 * ACTIONS[None]
    look, step = policy.lookahead(world, moves), transition(world, actions)
    seen = np.array([True, True, False])[:, None]  # the last is more than 10 m away
    places = np.where(seen, world.position[:, 1:] + dt * moves[:, 1:], np.nan)[:, None]
    robot = world.position[:, :1] + dt * actions, actions, world.goal[:, :1], [[0.4]], [[0.8]]
    states = robot_states(*robot, places, moves[:, None, 1:], np.array([[[0.35, 0.5, 0.3]]]), forces=True)
    later = np.where(step.outcome == COLLISION, 0, policy.network.evaluate(states)[0])
    expected = total(reward_terms(config.reward)(step)) + 0.8 ** (dt * 0.8) * later
    np.testing.assert_allclose(look.values, expected, atol=1e-6)
    steps, stored = record.steps[0], record.states(config)
    np.testing.assert_array_equal(stored, world_states(record.worlds(), config))
    assert np.isnan(stored[:, 2, 8]).all()
    np.testing.assert_allclose(record.transition.time[0, :steps], dt * np.arange(1, steps + 1))
    np.testing.assert_allclose(length(record.transition.preferred_velocity[0, :steps]), 0.8)
    factors = 0.8 ** (dt * 0.8 * np.arange(steps))
    assert record.discounted_return[0] == pytest.approx(factors @ record.reward[0, :steps])


@pytest.mark.parametrize("visible", [True, False])
def test_a_safety_space_keeps_the_robot_farther_from_people(visible):
    def mean_gap(space: float) -> float:
        record = play(sample_scenes("circle5", 20), "orca", robot_visible=visible, safety_space=space)
        return np.nanmin(record.transition.separation, axis=1).mean()

    assert mean_gap(0.2) > mean_gap(0.0) + 0.05


def test_in_a_crowd_of_the_social_force_model_orca_is_another_policy():
    orca, sfm = (play(sample_scenes("circle5", 2), policy, crowd="sfm").position[:, :9] for policy in ("orca", "sfm"))
    assert not np.array_equal(orca, sfm)


def test_a_network_and_a_config_of_different_columns_are_refused():
    for forces in (False, True):
        with pytest.raises(ConfigError, match=rf"the config has forces {forces}, the network {not forces}"):
            SarlPolicy(new_network(Config(forces=not forces)), Config(forces=forces))


@pytest.mark.parametrize("reward", ["crowd", "sfm"])
@pytest.mark.parametrize("recover", [False, True])
def test_a_policy_with_a_reward_of_the_paper_can_be_pickled(reward, recover):
    config = make_config(reward={"reward": reward}, planner={"recover": recover})
    policy = with_recovery(SarlPolicy(new_network(config), config), config.planner)
    scenes = sample_scenes("table1", 3)
    there = play(scenes, pickle.loads(pickle.dumps(policy)), reward=reward)
    np.testing.assert_array_equal(there.position, play(scenes, policy, reward=reward).position)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs os.fork")
def test_a_forked_process_has_threads_of_its_own():
    scenes, policy = sample_scenes("circle5", 2), load_policy("sarl", threads=2)
    before = play(scenes, policy)  # starts the threads, which a fork does not copy
    here, there = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(
        target=lambda: there.send(play(scenes, policy).position), daemon=True
    )
    child.start()
    assert here.poll(60)
    np.testing.assert_array_equal(here.recv(), before.position)
    child.join()
