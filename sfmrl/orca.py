"""Optimal Reciprocal Collision Avoidance (ORCA): velocities at which nobody collides if everybody does the same.

For each neighbour, an agent gives up the velocities on one side of a line in velocity space: it takes over half of the
smallest change of the two agents' relative velocity that keeps them apart for `time_horizon`. Polygons add lines of
their own (`orca_polygons.py`). The agent then moves with the velocity nearest to its preferred one on the permitted
side of every line (`linear_programs.py`).

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, sections 4 and 5, and where the paper leaves
details open, the behaviour of the authors' RVO2 library. Left out: a search tree for neighbours.

Everything is computed in float32 by component, with the neighbour as the first axis, so that each operation runs
through one long row, and linear programs run only for agents whose preferred velocity is not permitted. All operations
are elementwise, minima or maxima: an episode's result does not depend on the batch.
"""

import numpy as np

from sfmrl.linear_programs import bits, choose, least_violations, limit_speed, nearest_velocities, one_by_one, violations
from sfmrl.orca_polygons import Edges, edge_half_planes, polygon_edges, uncovered

__all__ = ["Edges", "orca_velocities", "polygon_edges"]

HALF = np.float32(0.5)
BLOCK = 32768  # pairs of agents (or agents and edges) at a time: a few such rows stay in the processor's cache


def _keep_freed_memory():
    """Make glibc keep up to 32 MB of freed memory for the next call, instead of giving it back after each.

    It keeps twice the size of the largest block that was ever freed; elsewhere this does nothing.
    """
    np.empty(1 << 24, np.uint8)


_keep_freed_memory()


def orca_velocities(
    position,
    velocity,
    preferred_velocity,
    radius,
    max_speed,
    polygons=None,
    *,
    agents=None,
    time_step=0.25,
    neighbor_distance=10.0,
    max_neighbors=10,
    time_horizon=5.0,
    obstacle_time_horizon=5.0,
):
    """Return everybody's collision-avoiding velocities (E, N, 2) in m/s for the coming time step.

    position (m), velocity and preferred_velocity (m/s) are (E, N, 2), radius (m) and max_speed (m/s) broadcast to
    (E, N). An agent whose position is NaN is absent: it gets NaN and influences nobody. `polygons` (E, P, V, 2) in m or
    their `polygon_edges` stand still. `agents` (E, N) are those to compute, all by default; the others get NaN but are
    avoided. time_step and horizons are in s, neighbor_distance in m. Raises ValueError for wrong shapes.
    Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011.
    """
    position = np.asarray(position)
    if position.ndim != 3 or position.shape[2] != 2:
        raise ValueError(f"position must have shape (E, N, 2), not {position.shape}")
    episodes, rows = position.shape[:2]
    planes = np.empty((8, rows, episodes), np.float32)
    planes[0:2] = position.T
    planes[2:4] = _checked("velocity", velocity, position.shape).T
    planes[4] = _broadcast("radius", radius, (episodes, rows)).T
    planes[5] = _broadcast("max_speed", max_speed, (episodes, rows)).T
    planes[6:8] = _checked("preferred_velocity", preferred_velocity, position.shape).T
    edges = polygons
    if edges is None:
        edges = Edges(np.empty((12, 0, episodes), np.float32))
    elif not isinstance(edges, Edges):
        edges = polygon_edges(edges)
    if len(edges) != episodes:
        raise ValueError(f"polygons must be those of {episodes} episodes, not of {len(edges)}")

    present = ~np.isnan(planes[0])
    wanted = present
    if agents is not None:
        wanted = present & _checked("agents", agents, (episodes, rows)).astype(bool).T
    result = np.full((episodes, rows, 2), np.nan)
    others = np.flatnonzero(present.any(axis=1))
    own = np.flatnonzero(wanted.any(axis=1))
    with np.errstate(all="ignore"):
        size = max(1, BLOCK // max(1, len(own) * max(len(others), edges.values.shape[1])))
        for first in range(0, episodes, size):
            block = slice(first, first + size)
            found = _block_velocities(
                planes[:, :, block], edges.values[:, :, block], own, others, time_step, neighbor_distance,
                max_neighbors, time_horizon, obstacle_time_horizon,
            )
            result[block, own] = np.where(wanted[own, block], found, np.float32(np.nan)).T
    return result


def _block_velocities(planes, edges, own, others, time_step, neighbor_distance, max_neighbors, time_horizon, obstacle_horizon):
    agent = planes.take(own, axis=1)
    preferred = agent[6:].reshape(2, -1)
    speed = agent[5].reshape(-1)
    # Everybody's others, without themselves.
    rank = np.arange(len(others) - 1)[:, None]
    other = planes[:5].take(others[rank + (rank >= np.searchsorted(others, own))], axis=1)
    if len(rank) > max_neighbors:
        x, y = other[0] - agent[0], other[1] - agent[1]
        nearest = _nearest(x * x + y * y, max_neighbors)
        other = np.take_along_axis(other, nearest[None], axis=1)
    lines = agent_half_planes(agent, other, time_step, neighbor_distance, time_horizon)
    lines = lines.reshape(4, -1, speed.size)
    if not edges.shape[1]:
        return permitted(lines, 0, speed, preferred).reshape(2, len(own), -1)
    result = limit_speed(preferred, speed)
    hard, owner, squared, ends = edge_half_planes(edges, agent[:6], obstacle_horizon)
    unhappy = (violations(lines, result) > 0).any(axis=0)
    unhappy[owner[violations(hard, result.take(owner, axis=1)) > 0]] = True
    pairs = np.flatnonzero(unhappy[owner])
    owner = (np.cumsum(unhappy) - 1)[owner[pairs]]
    unhappy = np.flatnonzero(unhappy)
    if len(unhappy):
        margin = agent[4].reshape(-1)[unhappy] * np.float32(1 / obstacle_horizon)
        hard = uncovered(hard.take(pairs, axis=1), owner, squared[pairs], ends.take(pairs, axis=1), margin)
        lines = np.concatenate([hard, lines.take(unhappy, axis=2)], axis=1)
        result[:, unhappy] = permitted(lines, hard.shape[1], speed[unhappy], preferred.take(unhappy, axis=1))
    return result.reshape(2, len(own), -1)


def permitted(lines, n_hard, speed, preferred):
    result, feasible = nearest_velocities(lines, speed, preferred)
    rest = np.flatnonzero(~feasible)
    if len(rest):
        result[:, rest], found = least_violations(lines.take(rest, axis=2), n_hard, speed[rest], result.take(rest, axis=1))
        rest = rest[~found]
    if len(rest):
        result[:, rest] = one_by_one(lines[:, :, rest], speed[rest], preferred[:, rest])
    return result


def agent_half_planes(agent, other, time_step, neighbor_distance, time_horizon):
    """Return the half-planes (4, M, ...) by which agents share the avoiding of others, zeros where there is nobody near.

    agent (8, ...) and other (5, M, ...) are position, velocity, radius and so on, NaN where absent; float32, m, m/s, s.
    """
    x, y, velocity_x, velocity_y, reach = other
    x, y, reach = x - agent[0], y - agent[1], reach + agent[4]
    velocity_x, velocity_y = agent[2] - velocity_x, agent[3] - velocity_y
    squared = x * x + y * y
    reach_squared = reach * reach
    overlap = squared <= reach_squared
    rate = choose(bits(overlap), np.float32(1 / time_step), np.float32(1 / time_horizon))

    # w leads from the centre of the cut-off disc to the relative velocity.
    w_x, w_y = velocity_x - rate * x, velocity_y - rate * y
    w_squared = w_x * w_x + w_y * w_y
    towards = w_x * x + w_y * y
    on_disc = bits(overlap | ((towards < 0) & (towards * towards > reach_squared * w_squared)))

    # On the left leg of the cone where the relative velocity is left of its axis, else on the right one, turned around.
    leg = np.copysign(np.sqrt(squared - reach_squared), x * w_y - y * w_x)
    scale = 1 / squared
    leg_x, leg_y = x * leg, x * reach
    leg_x -= y * reach
    leg_y += y * leg
    leg_x *= scale
    leg_y *= scale
    along = velocity_x * leg_x + velocity_y * leg_y

    length = np.sqrt(w_squared)
    scale = 1 / length
    w_x *= scale
    w_y *= scale
    change = reach * rate - length

    half_planes = np.empty((4, *x.shape), np.float32)
    change_x = choose(on_disc, change * w_x, along * leg_x - velocity_x)
    change_y = choose(on_disc, change * w_y, along * leg_y - velocity_y)
    change_x *= HALF
    change_y *= HALF
    np.add(agent[2], change_x, out=half_planes[0])
    np.add(agent[3], change_y, out=half_planes[1])
    half_planes[2] = choose(on_disc, w_y, leg_x)
    half_planes[3] = choose(on_disc, -w_x, leg_y)
    # Clear all bits of those that are absent or too far away.
    half_planes.view(np.int32)[...] &= bits(squared < np.float32(neighbor_distance**2))
    return half_planes


def _nearest(squared, count):
    """Return the indices (count, ...) of the least of the squared distances (M, ...), ties to the first, NaN last."""
    # The bits of positive floats are ordered as the floats are; the low half of the key breaks ties.
    bits = np.where(squared >= 0, squared.view(np.int32), np.int32(0x7FFFFFFF)).astype(np.int64)
    key = bits << 32 | np.arange(len(squared)).reshape(-1, 1, 1)
    return np.partition(key, count, axis=0)[:count] & 0xFFFFFFFF


def _checked(name, value, shape):
    value = np.asarray(value)
    if value.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, not {value.shape}")
    return value


def _broadcast(name, value, shape):
    value = np.asarray(value)
    if value.shape == shape:
        return value
    try:
        return np.broadcast_to(value, shape)
    except ValueError:
        raise ValueError(f"{name} must broadcast to shape {shape}, not {value.shape}") from None
