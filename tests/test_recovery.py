"""Recovery: it leads out of dead ends, and leaves a robot that makes progress to its policy."""

import copy
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from sfmrl.config import Config, ConfigError, Planner, Reward, Simulation
from sfmrl.episodes import Record, play_episodes
from sfmrl.geometry import limit
from sfmrl.lookahead import SarlPolicy
from sfmrl.network import ValueNetwork
from sfmrl.policies import find_policy, linear_policy, orca_policy
from sfmrl.recovery import RecoveringPolicy, with_recovery
from sfmrl.recovery.policy import straight_way_is_free
from sfmrl.recovery.remembering import RememberingPolicy
from sfmrl.scenes import Scenes, sample_scenes
from sfmrl.world import reset

ON = Planner(recover=True)


def test_orca_leaves_every_dead_end_with_recovery_and_stays_in_them_without():
    scenes = sample_scenes("maps", 20)
    alone = play_episodes(scenes, orca_policy, Reward(), Simulation())
    helped = play_episodes(scenes, RecoveringPolicy(orca_policy, ON), Reward(), Simulation())
    assert (alone.outcome == "timeout").sum() >= 10
    assert (helped.outcome != "timeout").all()
    assert (helped.outcome == "success").sum() >= 19


def test_a_robot_that_makes_progress_is_left_to_its_policy():
    scenes = Scenes(np.array([[[0, -4], [3.0, 0]]]), np.array([[[0, 4], [3.0, 0]]]), square=[[False, True]])
    policy = RecoveringPolicy(linear_policy, ON)
    record = play_episodes(scenes, policy, Reward(), Simulation())
    plain = play_episodes(scenes, linear_policy, Reward(), Simulation())
    np.testing.assert_array_equal(record.position, plain.position)
    assert not policy.helped.any()


def test_a_robot_is_stuck_when_it_has_not_come_nearer_within_the_stall_time():
    """By default after 2 s; recovery hands back to the policy once no square is in the way."""

    def still(world, crowd_velocity):
        return np.zeros((len(world), 2))

    blocked = Scenes([[(0, -4), (0, 0)]], [[(0, 4), (0, 0)]], square=[[False, True]])
    policy = RecoveringPolicy(still, ON)
    record = play_episodes(blocked, policy, Reward(), Simulation(), keep=True)
    moved = np.hypot(*record.velocity[0, 1 : record.steps[0] + 1, 0].T) > 0
    assert not moved[:8].any()
    assert moved[8]
    assert policy.helped.all()
    np.testing.assert_array_equal(record.notes["stuck"][0], moved)
    patient = RecoveringPolicy(still, Planner(recover=True, stall_time=30.0))
    assert not np.nan_to_num(play_episodes(blocked, patient, Reward(), Simulation()).velocity).any()


def test_keeping_notes_changes_nothing_that_is_played():
    scenes, simulation = sample_scenes("map-u", 2), Simulation(time_limit=5.0)
    policy = RecoveringPolicy(SarlPolicy(ValueNetwork(), Config(careful=True)), ON)
    plain, noted = (play_episodes(scenes, policy, Reward(), simulation, keep=keep) for keep in (False, True))
    np.testing.assert_array_equal(noted.position, plain.position)
    assert plain.notes == {}
    assert noted.notes["values"].shape == (*noted.reward.shape, 81)
    np.testing.assert_array_equal(noted.notes["stuck"].any(1), policy.helped)
    one = noted.take([1])
    look = policy.lookahead(one.worlds(), one.velocity[0, 1 : one.steps[0] + 1])
    np.testing.assert_array_equal(one.notes["values"][0, : one.steps[0]], look.values)


def test_the_straight_way_is_judged_by_the_squares_alone():
    places = np.array([[[0, -4], [0.5, 0]], [[0, -4], [0.75, 0]], [[0, -4], [0, 0]]], dtype=float)
    goal = np.array([[[0, 4], [0, 0]]] * 3, dtype=float)
    world = reset(Scenes(places, goal, square=[[False, True], [False, True], [False, False]]))
    np.testing.assert_array_equal(straight_way_is_free(world, 0.1), [False, True, True])


@pytest.mark.parametrize("crowd", ["orca", "sfm"])
def test_an_episode_has_the_same_bits_alone_and_in_a_batch(crowd):
    scenes = sample_scenes("1:0.5,2:0.3,5:0.2", 40, seed=3)
    whole = play_episodes(scenes, RecoveringPolicy(orca_policy, ON), Reward(), Simulation(crowd=crowd), batch=16)
    for e in (0, 5, 16, 17, 39):
        policy = RecoveringPolicy(orca_policy, ON)
        alone = play_episodes(scenes.take([e]), policy, Reward(), Simulation(crowd=crowd))
        np.testing.assert_array_equal(whole.position[e, : alone.steps[0] + 1], alone.position[0])
    again = RecoveringPolicy(orca_policy, ON)  # what it remembers of one play does not reach into the next
    play_episodes(scenes.take([7, 8]), again, Reward(), Simulation(crowd=crowd))
    second = play_episodes(scenes, again, Reward(), Simulation(crowd=crowd))
    np.testing.assert_array_equal(second.position, whole.position)


def test_recovery_is_put_on_and_taken_off_and_leaves_the_network_as_it_was():
    policy = SarlPolicy(ValueNetwork(), Config(careful=True))
    helped = with_recovery(policy, ON)
    assert isinstance(helped, RecoveringPolicy)
    assert helped.network is policy.network
    assert helped.batch == policy.batch
    assert (policy.trap_steps, helped.policy.trap_steps) == (1, 2)
    assert with_recovery(helped, Planner()).trap_steps == 1
    assert with_recovery(find_policy("orca"), Planner()) is orca_policy


def test_a_test_with_recovery_takes_from_the_one_without_what_both_have_in_common(monkeypatch):
    scenes, config = sample_scenes("1:0.5,2:0.5", 8, seed=3), Config(careful=True)
    judged = []
    whole = SarlPolicy.judge
    monkeypatch.setattr(
        SarlPolicy, "judge", lambda self, world, *rest: judged.append(len(world)) or whole(self, world, *rest)
    )

    def play_both(policy) -> list:
        judged.clear()
        pair = policy, with_recovery(policy, ON)
        return [play_episodes(scenes, one, config.reward, config.simulation).position for one in pair]

    expected, states = play_both(SarlPolicy(ValueNetwork(), config)), sum(judged)
    for record, other in zip(play_both(RememberingPolicy(ValueNetwork(), config)), expected, strict=True):
        np.testing.assert_array_equal(record, other)
    assert sum(judged) < 0.9 * states


class StraightOn:
    """Walks to the goals of the scenes with which it began."""

    def begin(self, scenes, simulation):
        self.goal = scenes.goal[:, 0]

    def __call__(self, world, crowd_velocity):
        return limit(self.goal[world.episode] - world.position[:, 0], 1.0)


def test_a_policy_that_begins_plays_once_at_a_time_and_a_copy_in_another_thread():
    scenes = sample_scenes("circle5", 6)
    others = Scenes(scenes.goal, scenes.start)  # to another goal
    policy = RecoveringPolicy(StraightOn(), ON)
    with ThreadPoolExecutor(1) as pool:

        def meanwhile(ended: int) -> None:  # while three of the six episodes are still to be played, too
            for play in (play_episodes, lambda *arguments: pool.submit(play_episodes, *arguments).result()):
                with pytest.raises(ConfigError, match="is already playing"):
                    play(scenes, policy, Reward(), Simulation())
            copied = pool.submit(play_episodes, others, copy.deepcopy(policy), Reward(), Simulation()).result()
            elsewhere.append((ended, copied))

        elsewhere: list[tuple[int, Record]] = []
        record = play_episodes(scenes, policy, Reward(), Simulation(), batch=3, progress=meanwhile)
    assert 3 in [ended for ended, _ in elsewhere]
    again, there = (play_episodes(each, policy, Reward(), Simulation()) for each in (scenes, others))
    np.testing.assert_array_equal(record.position, again.position)
    for _, copied in elsewhere:
        np.testing.assert_array_equal(copied.position, there.position)
