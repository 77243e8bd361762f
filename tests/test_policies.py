"""The 81 actions, SARL's care (collisions, traps, nothing within reach), and the policy that goes straight."""

import numpy as np
import pytest
from conftest import DATA

from sfmrl.actions import ACTIONS
from sfmrl.config import Config
from sfmrl.episodes import play
from sfmrl.lookahead import SarlPolicy
from sfmrl.network import ValueNetwork
from sfmrl.rewards import COLLISION
from sfmrl.scenes import Scenes
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
