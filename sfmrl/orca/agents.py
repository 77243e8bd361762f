"""Half-planes by which agents share the avoiding of each other.

An agent takes over half of the smallest change of the two agents' relative velocity that keeps them apart for the time
horizon. The relative velocities that do not are a cone, cut off by a disc: the velocity obstacle.

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, section 4.
"""

from functools import cache

import numpy as np

from sfmrl.orca.vectors import det, dot, turn_right

HALF = np.float32(0.5)
TINY = np.float32(1e-30)


def mutual_half_planes(agents, time_step, neighbor_distance, time_horizon):
    """Return the half-planes (4, C - 1, C, E) by which all agents (8, C, E) share the avoiding of each other.

    As `agent_half_planes`, with half the work: what one has on its left, the other has on its right, to the bit.
    """
    count, episodes = agents.shape[1:]
    one, other = _couples(count)
    first, second = agents[:5].take(one, axis=1), agents[:5].take(other, axis=1)
    change, direction = _shares(first, second, time_step, neighbor_distance, time_horizon)
    half_planes = np.empty((4, max(count - 1, 0), count, episodes), np.float32)
    half_planes[:2, other - 1, one] = first[2:4] + change
    half_planes[2:, other - 1, one] = direction
    half_planes[:2, one, other] = second[2:4] - change
    half_planes[2:, one, other] = np.negative(direction, out=direction)
    return half_planes


@cache
def _couples(count):
    """Return the indices of the first and the second of all couples among `count`."""
    return np.triu_indices(count, 1)


def agent_half_planes(agent, other, time_step, neighbor_distance, time_horizon):
    """Return the half-planes (4, M, C, E) by which agents share the avoiding of others, without effect if far away.

    agent (8, C, E) and other (5, M, C, E) are position, velocity, radius and so on, NaN where absent; float32, in m and
    m/s. time_step and time_horizon are in s, neighbor_distance in m. Source: the paper's section 4.
    """
    change, direction = _shares(agent[:, None], other, time_step, neighbor_distance, time_horizon)
    change += agent[2:4, None]
    return np.concatenate([change, direction])


def _shares(agent, other, time_step, neighbor_distance, time_horizon):
    """Return by how much agents must change their velocities at least, and the half-planes' directions, both (2, ...).

    agent and other are as in `agent_half_planes`, and broadcast behind their first axis. Both are zero where nobody
    is near.
    """
    away, velocity, reach = other[:2] - agent[:2], agent[2:4] - other[2:4], other[4] + agent[4]
    squared, reach_squared = dot(away, away), reach * reach
    # Agents that overlap must part within the time step.
    overlap = squared <= reach_squared
    rate = np.full(squared.shape, 1 / np.float32(time_horizon))
    np.copyto(rate, 1 / np.float32(time_step), where=overlap)

    # From the centre of the cut-off disc to the relative velocity; the disc counts if that is on its near side.
    w = velocity - rate * away
    w_squared, towards = dot(w, w), dot(w, away)
    on_disc = overlap | ((towards < 0) & (towards * towards > reach_squared * w_squared))

    # Else the left leg of the cone counts, if the relative velocity is left of its axis, or the right one, reversed. On
    # the axis itself RVO2 takes the right one, and so does the tiny number.
    side = np.copysign(np.sqrt(squared - reach_squared), det(away, w) - TINY)
    leg = away * side
    across = away * reach
    leg[0] -= across[1]
    leg[1] += across[0]
    leg *= 1 / squared
    along = dot(velocity, leg)

    length = np.sqrt(w_squared)
    w *= 1 / length
    share = np.where(on_disc, (reach * rate - length) * w, along * leg - velocity)
    share *= HALF
    direction = np.where(on_disc, turn_right(w), leg)
    far = ~(squared < np.float32(neighbor_distance) * np.float32(neighbor_distance))  # or absent: NaN
    np.copyto(share, 0, where=far)
    np.copyto(direction, 0, where=far)
    return share, direction
