"""Robot-centred states against CrowdNav's own, and what must not matter to them."""

import numpy as np
import pytest
from conftest import DATA
from hypothesis import given
from hypothesis import strategies as st

from sfmrl.sfm import SocialForce, repulsive_forces
from sfmrl.states import (
    COLUMNS,
    COLUMNS_WITH_FORCES,
    column_names,
    elements_within,
    robot_states,
)


def random_scene(seed: int, elements: int = 4, episodes: int = 3) -> dict[str, np.ndarray]:
    """Arguments of `robot_states`, all random."""
    rng = np.random.default_rng(seed)
    return {
        "position": rng.uniform(-4, 4, (episodes, 2)),
        "velocity": rng.uniform(-1, 1, (episodes, 2)),
        "goal": rng.uniform(-4, 4, (episodes, 2)),
        "radius": rng.uniform(0.2, 0.5, episodes),
        "v_pref": rng.uniform(0.5, 1.5, episodes),
        "element_position": rng.uniform(-4, 4, (episodes, elements, 2)),
        "element_velocity": rng.uniform(-1, 1, (episodes, elements, 2)),
        "element_radius": rng.uniform(0.2, 0.5, (episodes, elements)),
    }


def column(states: np.ndarray, name: str, forces: bool = False) -> np.ndarray:
    return states[..., column_names(forces).index(name)]


def test_states_equal_crowdnav_s():
    with np.load(DATA / "crowdnav_sarl.npz") as data:
        robot, humans, expected = data["robot"].astype(float), data["humans"].astype(float), data["rotated"]
    found = robot_states(
        robot[:, 0:2],
        robot[:, 2:4],
        robot[:, 5:7],
        robot[:, 4],
        robot[:, 7],
        humans[..., 0:2],
        humans[..., 2:4],
        humans[..., 4],
    )
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)


def test_columns_have_the_paper_s_order():
    own = ("goal_distance", "v_pref", "theta", "radius", "velocity_x", "velocity_y")
    assert COLUMNS[:6] == COLUMNS_WITH_FORCES[:6] == own
    assert COLUMNS_WITH_FORCES[6:8] == ("resultant_x", "resultant_y")
    assert COLUMNS_WITH_FORCES[8:15] == COLUMNS[6:]
    assert COLUMNS_WITH_FORCES[15:] == ("force_x", "force_y")
    assert (len(column_names(False)), len(column_names(True))) == (13, 17)
    assert len(set(COLUMNS_WITH_FORCES)) == 17


def test_a_state_by_hand():
    """Robot at (1, 1), goal straight up, one element up and to the right: the frame's x axis points up."""
    states = robot_states(
        np.array([1.0, 1.0]),
        np.array([0.3, 0.4]),
        np.array([1.0, 4.0]),
        np.array(0.3),
        np.array(1.2),
        np.array([[4.0, 5.0]]),
        np.array([[-1.0, 0.5]]),
        np.array([0.25]),
    )
    expected = [3.0, 1.2, 0.0, 0.3, 0.4, -0.3, 4.0, -3.0, 0.5, 1.0, 0.25, 5.0, 0.55]
    np.testing.assert_allclose(states[0], expected, rtol=1e-6, atol=1e-7)


def test_force_columns_are_the_sfm_s_forces_turned_into_the_robot_s_frame():
    scene = random_scene(0)
    states = robot_states(**scene, forces=True)
    offset = scene["position"][:, None] - scene["element_position"]
    push = repulsive_forces(offset, SocialForce(a=1.0, b=1.0, d=0.0))  # in the world's frame
    way = scene["goal"] - scene["position"]
    angle = np.arctan2(way[:, 1], way[:, 0])
    along = np.stack((np.cos(angle), np.sin(angle)), -1)[:, None]
    left = np.stack((-np.sin(angle), np.cos(angle)), -1)[:, None]
    np.testing.assert_allclose(column(states, "force_x", True), (push * along).sum(-1), atol=1e-6)
    np.testing.assert_allclose(column(states, "force_y", True), (push * left).sum(-1), atol=1e-6)
    for axis, frame in (("x", along), ("y", left)):
        expected = np.repeat((push.sum(1, keepdims=True) * frame).sum(-1), 4, axis=1)
        np.testing.assert_allclose(column(states, f"resultant_{axis}", True), expected, atol=1e-6)
    plain = robot_states(**scene)
    for name in COLUMNS:
        np.testing.assert_array_equal(column(states, name, True), column(plain, name))


@given(
    st.integers(0, 10_000), st.floats(-np.pi, np.pi), st.tuples(st.floats(-50, 50), st.floats(-50, 50)), st.booleans()
)
def test_turning_and_moving_the_world_changes_no_state(seed, angle, shift, forces):
    scene = random_scene(seed)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    moved = dict(scene)
    for name in ("position", "goal", "element_position"):
        moved[name] = scene[name] @ turn + np.array(shift)
    for name in ("velocity", "element_velocity"):
        moved[name] = scene[name] @ turn
    np.testing.assert_allclose(robot_states(**moved, forces=forces), robot_states(**scene, forces=forces), atol=2e-5)


@pytest.mark.parametrize("forces", [False, True])
def test_absent_elements_are_nan_in_their_own_columns_and_push_nobody(forces):
    scene = random_scene(1, elements=5)
    for name in ("element_position", "element_velocity"):
        scene[name][:, 2] = np.nan
    states = robot_states(**scene, forces=forces)
    here = [0, 1, 3, 4]
    fewer = dict(scene)
    for name in ("element_position", "element_velocity", "element_radius"):
        fewer[name] = scene[name][:, here]
    np.testing.assert_array_equal(states[:, here], robot_states(**fewer, forces=forces))
    assert np.isnan(column(states, "element_x", forces)[:, 2]).all()
    assert np.isfinite(column(states, "goal_distance", forces)).all()


def test_a_robot_at_its_goal_is_not_turned():
    scene = random_scene(2)
    scene["goal"] = scene["position"]
    states = robot_states(**scene, forces=True)
    assert np.isfinite(states).all()
    np.testing.assert_allclose(column(states, "velocity_x", True), np.repeat(scene["velocity"][:, :1], 4, 1), rtol=1e-6)


def test_any_leading_axes_broadcast():
    scene = random_scene(3, episodes=1)
    many = {name: value[0] for name, value in scene.items()}
    many["velocity"] = np.random.default_rng(0).uniform(-1, 1, (2, 5, 2))
    states = robot_states(**many)
    assert states.shape == (2, 5, 4, 13)
    one = robot_states(**{**many, "velocity": many["velocity"][1, 3]})
    np.testing.assert_array_equal(states[1, 3], one)


def test_lists_do_and_wrong_shapes_are_named():
    scene = random_scene(5)
    as_lists = {name: value.tolist() for name, value in scene.items()}
    np.testing.assert_array_equal(robot_states(**as_lists, forces=True), robot_states(**scene, forces=True))
    for name, value, message in (
        ("goal", 3.0, r"goal must have shape \(\.\.\., 2\), not \(\)"),
        ("velocity", "fast", "velocity must be a number"),
        ("element_radius", 0.3, r"\(\.\.\., K\) with the same K, not \(.*\) and \(\)"),
        ("element_velocity", scene["element_velocity"][..., :1, :], "with the same K"),
    ):
        with pytest.raises(ValueError, match=message):
            robot_states(**scene | {name: value})


@pytest.mark.parametrize("forces", [False, True])
def test_nobody_around_is_one_absent_element(forces):
    scene = random_scene(4, elements=0)
    states = robot_states(**scene, forces=forces)
    assert states.shape == (3, 1, len(column_names(forces)))
    assert np.isnan(column(states, "element_x", forces)).all()
    distance = np.hypot(*(scene["goal"] - scene["position"]).T)
    np.testing.assert_allclose(column(states, "goal_distance", forces)[:, 0], distance, rtol=1e-6)
    if forces:
        assert (column(states, "resultant_x", forces) == 0).all()


def test_elements_out_of_reach_are_as_if_they_were_not_there():
    position = np.array([[[1.0, 0.0], [1.0, 10.0], [-9.1, 0.0], [np.nan, np.nan]]])
    np.testing.assert_array_equal(elements_within(np.inf, position), position[:, 1:])
    expected = [[[1.0, 10.0], [np.nan, np.nan], [np.nan, np.nan]]]
    np.testing.assert_array_equal(elements_within(10.0, position), expected)
    states = robot_states(
        [[1, 0]], [[0, 0]], [[1, 4]], [0.3], [1.0], expected, np.zeros((1, 3, 2)), np.full((1, 3), 0.3)
    )
    np.testing.assert_array_equal(np.isnan(states[..., 6]), [[False, True, True]])
