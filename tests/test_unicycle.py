"""A robot that turns: CrowdNav's own unicycle episodes, what such a robot can do, and what policies make of it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import DATA
from hypothesis import given
from hypothesis import strategies as st

from sfmrl.actions import robot_actions
from sfmrl.config import Config, Planner, Simulation
from sfmrl.episodes import Record, play
from sfmrl.evaluation import evaluation_record
from sfmrl.geometry import length, wrapped
from sfmrl.learning import Memory
from sfmrl.lessons.explain import explain_episode
from sfmrl.lessons.explanation_tables import explanation_parts
from sfmrl.lookahead import SarlPolicy, world_states
from sfmrl.network import ValueNetwork
from sfmrl.policies import load_policy
from sfmrl.recovery import RecoveringPolicy
from sfmrl.replay.frames import Replay
from sfmrl.replay.panel import action_disc
from sfmrl.replay.story import make_story
from sfmrl.rewards import COLLISION, OUTCOMES, reward_terms, total
from sfmrl.runs.demonstrations import load_demonstrations, save_demonstrations
from sfmrl.scenes import Scenes, sample_scenes
from sfmrl.states import COLUMNS, robot_states
from sfmrl.traps import trapped
from sfmrl.world import World, advance, crowd_velocities, drive, reset, transition, turned

UNICYCLE = Simulation(kinematics="unicycle")
QUARTER = np.pi / 4  # rad, the most in a step of 0.25 s


@pytest.fixture(scope="module")
def crowdnav() -> dict[str, np.ndarray]:
    with np.load(DATA / "crowdnav_unicycle.npz") as data:
        return dict(data)


def driven(crowdnav: dict[str, np.ndarray]):
    """A policy that takes CrowdNav's speeds and turns."""

    def policy(world: World, crowd_velocity: np.ndarray) -> np.ndarray:
        speed, turn = crowdnav["action"][world.episode, world.steps].T
        return speed[:, None] * np.stack((np.cos(world.heading + turn), np.sin(world.heading + turn)), -1)

    return policy


def crowdnav_record(crowdnav: dict[str, np.ndarray]) -> Record:
    """CrowdNav's actions driven, and its own moments in the record: RVO2's people move with float32's precision."""
    record = play(Scenes(crowdnav["start"], crowdnav["goal"]), driven(crowdnav), kinematics="unicycle")
    return replace(record, **{name: crowdnav[name] for name in ("position", "velocity", "heading")})


def test_crowdnav_s_actions_lead_to_its_positions_headings_and_outcomes(crowdnav):
    record = play(Scenes(crowdnav["start"], crowdnav["goal"]), driven(crowdnav), kinematics="unicycle")
    np.testing.assert_array_equal(record.steps, crowdnav["steps"])
    np.testing.assert_allclose(record.time, crowdnav["time"])
    assert record.outcome.tolist() == crowdnav["outcome"].tolist()
    for name in ("position", "velocity"):
        found, expected = getattr(record, name), crowdnav[name]
        np.testing.assert_allclose(found[:, :, 0], expected[:, :, 0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)
    off = wrapped(record.heading - crowdnav["heading"])
    np.testing.assert_allclose(off, np.where(np.isnan(crowdnav["heading"]), np.nan, 0.0), atol=1e-9)


def test_its_steps_pay_crowdnav_s_rewards(crowdnav):
    record = crowdnav_record(crowdnav)
    worlds, moves = record.worlds(), driven(crowdnav)
    step = transition(worlds, drive(worlds, moves(worlds, worlds.velocity)))
    found = total(reward_terms("crowd")(step))
    np.testing.assert_allclose(found, crowdnav["reward"][record.played], rtol=0, atol=1e-9)


@pytest.mark.parametrize("stored", [False, True])
def test_the_network_reads_crowdnav_s_states_with_theta_wrapped(crowdnav, stored, tmp_path):
    record = crowdnav_record(crowdnav)
    if stored:
        save_demonstrations(record, tmp_path / "demonstrations.npz")
        record = load_demonstrations(tmp_path / "demonstrations.npz", UNICYCLE)
    expected, theta = crowdnav["rotated"][record.played], COLUMNS.index("theta")
    assert (expected[..., theta] > np.pi).any()
    expected[..., theta] = wrapped(expected[..., theta])
    np.testing.assert_array_equal(record.states(Config()), world_states(record.worlds(), Config()))
    by_distance = (
        np.argsort(s[..., COLUMNS.index("distance")])[..., None] for s in (record.states(Config()), expected)
    )
    found, expected = (
        np.take_along_axis(s, order, 1)
        for s, order in zip((record.states(Config()), expected), by_distance, strict=True)
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)


def test_all_81_actions_have_crowdnav_s_values(crowdnav):
    """But for those after which CrowdNav's theta, which it does not wrap, lies beyond pi: its network reads another."""
    with np.load(DATA / "crowdnav_sarl.npz") as data:
        weights = {name.removeprefix("weights/"): data[name] for name in data if name.startswith("weights/")}
    network = ValueNetwork()
    network.load_state_dict({name: value.new_tensor(weights[name]) for name, value in network.state_dict().items()})
    record = crowdnav_record(crowdnav)
    worlds, (episode, step) = record.worlds(), np.nonzero(record.played)
    look = SarlPolicy(network, Config()).lookahead(worlds, record.velocity[episode, step + 1])
    speed, turn = crowdnav["actions"].T
    heading = worlds.heading[:, None] + turn
    driven_to = speed[..., None] * np.stack((np.cos(heading), np.sin(heading)), -1)
    np.testing.assert_allclose(look.actions, driven_to, rtol=0, atol=1e-9)
    way = worlds.goal[:, :1] - worlds.position_after(driven_to)
    same = np.abs(heading - np.arctan2(way[..., 1], way[..., 0])) < np.pi
    assert same.mean() > 0.98
    np.testing.assert_allclose(look.values[same], crowdnav["values"][record.played][same], rtol=0, atol=1e-5)


def some_worlds(episodes: int, seed: int, **simulation: float) -> World:
    """Robots that point anywhere, in scenes of environment 1."""
    world = reset(sample_scenes("1", episodes), Simulation(kinematics="unicycle", **simulation))
    heading = np.random.default_rng(seed).uniform(-np.pi, np.pi, episodes)
    return World(**{**vars(world), "heading": heading})


@given(st.integers(0, 10_000), st.sampled_from([0.1, 0.25, 0.5]))
def test_a_step_turns_as_far_as_it_can_towards_what_is_wanted_and_drives_with_the_rest_s_projection(seed, time_step):
    world = some_worlds(20, seed, time_step=time_step)
    rng = np.random.default_rng(seed + 1)
    wanted = rng.uniform(-1, 1, (20, 2))
    after = advance(world, np.zeros_like(world.velocity), wanted)
    for e in range(20):
        way = np.arctan2(wanted[e, 1], wanted[e, 0]) - world.heading[e]
        turn = np.arctan2(np.sin(way), np.cos(way))
        done = np.clip(turn, -np.pi * time_step, np.pi * time_step)
        speed = max(0.0, np.hypot(*wanted[e]) * np.cos(turn - done))
        heading = world.heading[e] + done
        np.testing.assert_allclose(wrapped(after.heading[e] - heading), 0, atol=1e-9)
        expected = speed * np.cos(heading), speed * np.sin(heading)
        np.testing.assert_allclose(after.velocity[e, 0], expected, atol=1e-9)
        np.testing.assert_allclose(
            after.position[e, 0] - world.position[e, 0], time_step * np.array(expected), atol=1e-9
        )
    many = np.broadcast_to(wanted[:, None], (20, 3, 2))
    np.testing.assert_array_equal(drive(world, many)[:, 1], after.velocity[:, 0])
    np.testing.assert_array_equal(turned(world, many)[:, 1], after.heading)


def test_a_robot_that_wants_to_stop_keeps_its_heading_and_one_that_wants_back_turns_on_the_spot():
    world = some_worlds(10, 3)
    still = advance(world, np.zeros_like(world.velocity), np.zeros((10, 2)))
    np.testing.assert_array_equal(still.heading, world.heading)
    back = -np.stack((np.cos(world.heading + 0.2), np.sin(world.heading + 0.2)), -1)
    after = advance(world, np.zeros_like(world.velocity), back)
    np.testing.assert_array_equal(after.velocity[:, 0], 0.0)
    np.testing.assert_allclose(wrapped(after.heading - world.heading), -QUARTER)


def test_what_is_among_the_81_actions_can_be_driven_as_it_is_and_nothing_else_is_for_holonomic_robots():
    world = some_worlds(30, 4)
    actions = robot_actions(world)
    np.testing.assert_allclose(drive(world, actions), actions, atol=1e-12)
    free = reset(sample_scenes("1", 3))
    wanted = np.ones((3, 2))
    assert drive(free, wanted) is wanted
    assert free.heading is None is turned(free, wanted)


@pytest.mark.parametrize("forces", [False, True])
def test_mirrored_states_are_those_of_the_mirrored_world(forces):
    rng = np.random.default_rng(2)
    position, velocity = rng.normal(0, 3, (2, 8, 4, 2))
    goal, heading = rng.normal(0, 3, (8, 2)), rng.uniform(-np.pi, np.pi, 8)

    def states_of(sign: int) -> np.ndarray:
        mirror = [1.0, float(sign)]
        robot = (position[:, 0] * mirror, velocity[:, 0] * mirror, goal * mirror, 0.3, 1.0)
        elements = position[:, 1:] * mirror, velocity[:, 1:] * mirror, np.full((8, 3), 0.3)
        return robot_states(*robot, *elements, heading=sign * heading, forces=forces)

    memory = Memory(8, 3, forces=forces, mirror=True)
    memory.push(states_of(1), np.zeros(8))
    taken, _ = memory.take(np.arange(8))
    np.testing.assert_allclose(taken[::2], states_of(-1)[::2], atol=1e-5)
    assert np.ptp(taken[..., COLUMNS.index("theta")]) > 1


@pytest.mark.parametrize("steps", [1, 2])
def test_traps_are_those_of_the_actions_that_a_robot_has_after_each_turn(steps):
    """Every sequence, one by one, from each world's own actions; people walk at the robot from all sides."""
    rng = np.random.default_rng(1)
    angle, apart = rng.uniform(0, 2 * np.pi, (60, 5)), rng.uniform(0.61, 1.0, (60, 5))
    around = apart[..., None] * np.stack((np.cos(angle), np.sin(angle)), -1)
    start = np.concatenate((np.zeros((60, 1, 2)), around), 1)
    world = reset(Scenes(start, -start), UNICYCLE)
    velocity = -np.concatenate((np.zeros((60, 1, 2)), around), 1)
    world = World(**{**vars(world), "velocity": velocity, "heading": rng.uniform(-np.pi, np.pi, 60)})
    some = np.array([0, 3, 5, 40, 45, 78, 80])

    def lost(world: World, depth: int) -> bool:
        actions = robot_actions(world)[:, some]
        hit = transition(world, actions).outcome[0] == COLLISION
        if depth == 1 or hit.all():
            return hit.all()
        moves = crowd_velocities(world)
        return all(lost(advance(world, moves, actions[:, a]), depth - 1) for a in np.flatnonzero(~hit))

    found = trapped(world, robot_actions(world)[:, some], steps)
    expected = [lost(world.take(slice(e, e + 1)), steps) for e in range(60)]
    np.testing.assert_array_equal(found, expected)
    assert 5 < found.sum() < 55


@pytest.mark.parametrize("policy", ["linear", "orca", "sfm"])
def test_every_policy_drives_within_the_limits(policy):
    record = play(sample_scenes("1", 20), policy, kinematics="unicycle")
    turn = wrapped(np.diff(record.heading))[record.played]
    assert np.nanmax(np.abs(turn)) <= QUARTER + 1e-9
    velocity, heading = record.transition.velocity[record.played], record.heading[:, 1:][record.played]
    along = velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading)
    np.testing.assert_allclose(along, length(velocity), atol=1e-9)
    if policy == "orca":
        assert (record.outcome == "success").mean() > 0.5


def test_a_robot_alone_that_points_away_turns_and_arrives():
    """With an untrained network; and the same with recovery, whose robot stands behind a wall of squares."""
    goals = np.array([[[4.0, 0.0]], [[-4.0, 0.5]], [[0.5, 0.0]], [[0.0, -0.5]], [[-0.4, 0.1]], [[0.0, 2.0]]])
    world = reset(Scenes(np.zeros((6, 1, 2)), goals), UNICYCLE)
    world = World(**{**vars(world), "heading": np.array([np.pi, 0.0, np.pi, 1.6, 0.1, -1.6])})
    policy = SarlPolicy(ValueNetwork(), Config(careful=True))
    time = np.zeros(6)
    for _ in range(40):
        moves = crowd_velocities(world)
        action = policy(world, moves)
        arrived = OUTCOMES[transition(world, action).outcome] == "success"
        time = np.where(arrived & (time == 0), world.time + 0.25, time)
        world = advance(world, moves, action)
    assert (time > 0).all()
    assert (time <= length(goals[:, 0]) + 1.75).all()


def test_recovery_leads_a_unicycle_out_of_a_barrier():
    """It alone drives, from the first step on; straight ahead, a robot ends in the barrier."""

    class Led(RecoveringPolicy):
        def watch(self, world: World) -> np.ndarray:
            return np.ones(len(world), dtype=bool)

    scenes = sample_scenes("2", 20)
    straight, led, holonomic = (
        play(scenes, policy, kinematics=kinematics)
        for policy, kinematics in (
            ("linear", "unicycle"),
            (Led(load_policy("linear"), Planner()), "unicycle"),
            (Led(load_policy("linear"), Planner()), "holonomic"),
        )
    )
    assert not (straight.outcome == "success").any()
    assert (led.outcome == "timeout").sum() <= 1
    assert (led.outcome == "success").sum() >= (holonomic.outcome == "success").sum() - 4


def test_an_evaluation_with_recovery_is_the_same_from_memory():
    from sfmrl.recovery.remembering import RememberingPolicy

    network, config = load_policy("sarl-sfm2").network, load_policy("sarl-sfm2").config
    plain, remembering = SarlPolicy(network, config), RememberingPolicy(network, config)
    how = {"episodes": 4, "simulation": UNICYCLE}
    evaluation_record(remembering, **how)
    one, other = (evaluation_record(RecoveringPolicy(policy, Planner()), **how) for policy in (plain, remembering))
    np.testing.assert_array_equal(one.position, other.position)
    np.testing.assert_array_equal(one.heading, other.heading)


def test_a_replay_shows_where_the_robot_points_and_explain_how_it_turns():
    """A robot that turns on the spot, from the right to straight up; the disc of actions is empty behind it."""
    world = some_worlds(1, 0)
    up, right = np.array([[0.0, 1.0]]), np.array([[1.0, 0.0]])
    scenes = Scenes([[[0, 0], [3, 3]]], [[[9, 0], [3, 3]]])
    record = play(scenes, lambda world, moves: -right if world.steps[0] < 2 else 0.0 * up, kinematics="unicycle")
    story = make_story(record, load_policy("linear"), Config().reward, 0.9)
    frames = [Replay((story,), ("own",)).frame(t).plain for t in (0, 1, 2, 3)]
    assert ["→" in frame for frame in frames] == [True, False, False, False]
    explained = explain_episode(record, 0, load_policy("linear"), Config().reward, 0.9)
    assert [round(row["turn"]) for row in explained.steps[:3]] in ([45, 45, 0], [-45, -45, 0])
    table = explanation_parts(explained, explained.steps[:3], "own", 80)[1]
    assert [str(column.header) for column in table.columns][:3] == ["step", "time", "turn"]
    assert "45°" in next(iter(table.columns[2].cells))
    holonomic = explain_episode(play(scenes, "linear"), 0, load_policy("linear"), Config().reward, 0.9)
    assert "turn" not in holonomic.steps[0]
    actions = robot_actions(World(**{**vars(world), "heading": np.array([np.pi / 2])}))[0]
    lines = [line.plain for line in action_disc(actions, np.arange(81.0), 0, rows=9)]
    assert lines[0].strip()
    assert not "".join(lines[7:]).strip()


def test_commands_drive_a_unicycle_from_training_to_explanation(sfmrl, tmp_path):
    short = ("--time-limit", 14, "--kinematics", "unicycle")
    il = sfmrl("il", *short, "--episodes", 8, "--epochs", 1, "--run", "il")
    assert il.returncode == 0, il.stderr
    assert "--kinematics unicycle" in il.stderr
    assert sfmrl("rl", "--from", "il", "--time-limit", 14).returncode == 2  # of another simulation
    few = ("--episodes", 4, "--batches", 1, "--validation-episodes", 1, "--test-episodes", 2)
    rl = sfmrl("rl", "--from", "il", *short, *few, "--run", "rl")
    assert rl.returncode == 0, rl.stderr
    assert sfmrl("verify", "rl").returncode == sfmrl("verify", "il").returncode == 0
    assert "turn" in sfmrl("explain", "rl").stdout
    assert sfmrl("ascii-render", "rl", "--frames", 2).returncode == 0
    compared = sfmrl("compare", "rl", "orca", "--episodes", 2, "--kinematics", "unicycle")
    assert compared.returncode == 0, compared.stderr
    wrong = sfmrl("eval", "orca", "--kinematics", "unicycl")
    assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1)
    assert "did you mean unicycle" in wrong.stderr


def test_a_comparison_plays_each_network_with_the_robot_that_it_was_trained_to_drive(sfmrl):
    words = ("--episodes", 6, "--environment", "1", "--json", "--no-recover")
    both = json.loads(sfmrl("compare", "sarl-sfm2", "sarl-sfm2-unicycle", *words).stdout)["policies"][1]
    alone = json.loads(sfmrl("eval", "sarl-sfm2-unicycle", *words).stdout)
    assert both["social"]["heading_change"] == alone["social"]["heading_change"]
    given = sfmrl("compare", "sarl-sfm2", "sarl-sfm2-unicycle", *words, "--kinematics", "holonomic")
    other = json.loads(given.stdout)["policies"][1]
    assert other["social"]["heading_change"] != alone["social"]["heading_change"]
