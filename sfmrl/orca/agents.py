"""ORCA half-planes between pairs of agents; each of the two takes half of the avoidance.

The relative velocities at which an agent hits another one within the time horizon are its velocity obstacle: a cone
with its tip at 0 and its axis towards the other agent, cut off by a disc. The disc is as large as both agents together,
lies at the other's relative position, and both are divided by the horizon. The agent changes its velocity by half of
the shortest way out.

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, section 4.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from sfmrl.orca.vectors import INFINITY, choose, det, dot, order_key, turn_left

HALF = np.float32(0.5)
TINY = np.float32(1e-30)


class Agents(NamedTuple):
    """What agents see of each other, in float32 arrays that end in (N, E): agent, episode. NaN where absent.

    position: (2, N, E) m
    velocity: (2, N, E) m/s
    radius: (N, E) m
    """

    position: np.ndarray
    velocity: np.ndarray
    radius: np.ndarray

    def take(self, rows):
        """The agents in some rows: those at an index (...) make arrays that end in (..., E)."""
        return Agents(*(values.take(rows, axis=-2) for values in self))


def neighbors(agents, own, others, most):
    """Return the neighbours (M, C, E) of the agents in rows `own` (C,): all `others`, or the `most` nearest of them.

    `others` are the rows in which anybody is present, `own` among them. Of equally near ones, the first are taken.
    """
    if len(others) - 1 <= most or most == 0:
        rank = np.arange(min(len(others) - 1, most))[:, None]
        return agents.take(others[rank + (rank >= np.searchsorted(others, own))])  # all but oneself
    position = agents.position.swapaxes(1, 2)
    away = position[:, None].take(others, axis=-1) - agents.position.take(own, axis=1)[..., None]
    squared = np.fmin(dot(away, away), INFINITY)  # (C, E, N)
    squared[np.arange(len(own)), :, np.searchsorted(others, own)] = np.nan  # oneself, farther than those absent
    key = np.partition(order_key(squared, np.arange(len(others))), most - 1, axis=-1)[..., :most]
    nearest = np.sort(key & 0xFFFF, axis=-1)
    episodes = agents.radius.shape[1]
    index = others[nearest].transpose(2, 0, 1) * episodes + np.arange(episodes)
    return Agents(*(values.reshape(*values.shape[:-2], -1).take(index, axis=-1) for values in agents))


def agent_half_planes(agents, others, time_step, neighbor_distance, time_horizon):
    """Return the half-planes (4, M, C, E) of agents (C, E) for their neighbours (M, C, E), of zeros for those far away.

    time_step and time_horizon are in s, neighbor_distance in m.
    """
    agents = Agents(*(values[..., None, :, :] for values in agents))
    change, direction = _changes(agents, others, time_step, neighbor_distance, time_horizon)
    change += agents.velocity
    return np.concatenate([change, direction])


def mutual_half_planes(agents, time_step, neighbor_distance, time_horizon):
    """Return the half-planes (4, C - 1, C, E) of agents (C, E) for all the others, with half the work.

    What one of a couple has on its left, the other has on its right, to the bit.
    """
    one, other = _couples(agents.radius.shape[0])
    first, second = agents.take(one), agents.take(other)
    change, direction = _changes(first, second, time_step, neighbor_distance, time_horizon)
    half_planes = np.empty((4, max(agents.radius.shape[0] - 1, 0), *agents.radius.shape), np.float32)
    half_planes[:2, other - 1, one], half_planes[:2, one, other] = first.velocity + change, second.velocity - change
    half_planes[2:, other - 1, one], half_planes[2:, one, other] = direction, -direction
    return half_planes


_couples = cache(lambda count: np.triu_indices(count, 1))  # the rows of both of all couples


def _changes(agents, others, time_step, neighbor_distance, time_horizon):
    """Return how agents change their velocities, and the half-planes' directions, both (2, ...), 0 where far away."""
    away, reach = others.position - agents.position, others.radius + agents.radius
    velocity = agents.velocity - others.velocity
    squared, reach_squared = dot(away, away), reach * reach
    # Agents that overlap must part within the time step: that is the horizon then, and the disc alone counts.
    overlap = squared <= reach_squared
    rate = np.full(squared.shape, 1 / np.float32(time_horizon))
    rate[overlap] = 1 / np.float32(time_step)

    # From the disc's centre to the relative velocity. On the disc's near side, the way out leads over the disc, ...
    w = velocity - rate * away
    w_squared, towards = dot(w, w), dot(w, away)
    on_disc = overlap | ((towards < 0) & (towards * towards > reach_squared * w_squared))
    # ... elsewhere over a leg of the cone: the left one if the relative velocity is on the left of the axis, else the
    # right one, reversed. On the axis itself, the tiny number makes it the right one, as in RVO2.
    side = np.copysign(np.sqrt(squared - reach_squared), det(away, w) - TINY)
    leg = away * side
    leg += turn_left(away) * reach
    leg *= 1 / squared

    length = np.sqrt(w_squared)
    w *= 1 / length
    way_out = choose(on_disc, (reach * rate - length) * w, dot(velocity, leg) * leg - velocity)
    way_out *= HALF
    near = squared < np.float32(neighbor_distance) * np.float32(neighbor_distance)
    direction = choose(on_disc, -turn_left(w), leg)
    return choose(near, way_out, np.float32(0)), choose(near, direction, np.float32(0))
