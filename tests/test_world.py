"""The simulator against CrowdNav's episodes and against RVO2 itself, and what its steps promise."""

from dataclasses import fields, replace

import numpy as np
import pyrvo
import pytest
from conftest import DATA
from hypothesis import given
from hypothesis import strategies as st

from sfmrl.actions import ACTIONS
from sfmrl.config import Reward, Simulation
from sfmrl.episodes import Record, play, play_episodes
from sfmrl.geometry import length
from sfmrl.policies import orca_policy
from sfmrl.rewards import COLLISION, OUTCOMES, RUNNING, SUCCESS, TIMEOUT, Transition
from sfmrl.scenes import Scenes, sample_scenes
from sfmrl.world import World, advance, crowd_velocities, reset, transition

FILES = ("5_visible", "5_invisible", "10_visible", "10_invisible", "5_square")


@pytest.fixture(scope="module", params=FILES)
def crowdnav(request) -> tuple[dict[str, np.ndarray], Record]:
    """CrowdNav's sixty test cases, and ours from the same starts."""
    with np.load(DATA / f"crowdnav_orca_{request.param}.npz") as data:
        cases = dict(data)
    visible = not request.param.endswith("_invisible")
    # Inside ORCA, CrowdNav adds 0.01 m to every radius, and 0.15 m more for a robot that nobody sees.
    simulation = Simulation(robot_visible=visible, safety_space=0.0 if visible else 0.15)
    record = play_episodes(Scenes(cases["start"], cases["goal"]), orca_policy, Reward(), simulation)
    return cases, record


def test_outcomes_are_crowdnav_s(crowdnav):
    cases, record = crowdnav
    assert (record.outcome == cases["outcome"]).sum() >= 58
    same = record.outcome == cases["outcome"]
    assert np.abs(record.time - cases["time"])[same].max() <= 1.0


def test_mean_discounted_return_is_crowdnav_s(crowdnav):
    cases, record = crowdnav
    assert record.discounted_return.mean() == pytest.approx(cases["discounted_return"].mean(), abs=0.005)


def test_rewards_are_crowdnav_s_wherever_the_trajectories_agree(crowdnav):
    cases, record = crowdnav
    compared = 0
    for e, steps in enumerate(cases["steps"]):
        for t in range(min(steps, record.steps[e])):
            if np.abs(record.position[e, t] - cases["position"][e, t]).max() > 1e-6:
                break
            if np.abs(record.position[e, t + 1] - cases["position"][e, t + 1]).max() > 1e-6:
                break  # the next action is not the same
            assert record.reward[e, t] == pytest.approx(cases["reward"][e, t], abs=1e-4)
            compared += 1
    assert compared >= 500


@pytest.mark.parametrize("file", ["5_circle_mixed", "5_square_mixed"])
def test_people_with_random_attributes_move_as_crowdnav_s_in_every_step(file):
    """Held step by step: radii and speeds that differ make whole episodes part after the smallest difference."""
    with np.load(DATA / f"crowdnav_orca_{file}.npz") as data:
        cases = dict(data)
    assert np.ptp(cases["radius"]) > 0.15
    assert np.ptp(cases["v_pref"]) > 0.9
    scenes = Scenes(cases["start"], cases["goal"], cases["radius"], cases["v_pref"], preferred_speed=1.0)
    episode, step = np.nonzero(np.arange(cases["velocity"].shape[1] - 1) < cases["steps"][:, None])
    assert len(step) > 2000
    moments = {name: cases[name][episode, step] for name in ("position", "velocity")}
    moves = crowd_velocities(replace(reset(scenes).take(episode), **moments))
    np.testing.assert_allclose(moves, cases["velocity"][episode, step + 1], atol=1e-5)  # ORCA computes in float32


def test_a_preferred_speed_is_that_of_people_on_their_way_and_v_pref_their_limit():
    start, goal = [[[0, -4], [9, 0], [0, 9]]], [[[0, 4], [-9, 0], [0, -9]]]
    for crowd in ("orca", "sfm"):
        scenes = Scenes(start, goal, v_pref=[1.0, 1.5, 0.5], preferred_speed=1.0)
        record = play(scenes, "linear", crowd=crowd)
        np.testing.assert_allclose(length(record.velocity[0, 12]), [1.0, 1.0, 0.5], atol=0.01)
        plain = play(replace(scenes, preferred_speed=None), "linear", crowd=crowd)  # then all prefer v_pref
        np.testing.assert_allclose(length(plain.velocity[0, 12]), [1.0, 1.5, 0.5], atol=0.01)


def rvo2_step(world: World, e: int) -> np.ndarray:
    """Everybody's next velocity in one episode by RVO2, from a simulator made anew for this step."""
    s = world.simulation
    simulator = pyrvo.RVOSimulator(
        s.time_step, s.neighbor_distance, s.max_neighbors, s.time_horizon, s.obstacle_time_horizon, 0.3, 1.0
    )
    square = world.square[e]
    for centre, half in zip(world.position[e, square], world.radius[e, square], strict=True):
        corners = centre + half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        simulator.add_obstacle([tuple(corner) for corner in corners.tolist()])
    simulator.process_obstacles()
    agents = np.flatnonzero(~square)
    for number, row in enumerate(agents):
        simulator.add_agent(tuple(world.position[e, row].tolist()))
        simulator.set_agent_radius(number, float(world.radius[e, row]) + s.clearance)
        simulator.set_agent_max_speed(number, float(world.v_pref[e, row]))
        simulator.set_agent_velocity(number, tuple(world.velocity[e, row].tolist()))
        way = world.goal[e, row] - world.position[e, row]
        preferred = way / max(np.hypot(*way) / world.v_pref[e, row], 1.0)
        simulator.set_agent_pref_velocity(number, tuple(preferred.tolist()))
    simulator.do_step()
    found = np.zeros((len(square), 2))
    for number, row in enumerate(agents):
        velocity = simulator.get_agent_velocity(number)
        found[row] = velocity.x, velocity.y
    return found


OTHER = {"time_step": 0.4, "neighbor_distance": 4.0, "max_neighbors": 4, "clearance": 0.05}
OTHER |= {"time_horizon": 3.0, "obstacle_time_horizon": 2.0}


@pytest.mark.parametrize(
    ("environment", "episode", "settings"), [("2", 3, {}), ("1", 5, {}), ("4", 0, {}), ("1", 5, OTHER)]
)
def test_an_episode_step_by_step_by_rvo2_from_the_same_positions(environment, episode, settings):
    world = reset(sample_scenes(environment, [episode]), Simulation(**settings))
    difference = []
    for _ in range(60):
        moves = crowd_velocities(world)
        difference.append(np.abs(moves[0] - rvo2_step(world, 0)).max())
        action = moves[:, 0]
        if transition(world, action).outcome[0] != RUNNING:
            break
        world = advance(world, moves, action)
    assert len(difference) > 20
    assert np.mean(np.array(difference) < 1e-4) >= 0.95


def world_at(position, velocity, goal, steps=0, radius=0.3) -> World:
    """A world of one episode in a given moment, (N, 2) each."""
    world = reset(Scenes([position], [goal], radius=radius))
    return replace(world, velocity=np.array([velocity], dtype=float), steps=np.array([steps]))


ACROSS = {"position": [(0, 0), (0.7, 0)], "velocity": [(0, 0), (0, 0)], "goal": [(0.1, 0), (5, 0)]}


@pytest.mark.parametrize(
    ("world", "action", "outcome"),
    [
        (world_at(**ACROSS, steps=95), (1, 0), COLLISION),  # a collision counts before the goal
        (world_at(**ACROSS, steps=96), (1, 0), TIMEOUT),  # at 24 s nothing else counts any more
        (world_at(**ACROSS), (0, 0), SUCCESS),
        (world_at([(0, 0), (3, 0)], [(0, 0), (0, 0)], [(1, 0), (5, 0)]), (1, 0), RUNNING),
        (world_at([(0, 0), (3, 0)], [(0, 0), (0, 0)], [(0.55, 0), (5, 0)]), (1, 0), RUNNING),  # exactly one radius
        (world_at([(0, 0), (3, 0)], [(0, 0), (0, 0)], [(0.54, 0), (5, 0)]), (1, 0), SUCCESS),
        (world_at([(0, 0), (0.6, 0)], [(0, 0), (0, 0)], [(0, 4), (5, 0)]), (0, 1), RUNNING),  # touching is no overlap
        (world_at([(0, 0), (0.8, 0)], [(0, 0), (-1, 0)], [(0, 4), (5, 0)]), (0, 0), COLLISION),
    ],
)
def test_outcomes_are_judged_in_crowdnav_s_order(world, action, outcome):
    found = transition(world, np.array([action], dtype=float)).outcome[0]
    assert OUTCOMES[found] == OUTCOMES[outcome]


@given(st.integers(0, 1000), st.sampled_from(["1", "2", "5", "circle"]))
def test_all_actions_at_once_are_the_same_bits_as_one_by_one(seed, environment):
    world = reset(sample_scenes(environment, 3, seed))
    rng = np.random.default_rng(seed)
    world = replace(world, velocity=rng.uniform(-1, 1, world.velocity.shape), steps=np.array([0, 50, 96]))
    at_once = transition(world, np.broadcast_to(ACTIONS, (3, *ACTIONS.shape)))
    assert at_once.outcome.shape == (3, 81)
    for a in range(0, 81, 9):
        one = transition(world, np.broadcast_to(ACTIONS[a], (3, 2)))
        for name in [item.name for item in fields(Transition)]:
            np.testing.assert_array_equal(getattr(at_once, name)[:, a], getattr(one, name), err_msg=name)


def test_the_lookahead_s_transition_is_the_one_that_then_happens():
    record = play(sample_scenes("1", 4), "orca")
    world = record.worlds()
    action = record.transition.velocity[record.played]
    found = transition(world, action[:, None])
    for name in vars(found):
        expected = getattr(record.transition, name)[record.played]
        np.testing.assert_array_equal(getattr(found, name)[:, 0], expected, err_msg=name)


@pytest.mark.parametrize("crowd", ["orca", "sfm"])
def test_people_who_do_not_see_the_robot_walk_the_same_way_whatever_it_does(crowd):
    scenes = sample_scenes("1", 8, seed=1)
    one, other = (play(scenes, policy, robot_visible=False, crowd=crowd) for policy in ("linear", "orca"))
    for e in range(8):
        both = min(one.steps[e], other.steps[e]) + 1
        np.testing.assert_array_equal(one.position[e, :both, 1:], other.position[e, :both, 1:])
    assert not np.array_equal(one.position[:, :20, 0], other.position[:, :20, 0])
    seen = play(scenes, "linear", crowd=crowd)
    assert not np.array_equal(seen.position[:, :20, 1:], one.position[:, :20, 1:])


@pytest.mark.parametrize("crowd", ["orca", "sfm"])
def test_squares_rest_and_absent_rows_stay_absent(crowd):
    scenes = sample_scenes("circle4:0.5,2:0.5", 6)
    assert np.isnan(scenes.start).any()
    assert scenes.square.any()
    record = play(scenes, "orca", crowd=crowd)
    for e, steps in enumerate(record.steps):
        absent = np.isnan(scenes.start[e, :, 0])
        assert np.isnan(record.position[e, : steps + 1, absent]).all()
        assert np.isfinite(record.position[e, : steps + 1, ~absent]).all()
        square = scenes.square[e]
        assert (record.position[e, : steps + 1, square] == scenes.start[e, square][:, None]).all()
        assert (record.transition.separations[e, :steps][:, absent[1:]] == np.inf).all()


def test_two_people_and_a_robot_head_on_pass_without_touching():
    scenes = Scenes([[[0.0, -4.0], [0.05, 4.0], [4.0, 0.1]]], [[[0.0, 4.0], [0.0, -4.0], [-4.0, 0.0]]])
    record = play(scenes, "orca")
    assert list(record.outcome) == ["success"]
    assert np.nanmin(record.transition.separations) > 0


def test_nobody_runs_faster_than_preferred():
    record = play(sample_scenes("table2", 8), "orca")
    assert np.nanmax(np.hypot(*np.moveaxis(record.velocity, -1, 0))) <= 1 + 1e-5


@pytest.mark.parametrize("crowd", ["orca", "sfm"])
@pytest.mark.parametrize("shift", [(64e4, -128e4), (4e6, 5e5)])
def test_an_episode_goes_the_same_way_wherever_it_takes_place(crowd, shift):
    scenes = sample_scenes("2:0.5,circle:0.5", 6)
    start, goal = (np.round(places * 2**20) / 2**20 for places in (scenes.start, scenes.goal))
    here = play(Scenes(start, goal, square=scenes.square), "orca", crowd=crowd)
    there = play(Scenes(start + shift, goal + shift, square=scenes.square), "orca", crowd=crowd)
    np.testing.assert_array_equal(here.steps, there.steps)
    np.testing.assert_allclose(there.position[:, :20] - shift, here.position[:, :20], atol=1e-3)


def test_people_of_other_sizes_do_not_touch_by_the_social_force_model():
    scenes = Scenes([[(20, 0), (0, -4), (0.1, 4)]], [[(-20, 0), (0, 4), (0.1, -4)]], radius=[0.3, 0.8, 0.5])
    record = play(scenes, "linear", crowd="sfm", robot_visible=False)
    people = record.position[0, :, 1:]
    assert length(people[:, 0] - people[:, 1]).min() > 1.3


def test_a_scene_with_nobody_in_it():
    record = play(Scenes([[[0.0, -4.0]]], [[[0.0, 4.0]]]), "orca")
    assert list(record.outcome) == ["success"]
    np.testing.assert_allclose(record.position[0, :, 0, 0], 0, atol=1e-6)
    assert record.steps[0] == 33  # 7 s at 1 m/s, then a quarter of what is left in every step until it is below 0.3 m


@pytest.mark.parametrize(
    ("squares", "outcome", "gap"), [("solid", COLLISION, -0.3), ("disc", RUNNING, 1.9 / 2**0.5 - 1.3)]
)
def test_a_corner_of_a_square_is_solid_unless_squares_count_as_discs(squares, outcome, gap):
    """The robot's centre crosses the corner of a square of side 2 m, and just misses the disc inside it."""
    simulation = Simulation(squares=squares, time_step=1.0)
    world = reset(
        Scenes([[[0.45, 1.45], [0, 0]]], [[[9, 0], [0, 0]]], radius=[[0.3, 1.0]], square=[[False, True]]), simulation
    )
    step = transition(world, np.array([[1.0, -1.0]]))
    assert step.outcome[0] == outcome
    assert step.separations[0, 0] == pytest.approx(gap, abs=1e-9)


def test_an_action_of_another_shape_or_that_is_not_finite_is_refused_and_lists_and_integers_do():
    world = reset(Scenes([[[0, 0], [3, 0]]], [[[0, 4], [0, 0]]]))
    moves = np.array([[[0, 0], [-1, 0]]])
    for step in (transition, lambda world, action: advance(world, moves, action)):
        for action, said in (
            ([0.6, 0.8], r"action must have shape \(1, 2\).*, not \(2,\)"),
            ([[0.6, 0.8]] * 2, "action must have shape"),
            ([[0.6, 0.8, 0.0]], "action must have shape"),
            ([[np.nan, 0.0]], "action is NaN or infinite"),
        ):
            with pytest.raises(ValueError, match=said):
                step(world, action)
    with pytest.raises(ValueError, match=r"action must have shape \(1, 2\), not \(1, 1, 2\)"):
        advance(world, moves, [[[0.6, 0.8]]])
    after = advance(world, moves, [[0.6, 0.8]])
    np.testing.assert_array_equal(after.velocity, [[[0.6, 0.8], [-1.0, 0.0]]])
    np.testing.assert_array_equal(transition(world, [[0, 1]]).velocity, [[0.0, 1.0]])
    with pytest.raises(ValueError, match="read-only"):
        ACTIONS[0] = 1.0


def test_one_episode_can_be_taken_by_its_number():
    world = reset(sample_scenes("circle5", 3))
    assert world.take(1).position.shape == (1, 6, 2)
    record = play(sample_scenes("circle5", 3), "linear")
    assert (len(record), len(record.take(-1))) == (3, 1)


def test_a_play_takes_a_simulation_of_which_its_other_arguments_change_a_part():
    far = Scenes([[[0.0, 0.0]]], [[[0.0, 40.0]]])
    assert play(far, "linear").outcome.tolist() == ["timeout"]
    record = play(far, "linear", simulation=Simulation(time_limit=60.0, time_step=0.5), kinematics="unicycle")
    assert record.outcome.tolist() == ["success"]
    assert (record.simulation.time_step, record.simulation.kinematics) == (0.5, "unicycle")
