"""Plane geometry for whole batches: unit vectors and how close moving discs come.

Every function takes arrays whose last axis is (x, y) and whose leading axes broadcast, and uses only
operations that give the same bits whatever the shape of the batch.
"""

import numpy as np


def length(vector: np.ndarray) -> np.ndarray:
    """Euclidean length over the last axis: (..., 2) -> (...)."""
    return np.sqrt(vector[..., 0] * vector[..., 0] + vector[..., 1] * vector[..., 1])


def direction(vector: np.ndarray) -> np.ndarray:
    """Unit vector along each vector, (..., 2) -> (..., 2); the zero vector stays zero."""
    norm = length(vector)
    return vector / np.where(norm > 0, norm, 1.0)[..., None]


def limit(vector: np.ndarray, longest: np.ndarray) -> np.ndarray:
    """Each vector, cut to `longest` where it is longer: (..., 2), (...) -> (..., 2)."""
    norm = length(vector)
    longer = norm > longest
    return vector * np.where(longer, longest / np.where(longer, norm, 1.0), 1.0)[..., None]


def closest_approach(offset: np.ndarray, relative_velocity: np.ndarray, duration: float) -> np.ndarray:
    """Smallest distance (m) between two points in straight motion during `duration` seconds.

    `offset` (..., 2) leads from one to the other at the start, `relative_velocity` (..., 2) is its rate of
    change in m/s; the result has their broadcast shape without the last axis.
    """
    px, py = offset[..., 0], offset[..., 1]
    vx, vy = relative_velocity[..., 0], relative_velocity[..., 1]
    speed2 = vx * vx + vy * vy
    when = -(px * vx + py * vy) / np.where(speed2 > 0, speed2, 1.0)
    when = np.minimum(np.maximum(when, 0.0), duration)
    x, y = px + when * vx, py + when * vy
    return np.sqrt(x * x + y * y)
