"""The Social Force Model: the goal attracts an agent, everything else repels it.

Equations 1-3 of Gil and Sanfeliu, after Helbing and Molnar (1995). In the robot's state, distances are from centre to
centre, which is our reading of the paper; agents that move by the model repel each other from surface to surface, and
squares repel them from their outline, as borders do in Helbing and Molnar. Left out: a field of view (anisotropy),
contact forces, and groups.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sfmrl.config import Settings, knob
from sfmrl.geometry import broadcast, direction, length, limit, square_gap, vectors


@dataclass(frozen=True)
class SocialForce(Settings):
    """Parameters of equations 1 and 2; a, b and d are by default the paper's, for the robot's state."""

    a: float = knob(1.0, "strength of the repulsion, m/s^2 (paper: a_z = 1)", 0, 1000)
    b: float = knob(1.0, "range of the repulsion, m (paper: b_z = 1)", 0.01, 1000)
    d: float = knob(0.0, "distance at which the repulsion is a, m (paper: d_z = 0)", -3, 3)
    k: float = knob(2.0, "rate at which the goal force corrects the velocity, 1/s", 0, 1000)


# Helbing and Molnar's 2.1 m^2/s^2 over 0.3 m, from surface to surface, and their relaxation time of 0.5 s, for
# `--crowd sfm`. With the paper's (1, 1, 0), from centre to centre, people would walk through each other.
CROWD_FORCE = SocialForce(a=7.0, b=0.3, d=0.0, k=2.0)


def goal_force(preferred_velocity: ArrayLike, velocity: ArrayLike, k: float) -> np.ndarray:
    """Attraction to the goal, equation 1: k (v0 - v), all (..., 2); velocities in m/s, k in 1/s."""
    return k * (vectors("preferred_velocity", preferred_velocity) - vectors("velocity", velocity))


def repulsive_forces(offset: ArrayLike, force: SocialForce = SocialForce()) -> np.ndarray:
    """Repulsion of each element on an agent, equation 2: a exp((d - distance) / b) away from the element.

    `offset` (..., 2) m leads from the element to the agent; the result has its shape. At zero distance the force is 0.
    """
    offset = vectors("offset", offset)
    strength = force.a * np.exp((force.d - length(offset)) / force.b)
    return strength[..., None] * direction(offset)


def resultant(forces: ArrayLike) -> np.ndarray:
    """Sum of repulsions (..., K, 2) -> (..., 2), the paper's F in the robot's state; absent elements (NaN) add 0."""
    forces = vectors("forces", forces)
    if forces.ndim < 2:
        raise ValueError(f"forces must have shape (..., K, 2), not {forces.shape}")
    # Added one after another: a reduction's order of summation may depend on the shape of the batch.
    total = np.zeros((*forces.shape[:-2], 2))
    for element in range(forces.shape[-2]):
        total += np.nan_to_num(forces[..., element, :])
    return total


def sfm_velocities(
    position: ArrayLike,
    velocity: ArrayLike,
    preferred_velocity: ArrayLike,
    max_speed: ArrayLike,
    *,
    force: SocialForce,
    time_step: float,
    radius: ArrayLike = 0.0,
    square: ArrayLike = False,
) -> np.ndarray:
    """Velocities after one time step under equation 3, cut to `max_speed`: (E, N, 2) in m/s.

    `position`, `velocity`, `preferred_velocity` (E, N, 2) in m and m/s; `max_speed` in m/s, `radius` in m and `square`
    broadcast to (E, N). Distances are between the surfaces of discs of `radius` and of squares of side 2 `radius`. The
    force is an acceleration (unit mass), constant for `time_step` s. Squares rest; absent agents (NaN position) exert
    no force and return NaN. Raises ValueError for other shapes, for a negative or NaN `max_speed` (infinity is no
    limit), and for a `radius` or `time_step` that is negative or not finite.
    """
    position = vectors("position", position)
    if position.ndim != 3:
        raise ValueError(f"position must have shape (E, N, 2), not {position.shape}")
    shape = position.shape[:2]
    velocity = broadcast("velocity", velocity, position.shape)
    preferred_velocity = broadcast("preferred_velocity", preferred_velocity, position.shape)
    max_speed, radius = broadcast("max_speed", max_speed, shape), broadcast("radius", radius, shape)
    present = ~np.isnan(position).any(-1)
    if not (max_speed[present] >= 0).all():
        raise ValueError("max_speed must be at least 0, and not NaN")
    for name, values in {"radius": radius[present], "time_step": time_step}.items():
        if not (np.isfinite(values) & np.greater_equal(values, 0)).all():
            raise ValueError(f"{name} must be finite and not below 0")
    squares: np.ndarray = broadcast("square", square, shape) != 0
    offset = position[:, :, None, :] - position[:, None, :, :]  # (E, N, N, 2), from the second to the first
    overlap = force.d + (radius[:, :, None] + radius[:, None]) - length(offset)
    away = direction(offset)
    if squares.any():
        gap, out = square_gap(offset, radius[:, None])
        overlap = np.where(squares[:, None], force.d + radius[:, :, None] - gap, overlap)
        away = np.where(squares[:, None, :, None], out, away)
    push = resultant((force.a * np.exp(overlap / force.b))[..., None] * away)
    pull = goal_force(preferred_velocity, velocity, force.k)
    moved = limit(velocity + time_step * (pull + push), max_speed)
    moved[squares] = 0.0
    return np.where(np.isnan(position), np.nan, moved)
