"""The Social Force Model: what pulls an agent to its goal and pushes it from everything else.

Equations 1-3 of Gil and Sanfeliu, after Helbing and Molnar (1995). In the paper, which describes a robot's
surroundings, distances are from centre to centre. Agents who move by the model have sizes, as in Helbing and Molnar:
they repel each other from surface to surface, and squares repel them from their outline. Not modelled: a field of view
(anisotropy), contact forces, and groups.
"""

import numpy as np
from numpy.typing import ArrayLike

from sfmrl.config import SocialForce
from sfmrl.geometry import broadcast, direction, length, limit, square_gap, vectors


def goal_force(preferred_velocity: ArrayLike, velocity: ArrayLike, k: float) -> np.ndarray:
    """Attraction to the goal, equation 1: k (v0 - v), all (..., 2); velocities in m/s, k in 1/s."""
    return k * (vectors("preferred_velocity", preferred_velocity) - vectors("velocity", velocity))


def repulsive_forces(offset: ArrayLike, force: SocialForce = SocialForce()) -> np.ndarray:
    """Repulsion of each element on an agent, equation 2: a exp((d - distance) / b) away from the element.

    `offset` (..., 2) leads from the element to the agent, in metres; the result has its shape. At zero distance
    there is no direction, and no force. Raises ValueError for other shapes.
    """
    offset = vectors("offset", offset)
    return _repulsion(force.d - length(offset), force)[..., None] * direction(offset)


def _repulsion(overlap: np.ndarray, force: SocialForce) -> np.ndarray:
    """Strength of the repulsion in m/s^2 where two surfaces overlap by `overlap` m (negative: are that far apart)."""
    return force.a * np.exp(overlap / force.b)


def resultant(forces: ArrayLike) -> np.ndarray:
    """Sum of the elements' repulsions (..., K, 2) -> (..., 2); elements that are absent (NaN) push nobody.

    The paper's F in the robot's state: repulsive forces only, without the pull of the goal. Raises ValueError for
    other shapes.
    """
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
    """Velocities after one time step under equation 3, cut to the speed limit: (E, N, 2) in m/s.

    `position`, `velocity`, `preferred_velocity` (E, N, 2) in m and m/s; `max_speed` in m/s, `radius` in m and `square`
    broadcast to (E, N). The distances in equation 2 are from surface to surface: between discs of `radius`, or from
    the outline of rows that are a `square` of side 2 radius. The force is an acceleration (unit mass), held for
    `time_step` seconds. Squares rest; absent agents (NaN position) push nobody and come back NaN. Raises ValueError for
    other shapes.
    """
    position = vectors("position", position)
    if position.ndim != 3:
        raise ValueError(f"position must have shape (E, N, 2), not {position.shape}")
    shape = position.shape[:2]
    velocity = broadcast("velocity", velocity, position.shape)
    preferred_velocity = broadcast("preferred_velocity", preferred_velocity, position.shape)
    max_speed, radius = broadcast("max_speed", max_speed, shape), broadcast("radius", radius, shape)
    square = broadcast("square", square, shape) != 0

    offset = position[:, :, None, :] - position[:, None, :, :]  # (E, N, N, 2), from the second to the first
    overlap = force.d + (radius[:, :, None] + radius[:, None]) - length(offset)
    away = direction(offset)
    if square.any():
        gap, out = square_gap(offset, radius[:, None])
        overlap = np.where(square[:, None], force.d + radius[:, :, None] - gap, overlap)
        away = np.where(square[:, None, :, None], out, away)
    push = resultant(_repulsion(overlap, force)[..., None] * away)
    moved = limit(velocity + time_step * (goal_force(preferred_velocity, velocity, force.k) + push), max_speed)
    moved[square] = 0.0
    return np.where(np.isnan(position), np.nan, moved)
