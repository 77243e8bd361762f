"""ORCA half-planes between pairs of agents; each agent takes half of the avoidance.

The relative velocities at which two agents collide within the time horizon fill a cone, cut off by a disc: the velocity
obstacle. The pair needs the smallest change of its relative velocity that leads out of it, and each makes half of that.

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, section 4.
"""

from functools import cache

import numpy as np

from sfmrl.orca.vectors import det, dot, turn_left

HALF = np.float32(0.5)
TINY = np.float32(1e-30)
couples_among = cache(np.triu_indices)  # too slow for every step of a single episode


def agent_half_planes(agent, other, time_step, neighbor_distance, time_horizon):
    """Return the half-planes (4, M, C, E) of agents (8, C, E) against others (5, M, C, E); zeros beyond the distance.

    Both hold position, velocity, radius and so on, in float32, m and m/s, NaN where absent.
    """
    change, direction = _half_changes(agent[:, None], other, time_step, neighbor_distance, time_horizon)
    change += agent[2:4, None]
    return np.concatenate([change, direction])


def mutual_half_planes(agents, time_step, neighbor_distance, time_horizon):
    """Return the half-planes (4, C - 1, C, E) of all agents (8, C, E) against each other.

    The same bits as `agent_half_planes` for half the work: one agent's change is the other's, reversed.
    """
    count, episodes = agents.shape[1:]
    one, other = couples_among(count, 1)
    first, second = agents[:5].take(one, axis=1), agents[:5].take(other, axis=1)
    change, direction = _half_changes(first, second, time_step, neighbor_distance, time_horizon)
    half_planes = np.empty((4, max(count - 1, 0), count, episodes), np.float32)
    half_planes[:2, other - 1, one] = first[2:4] + change
    half_planes[2:, other - 1, one] = direction
    half_planes[:2, one, other] = second[2:4] - change
    half_planes[2:, one, other] = np.negative(direction, out=direction)
    return half_planes


def _half_changes(agent, other, time_step, neighbor_distance, time_horizon):
    """Return the agents' changes of velocity and the directions of their half-planes, (2, ...); zeros if not near."""
    away, velocity, reach = other[:2] - agent[:2], agent[2:4] - other[2:4], other[4] + agent[4]
    squared, reach_squared = dot(away, away), reach * reach
    # Agents that overlap must be apart after one time step.
    overlap = squared <= reach_squared
    rate = np.full(squared.shape, 1 / np.float32(time_horizon))
    np.copyto(rate, 1 / np.float32(time_step), where=overlap)

    # w leads from the centre of the disc to the relative velocity, which is nearest to the disc if w points back to it.
    w = velocity - rate * away
    w_squared, towards = dot(w, w), dot(w, away)
    on_disc = overlap | ((towards < 0) & (towards * towards > reach_squared * w_squared))

    # Otherwise it is nearest to the leg on its side of the cone's axis: the left leg or the reversed right one. On the
    # axis RVO2 takes the right one; subtracting a tiny number does the same.
    side = np.copysign(np.sqrt(squared - reach_squared), det(away, w) - TINY)
    leg = away * side
    across = away * reach
    leg[0] -= across[1]
    leg[1] += across[0]
    leg *= 1 / squared

    length = np.sqrt(w_squared)
    inward = np.multiply(w, -1 / length, out=w)
    change = np.where(on_disc, (length - reach * rate) * inward, dot(velocity, leg) * leg - velocity)
    change *= HALF
    direction = np.where(on_disc, turn_left(inward), leg)
    far = ~(squared < np.float32(neighbor_distance) * np.float32(neighbor_distance))  # also where NaN
    np.copyto(change, 0, where=far)
    np.copyto(direction, 0, where=far)
    return change, direction
