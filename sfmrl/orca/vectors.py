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


def choose(mask, yes, no):
    """Return float32 `yes` where the mask has all `bits` and `no` where it has none, much faster than np.where."""
    no = no.view(np.int32)
    chosen = np.bitwise_xor(yes.view(np.int32), no)
    chosen = np.bitwise_and(chosen, mask, out=chosen if chosen.ndim >= mask.ndim else None)
    chosen ^= no
    return chosen.view(np.float32)


def bits(condition):
    """Return int32 with all bits set where the condition holds, and none elsewhere."""
    mask = condition.astype(np.int32)
    return np.negative(mask, out=mask)


def put(vectors, where, values):
    """Write vectors (2, K) to the places `where` (K,) of vectors (2, Q), faster than by `vectors[:, where]`."""
    x, y = vectors
    x[where], y[where] = values


def limit_speed(velocity, max_speed):
    """Return the velocities (2, Q) with those faster than max_speed (Q,) shortened to it."""
    squared = dot(velocity, velocity)
    return choose(bits(squared > max_speed * max_speed), velocity * (1 / np.sqrt(squared)) * max_speed, velocity)
