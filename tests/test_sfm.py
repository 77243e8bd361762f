"""The Social Force Model: equations 1 to 3 by hand, and what the model must do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfmrl.geometry import length
from sfmrl.sfm import CROWD_FORCE, SocialForce, goal_force, repulsive_forces, resultant, sfm_velocities

coordinate = st.floats(-6, 6, allow_nan=False)


def test_equation_1_by_hand():
    force = goal_force(np.array([1.0, 0.0]), np.array([0.25, -0.5]), k=2.0)
    np.testing.assert_array_equal(force, [1.5, 1.0])


@pytest.mark.parametrize(
    ("offset", "force", "expected"),
    [
        ((3.0, 4.0), SocialForce(), (0.6 * np.exp(-5), 0.8 * np.exp(-5))),  # the paper's a = 1, b = 1, d = 0
        ((0.0, -2.0), SocialForce(a=3.0, b=0.5, d=1.0), (0.0, -3.0 * np.exp(-2.0))),
        ((-0.6, 0.0), SocialForce(a=7.0, b=0.3, d=0.6), (-7.0, 0.0)),  # at distance d the force is a
        ((0.0, 0.0), SocialForce(), (0.0, 0.0)),  # no direction, and no force
    ],
)
def test_equation_2_by_hand(offset, force, expected):
    np.testing.assert_allclose(repulsive_forces(np.array(offset), force), expected, rtol=1e-12, atol=1e-15)


@given(coordinate, coordinate, st.floats(0.01, 10), st.floats(0.1, 3), st.floats(-1, 1))
def test_the_repulsion_points_away_with_the_exponential_s_strength(x, y, a, b, d):
    offset = np.array([x, y])
    distance = float(np.hypot(x, y))
    force = repulsive_forces(offset, SocialForce(a=a, b=b, d=d))
    if distance > 1e-6:
        assert length(force) == pytest.approx(a * np.exp((d - distance) / b), rel=1e-9, abs=1e-100)
        assert offset @ force >= 0
        assert abs(x * force[1] - y * force[0]) <= 1e-9 * length(force) * distance


def test_the_resultant_is_the_sum_and_skips_who_is_absent():
    forces = np.random.default_rng(0).normal(size=(5, 3, 4, 2))
    np.testing.assert_allclose(resultant(forces), forces.sum(-2), rtol=1e-12, atol=1e-14)
    forces[:, :, 2] = np.nan
    np.testing.assert_allclose(resultant(forces), forces[:, :, [0, 1, 3]].sum(-2), rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(resultant(np.empty((3, 0, 2))), np.zeros((3, 2)))


def test_lists_and_whole_numbers_do_and_wrong_shapes_are_named():
    np.testing.assert_array_equal(repulsive_forces([[3, 4]]), repulsive_forces(np.array([[3.0, 4.0]])))
    np.testing.assert_array_equal(resultant([[[1, 2], [3, 4]]]), [[4.0, 6.0]])
    np.testing.assert_array_equal(goal_force([1, 0], [0, 1], 2), [2.0, -2.0])
    still = [[[0, 0], [2, 0]]]
    moved = sfm_velocities(still, still, still, 1, force=SocialForce(), time_step=0.25)
    np.testing.assert_allclose(moved[0, 0], [-0.25 * np.exp(-2), 0], rtol=1e-12)
    for call, message in (
        (lambda: repulsive_forces([1.0, 2.0, 3.0]), r"offset must have shape \(\.\.\., 2\), not \(3,\)"),
        (lambda: repulsive_forces("near"), "offset must be a number"),
        (lambda: resultant([1.0, 2.0]), r"forces must have shape \(\.\.\., K, 2\), not \(2,\)"),
        (lambda: sfm_velocities([[0, 0]], 0, 0, 1, force=CROWD_FORCE, time_step=1), "position must have shape"),
        (lambda: sfm_velocities(still, [1, 2, 3], 0, 1, force=CROWD_FORCE, time_step=1), "velocity must broadcast"),
        (lambda: sfm_velocities(still, 0, 0, [1] * 3, force=CROWD_FORCE, time_step=1), "max_speed must broadcast"),
        (lambda: sfm_velocities(still, 0, 0, -1, force=CROWD_FORCE, time_step=1), "max_speed must be at least 0"),
        (lambda: sfm_velocities(still, 0, 0, 1, force=CROWD_FORCE, time_step=-1), "time_step must be finite and not"),
        (
            lambda: sfm_velocities(still, 0, 0, 1, force=CROWD_FORCE, time_step=1, radius=[0, np.nan]),
            "radius must be finite",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_equation_3_by_hand_for_two_agents():
    force = SocialForce(a=2.0, b=1.0, d=0.0, k=2.0)
    position = np.array([[[0.0, 0.0], [2.0, 0.0]]])
    velocity = np.array([[[0.5, 0.0], [0.0, 0.0]]])
    preferred = np.array([[[1.0, 0.0], [0.0, 1.0]]])
    found = sfm_velocities(position, velocity, preferred, np.full((1, 2), 5.0), force=force, time_step=0.25)
    push = 2 * np.exp(-2)
    expected = [[0.5 + 0.25 * (2 * 0.5 - push), 0.0], [0.25 * push, 0.25 * 2 * 1.0]]
    np.testing.assert_allclose(found[0], expected, rtol=1e-12)


def test_a_lone_agent_relaxes_to_its_preferred_velocity():
    position, preferred = np.zeros((1, 1, 2)), np.array([[[0.6, 0.8]]])
    velocity = np.zeros((1, 1, 2))
    for step in range(1, 40):
        velocity = sfm_velocities(
            position, velocity, preferred, np.ones((1, 1)), force=SocialForce(k=2.0), time_step=0.25
        )
        # Each step of 0.25 s at 2/s halves what is missing.
        np.testing.assert_allclose(velocity, preferred * (1 - 0.5**step), rtol=1e-9)


@given(st.integers(0, 10_000))
def test_nobody_exceeds_the_speed_limit(seed):
    rng = np.random.default_rng(seed)
    position, velocity, preferred = rng.normal(size=(3, 4, 6, 2))
    most = rng.uniform(0, 2, size=(4, 6))
    moved = sfm_velocities(position, velocity, preferred, most, force=CROWD_FORCE, time_step=0.25, radius=0.3)
    assert (length(moved) <= most * (1 + 1e-12)).all()


def test_absent_agents_push_nobody_and_come_back_as_nan():
    rng = np.random.default_rng(1)
    position, velocity, preferred = rng.normal(size=(3, 2, 5, 2))
    gone = position.copy()
    gone[:, 3] = np.nan
    settings = {"force": CROWD_FORCE, "time_step": 0.25, "radius": 0.3}
    found = sfm_velocities(gone, velocity, preferred, np.ones((2, 5)), **settings)
    here = [0, 1, 2, 4]
    without = sfm_velocities(position[:, here], velocity[:, here], preferred[:, here], np.ones((2, 4)), **settings)
    np.testing.assert_array_equal(found[:, here], without)
    assert np.isnan(found[:, 3]).all()


def test_mirrored_worlds_move_mirrored():
    rng = np.random.default_rng(2)
    position, velocity, preferred = rng.normal(size=(3, 1, 6, 2))
    flip = np.array([-1.0, 1.0])
    settings = {"force": CROWD_FORCE, "time_step": 0.25, "radius": 0.3}
    found = sfm_velocities(position, velocity, preferred, np.ones((1, 6)), **settings)
    mirrored = sfm_velocities(position * flip, velocity * flip, preferred * flip, np.ones((1, 6)), **settings)
    np.testing.assert_allclose(mirrored, found * flip, rtol=1e-12, atol=1e-15)


def walk(start, goal, radius, square=False, seconds=15.0) -> np.ndarray:
    """Positions (T, N, 2) of agents who walk from `start` to `goal`, at most 1 m/s fast."""
    positions, velocity = [np.array([start], dtype=float)], np.zeros((1, len(start), 2))
    for _ in range(int(seconds / 0.25)):
        way = np.array([goal]) - positions[-1]
        preferred = way / np.maximum(length(way), 1.0)[..., None]
        settings = {"force": CROWD_FORCE, "time_step": 0.25, "radius": radius, "square": square}
        velocity = sfm_velocities(positions[-1], velocity, preferred, 1.0, **settings)
        positions.append(positions[-1] + 0.25 * velocity)
    return np.concatenate(positions)


@pytest.mark.parametrize("radius", [0.3, 0.5, 0.8])
def test_two_agents_of_any_size_almost_head_on_pass_without_touching(radius):
    goal = [(4.0, 0.05), (-4.0, -0.05)]  # each straight ahead, 10 cm beside the other
    path = walk([(-4.0, 0.05), (4.0, -0.05)], goal, radius)
    assert length(path[:, 0] - path[:, 1]).min() > 2 * radius
    assert (length(path[-1] - goal) < 0.3).all()


@pytest.mark.parametrize("half", [0.3, 1.0, 2.0])
def test_nobody_walks_through_a_square_of_any_size(half):
    path = walk([(0.1, -5.0), (0.0, 0.0)], [(0.1, 5.0), (0.0, 0.0)], [0.3, half], [False, True], seconds=20)
    assert (np.abs(path[:, 0]).max(-1) - half).min() > 0.2
    assert (path[:, 1] == 0).all()


def test_forces_are_from_surface_to_surface_by_hand():
    force, still = SocialForce(a=2.0, b=0.5, k=0.0), np.zeros((1, 3, 2))
    # One of radius 0.3 at (0, 0), one of 0.7 whose surface is 0.5 m off, a square of side 4 whose corner is 5 m off.
    position = np.array([[(0.0, 0.0), (-1.5, 0.0), (6.0, 5.0)]])
    settings = {"force": force, "time_step": 0.25, "radius": [0.3, 0.7, 2.0], "square": [False, False, True]}
    found = sfm_velocities(position, still, still, 9.0, **settings)[0, 0]
    disc, corner = 2 * np.exp(-0.5 / 0.5), 2 * np.exp(-(5 - 0.3) / 0.5)
    np.testing.assert_allclose(found, 0.25 * np.array([disc - 0.8 * corner, -0.6 * corner]), rtol=1e-12)
    # Within the square, 0.5 m from its right side, the way out leads through that.
    position[0, :2] = (7.5, 5.3), (-99.0, 0.0)
    found = sfm_velocities(position, still, still, 99.0, **settings)[0, 0]
    np.testing.assert_allclose(found, [0.25 * 2 * np.exp((0.3 + 0.5) / 0.5), 0], rtol=1e-12, atol=1e-12)
