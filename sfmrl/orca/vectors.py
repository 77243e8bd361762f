"""Vectors of float32 with their components first, (2, ...), so that each operation runs through one long row.

Nothing is summed over another axis: results have the same bits whatever the shape of the batch. (In `geometry.py`, the
components are float64 and come last; nothing of it is used here, as this folder imports NumPy alone.)
"""

import numpy as np

INFINITY = np.float32(np.inf)


def numbers(name, value, shape=None):
    """Return `value` as float64, broadcast to `shape` if given; raises ValueError, with its `name`, where it cannot."""
    try:
        value = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number or an array of numbers") from None
    try:
        return value if shape in (None, value.shape) else np.broadcast_to(value, shape)
    except ValueError:
        raise ValueError(f"{name} must broadcast to shape {shape}, not have shape {value.shape}") from None


def dot(a, b):
    """Scalar product of vectors (2, ...)."""
    product = a * b
    product[0] += product[1]
    return product[0]


def det(a, b):
    """Two-dimensional cross product of vectors (2, ...): > 0 if b points to the left of a."""
    product = a * b[::-1]
    product[0] -= product[1]
    return product[0]


def turn_left(vector):
    """Vectors (2, ...) turned by 90 degrees counter-clockwise."""
    turned = vector[::-1].copy()
    np.negative(turned[0], out=turned[0])
    return turned


def unit(vector):
    """Vectors (2, ...) scaled to length 1."""
    return vector * (1 / np.sqrt(dot(vector, vector)))


def choose(mask, yes, no):
    """np.where for float32, but without a branch for each element: ten times as fast where masks are irregular."""
    no = no.view(np.int32)
    chosen = yes.view(np.int32) ^ no
    chosen &= -mask.astype(np.int32)  # all bits set where it holds
    chosen ^= no
    return chosen.view(np.float32)


def order_key(squared, tie):
    """Integers that order positive float32 values (...), and equal ones by their `tie`, integers below 2 ** 16."""
    return squared.view(np.int32).astype(np.int64) << 16 | tie  # bits of positive floats are ordered as the floats are


def limit_speed(velocity, max_speed):
    """Shorten velocities (2, Q) that are faster than max_speed (Q,) to it."""
    return choose(dot(velocity, velocity) > max_speed * max_speed, unit(velocity) * max_speed, velocity)
