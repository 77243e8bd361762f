"""Vectors of float32, component by component: (2, ...), so that each operation runs through one long row.

`geometry.py` has its vectors' components last, in float64. Nothing is summed up over another axis here either: results
have the same bits whatever the shape of the batch.
"""

import numpy as np

INFINITY = np.float32(np.inf)


def dot(a, b):
    """Scalar product of vectors (2, ...)."""
    product = a * b
    product[0] += product[1]
    return product[0]


def det(a, b):
    """Two-dimensional cross product of vectors (2, ...)."""
    product = a * b[::-1]
    product[0] -= product[1]
    return product[0]


def turn_left(vector):
    """Vectors (2, ...) turned by 90 degrees counter-clockwise."""
    turned = vector[::-1].copy()
    np.negative(turned[0], out=turned[0])
    return turned


def turn_right(vector):
    """Vectors (2, ...) turned by 90 degrees clockwise."""
    turned = vector[::-1].copy()
    np.negative(turned[1], out=turned[1])
    return turned


def limit_speed(velocity, max_speed):
    """Return the velocities (2, Q) with those faster than max_speed (Q,) shortened to it."""
    squared = dot(velocity, velocity)
    return np.where(squared > max_speed * max_speed, velocity * (1 / np.sqrt(squared)) * max_speed, velocity)
