"""The Social Force Model: what pulls an agent to its goal and pushes it from everything else.

Equations 1-3 of Gil and Sanfeliu, after Helbing and Molnar (1995). Agents are points here: the distance in the
repulsion is from centre to centre, and `d` moves the exponential outwards. Not modelled: a field of view
(anisotropy), contact forces, and groups.
"""

import numpy as np

from sfmrl.config import SocialForce
from sfmrl.geometry import direction, length, limit


def goal_force(preferred_velocity: np.ndarray, velocity: np.ndarray, k: float) -> np.ndarray:
    """Attraction to the goal, equation 1: k (v0 - v), all (..., 2); velocities in m/s, k in 1/s."""
    return k * (preferred_velocity - velocity)


def repulsive_forces(offset: np.ndarray, force: SocialForce = SocialForce()) -> np.ndarray:
    """Repulsion of each element on an agent, equation 2: a exp((d - distance) / b) away from the element.

    `offset` (..., 2) leads from the element to the agent, in metres; the result has its shape. At zero distance
    there is no direction, and no force.
    """
    strength = force.a * np.exp((force.d - length(offset)) / force.b)
    return strength[..., None] * direction(offset)


def resultant(forces: np.ndarray) -> np.ndarray:
    """Sum of the elements' repulsions (..., K, 2) -> (..., 2); elements that are absent (NaN) push nobody.

    The paper's F in the robot's state: repulsive forces only, without the pull of the goal.
    """
    # Added one after another: a reduction's order of summation may depend on the shape of the batch.
    total = np.zeros((*forces.shape[:-2], 2), dtype=forces.dtype)
    for element in range(forces.shape[-2]):
        total += np.nan_to_num(forces[..., element, :])
    return total


def sfm_velocities(
    position: np.ndarray,
    velocity: np.ndarray,
    preferred_velocity: np.ndarray,
    max_speed: np.ndarray,
    *,
    force: SocialForce,
    time_step: float,
) -> np.ndarray:
    """Velocities after one time step under equation 3, cut to the speed limit: (E, N, 2).

    `position`, `velocity`, `preferred_velocity` (E, N, 2) in m and m/s, `max_speed` (E, N) in m/s. The force is an
    acceleration (unit mass), held for `time_step` seconds. Absent agents (NaN position) push nobody and come back NaN.
    """
    offset = position[:, :, None, :] - position[:, None, :, :]  # (E, N, N, 2), from the second to the first
    push = resultant(repulsive_forces(offset, force))
    acceleration = goal_force(preferred_velocity, velocity, force.k) + push
    moved = limit(velocity + time_step * acceleration, max_speed)
    return np.where(np.isnan(position), np.nan, moved)
