"""Vectors of float32 with x and y first, (2, ...), so that each operation runs through one long row.

`geometry.py` has x and y last, in float64. Here too nothing is summed over another axis: results have the same bits
whatever the shape of the batch.
"""

import numpy as np

INFINITY = np.float32(np.inf)


def dot(a, b):
    """Scalar product."""
    product = a * b
    product[0] += product[1]
    return product[0]


def det(a, b):
    """Two-dimensional cross product, above 0 where b is to the left of a."""
    product = a * b[::-1]
    product[0] -= product[1]
    return product[0]


def unit(vector):
    """Vectors scaled to length 1."""
    return vector * (1 / np.sqrt(dot(vector, vector)))


def turn_left(vector):
    """Vectors turned by 90 degrees counter-clockwise."""
    turned = vector[::-1].copy()
    np.negative(turned[0], out=turned[0])
    return turned


def limit_speed(velocity, max_speed):
    """The velocities (2, Q) with those faster than max_speed (Q,) shortened to it."""
    return np.where(dot(velocity, velocity) > max_speed * max_speed, unit(velocity) * max_speed, velocity)
