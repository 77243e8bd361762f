"""Plane geometry for whole batches: lengths and directions of vectors, gaps to discs and squares.

The last axis of every array is (x, y); the leading axes broadcast. All operations give the same bits whatever the shape
of the batch.
"""

import numpy as np
from numpy.typing import ArrayLike


def numbers(name: str, value: ArrayLike) -> np.ndarray:
    """`value` as an array of floats; raises ValueError, with the argument's `name`, if that is impossible."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number or an array of numbers") from None


def vectors(name: str, value: ArrayLike) -> np.ndarray:
    """`value` as an array of floats (..., 2); raises ValueError, with the argument's `name`, for other shapes."""
    value = numbers(name, value)
    if value.shape[-1:] != (2,):
        raise ValueError(f"{name} must have shape (..., 2), not {value.shape}")
    return value


def broadcast(name: str, value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """`value` as floats, broadcast to a `shape`; raises ValueError, with the argument's `name`, if it does not."""
    value = numbers(name, value)
    try:
        return value if value.shape == shape else np.broadcast_to(value, shape)
    except ValueError:
        raise ValueError(f"{name} must broadcast to shape {shape}, not have shape {value.shape}") from None


def length(vector: np.ndarray) -> np.ndarray:
    """Euclidean length, (..., 2) -> (...)."""
    return np.sqrt(vector[..., 0] * vector[..., 0] + vector[..., 1] * vector[..., 1])


def direction(vector: np.ndarray) -> np.ndarray:
    """Unit vector along each vector, (..., 2) -> (..., 2); the zero vector stays zero."""
    norm = length(vector)
    return vector / np.where(norm > 0, norm, 1.0)[..., None]


def limit(vector: np.ndarray, longest: np.ndarray | float) -> np.ndarray:
    """Each vector, shortened to `longest` if it is longer: (..., 2), (...) -> (..., 2)."""
    norm = length(vector)
    longer = norm > longest
    return vector * np.where(longer, longest / np.where(longer, norm, 1.0), 1.0)[..., None]


def unit_at(angle: np.ndarray) -> np.ndarray:
    """Unit vector (..., 2) at an angle in rad (...)."""
    return np.stack((np.cos(angle), np.sin(angle)), axis=-1)


def wrapped(angle: np.ndarray) -> np.ndarray:
    """The same angle in rad (...) from -pi to pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def square_gap(offset: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the outline of an axis-aligned square, m (...), and the unit vector straight away from it (..., 2).

    `offset` (..., 2) m leads from the square's centre, `half` (...) m is half its side. Inside, distances are negative.
    """
    beyond = np.abs(offset) - half[..., None]  # m beyond the sides, as if the point were in the first quadrant
    x, y = beyond[..., 0], beyond[..., 1]
    farther, outside = np.maximum(x, y), np.maximum(beyond, 0.0)
    inside = farther <= 0
    by_nearest_side = np.stack((x >= y, x < y), axis=-1)  # the way out
    away = np.copysign(np.where(inside[..., None], by_nearest_side, outside), offset)  # in the point's own quadrant
    return np.where(inside, farther, length(outside)), direction(away)


def closest_approach(
    offset: np.ndarray, relative_velocity: np.ndarray, duration: float, half: np.ndarray | float = 0.0
) -> np.ndarray:
    """Smallest distance, m (...), between a point and an axis-aligned square in straight motion for `duration` s.

    `offset` (..., 2) m leads from one's centre to the other's at the start, `relative_velocity` (..., 2) m/s is its
    rate of change, `half` (...) m is half the square's side: 0 for a point.
    """
    px, py = offset[..., 0], offset[..., 1]
    vx, vy = relative_velocity[..., 0], relative_velocity[..., 1]
    # side * (vy, -vx) points from the square's centre straight to the line of motion. A line that misses the square is
    # nearest to it at the corner farthest in that direction; a line that crosses it is inside it when it passes that
    # corner. The distance is convex in time, so that moment can be clipped to the duration.
    side = np.sign(px * vy - py * vx)
    corner_x, corner_y = half * np.sign(side * vy), half * np.sign(side * -vx)
    speed2 = vx * vx + vy * vy
    when = -((px - corner_x) * vx + (py - corner_y) * vy) / np.where(speed2 > 0, speed2, 1.0)
    when = np.minimum(np.maximum(when, 0.0), duration)
    x, y = np.maximum(np.abs(px + when * vx) - half, 0.0), np.maximum(np.abs(py + when * vy) - half, 0.0)
    return np.sqrt(x * x + y * y)
