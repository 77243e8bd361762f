"""The Social Force Model: equations 1 to 3 by hand, and what the model must do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfmrl.config import CROWD_FORCE, SocialForce
from sfmrl.geometry import length
from sfmrl.sfm import goal_force, repulsive_forces, resultant, sfm_velocities

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
    ],
)
def test_equation_2_by_hand(offset, force, expected):
    np.testing.assert_allclose(repulsive_forces(np.array(offset), force), expected, rtol=1e-12, atol=1e-15)


def test_the_paper_s_parameters_are_the_defaults():
    assert (SocialForce().a, SocialForce().b, SocialForce().d) == (1.0, 1.0, 0.0)


def test_at_zero_distance_there_is_no_direction_and_no_force():
    np.testing.assert_array_equal(repulsive_forces(np.zeros((2, 2))), np.zeros((2, 2)))


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
    moved = sfm_velocities(position, velocity, preferred, most, force=CROWD_FORCE, time_step=0.25)
    assert (length(moved) <= most * (1 + 1e-12)).all()


def test_absent_agents_push_nobody_and_come_back_as_nan():
    rng = np.random.default_rng(1)
    position, velocity, preferred = rng.normal(size=(3, 2, 5, 2))
    gone = position.copy()
    gone[:, 3] = np.nan
    settings = {"force": CROWD_FORCE, "time_step": 0.25}
    found = sfm_velocities(gone, velocity, preferred, np.ones((2, 5)), **settings)
    here = [0, 1, 2, 4]
    without = sfm_velocities(position[:, here], velocity[:, here], preferred[:, here], np.ones((2, 4)), **settings)
    np.testing.assert_array_equal(found[:, here], without)
    assert np.isnan(found[:, 3]).all()


def test_mirrored_worlds_move_mirrored():
    rng = np.random.default_rng(2)
    position, velocity, preferred = rng.normal(size=(3, 1, 6, 2))
    flip = np.array([-1.0, 1.0])
    settings = {"force": CROWD_FORCE, "time_step": 0.25}
    found = sfm_velocities(position, velocity, preferred, np.ones((1, 6)), **settings)
    mirrored = sfm_velocities(position * flip, velocity * flip, preferred * flip, np.ones((1, 6)), **settings)
    np.testing.assert_allclose(mirrored, found * flip, rtol=1e-12, atol=1e-15)


def test_two_agents_almost_head_on_pass_without_touching():
    position = np.array([[[-4.0, 0.05], [4.0, -0.05]]])
    goal = position * [-1.0, 1.0]  # each straight ahead, 10 cm beside the other
    velocity = np.zeros_like(position)
    nearest = np.inf
    for _ in range(60):
        way = goal - position
        preferred = way / np.maximum(length(way), 1.0)[..., None]
        velocity = sfm_velocities(position, velocity, preferred, np.ones((1, 2)), force=CROWD_FORCE, time_step=0.25)
        position = position + 0.25 * velocity
        nearest = min(nearest, length(position[0, 0] - position[0, 1]))
    assert nearest > 0.6  # two discs of 0.3 m
    assert (length(goal - position) < 0.3).all()
