"""Plane geometry against closed forms and brute force."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfmrl.geometry import closest_approach, direction, length, limit, square_gap

coordinate = st.floats(-20, 20, allow_nan=False)
vector = st.tuples(coordinate, coordinate).map(np.array)


def test_length_of_known_vectors_with_any_leading_axes():
    vectors = np.array([[[3.0, 4.0], [0.0, 0.0]], [[-5.0, 12.0], [0.0, -2.0]]])
    np.testing.assert_array_equal(length(vectors), [[5.0, 0.0], [13.0, 2.0]])


def test_direction_has_length_one_and_the_zero_vector_stays_zero():
    vectors = np.array([[3.0, 4.0], [0.0, 0.0], [-1e-9, 0.0]])
    np.testing.assert_allclose(direction(vectors), [[0.6, 0.8], [0.0, 0.0], [-1.0, 0.0]], rtol=1e-15)


@given(vector, st.floats(0, 30))
def test_limit_shortens_only_what_is_longer_and_never_turns(v, longest):
    cut = limit(v, np.array(longest))
    assert length(cut) <= longest * (1 + 1e-12)
    if length(v) <= longest:
        np.testing.assert_array_equal(cut, v)
    else:
        assert length(cut) == pytest.approx(longest, rel=1e-12)
        np.testing.assert_allclose(cut * length(v), v * longest, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("offset", "velocity", "expected"),
    [
        ((4, 3), (0, 0), 5.0),  # at rest
        ((4, 3), (4, 3), 5.0),  # moving apart: closest at the start
        ((10, 0), (-4, 0), 8.0),  # still approaching when time is up
        ((1, 1), (-4, 0), 1.0),  # passes by in between
        ((1, 0), (-4, 0), 0.0),  # goes right through
    ],
)
def test_closest_approach_closed_forms(offset, velocity, expected):
    assert closest_approach(np.array(offset, float), np.array(velocity, float), 0.5) == pytest.approx(expected)


def test_closest_approach_broadcasts_and_hands_nan_on():
    offset = np.array([[1.0, 1.0], [np.nan, np.nan]])
    velocity = np.array([[[-4.0, 0.0]], [[0.0, 0.0]]])  # (2, 1, 2)
    found = closest_approach(offset, velocity, 1.0)
    assert found.shape == (2, 2)
    np.testing.assert_allclose(found[:, 0], [1.0, np.sqrt(2)])
    assert np.isnan(found[:, 1]).all()


@given(vector, vector, st.floats(0, 2 * np.pi), st.floats(0.01, 5))
def test_closest_approach_does_not_depend_on_the_frame(offset, velocity, angle, duration):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    straight = closest_approach(offset, velocity, duration)
    assert closest_approach(turn @ offset, turn @ velocity, duration) == pytest.approx(straight, abs=1e-9)
    assert closest_approach(-offset, -velocity, duration) == straight


def test_one_row_of_a_batch_has_the_bits_it_has_alone():
    rng = np.random.default_rng(0)
    offset, velocity = rng.normal(size=(1000, 7, 2)), rng.normal(size=(1000, 7, 2))
    together = closest_approach(offset, velocity, 0.25)
    alone = np.stack([closest_approach(o, v, 0.25) for o, v in zip(offset, velocity, strict=True)])
    np.testing.assert_array_equal(together, alone)


@given(vector, st.floats(0.1, 5))
def test_the_gap_to_a_square_is_the_distance_to_the_nearest_of_many_points_on_its_outline(offset, half):
    gap, away = square_gap(offset, np.array(half))
    share = np.linspace(-half, half, 2001)
    side = np.full_like(share, half)
    outline = np.concatenate([np.stack(p, -1) for p in ((share, side), (share, -side), (side, share), (-side, share))])
    nearest = np.hypot(*(offset - outline).T).min()
    assert abs(gap) == pytest.approx(nearest, abs=half / 500)
    assert (gap <= 0) == (np.abs(offset) <= half).all()
    np.testing.assert_allclose(length(away), 1.0)
    # A step straight away from the outline makes the gap longer by as much.
    assert square_gap(offset + 0.01 * away, np.array(half))[0] == pytest.approx(gap + 0.01)


@given(vector, vector, st.floats(0, 5), st.just(0.0) | st.floats(0, 8))
def test_closest_approach_is_the_smallest_distance_over_dense_time(offset, velocity, duration, half):
    times = np.linspace(0.0, duration, 2001)
    dense = length(np.maximum(np.abs(offset + times[:, None] * velocity) - half, 0.0)).min()
    found = closest_approach(offset, velocity, duration, half)
    # Between two samples the distance falls by at most speed times half their spacing.
    slack = length(velocity) * duration / 4000
    assert dense - slack - 1e-9 <= found <= dense + 1e-9
