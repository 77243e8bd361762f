"""Optimal Reciprocal Collision Avoidance (ORCA): velocities at which nobody collides if everybody does the same.

For each neighbour, an agent gives up the velocities on one side of a line in velocity space (`agents.py`), and for
each edge of a polygon near by (`edges.py`). It then moves with the velocity nearest to its preferred one on the
permitted side of every line (`programs.py`).

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, sections 4 and 5, and where the paper leaves
details open, the behaviour of the authors' RVO2 library. Left out: a search tree for neighbours.

Everything is computed in float32 by component, with the neighbour as the first axis (M, C, E), so that each operation
runs through one long row, and linear programs run only for agents whose preferred velocity is not permitted. Nothing is
summed over an axis: an episode's result has the same bits whatever the batch.
"""

from numbers import Integral

import numpy as np

from sfmrl.geometry import broadcast, numbers
from sfmrl.orca.agents import agent_half_planes, mutual_half_planes
from sfmrl.orca.edges import edge_half_planes, uncovered
from sfmrl.orca.polygons import Edges, polygon_edges
from sfmrl.orca.programs import least_violations, nearest_velocities, violations
from sfmrl.orca.vectors import INFINITY, limit_speed

__all__ = ["Edges", "orca_velocities", "polygon_edges"]

BLOCK = 32768  # pairs at a time: a few such rows stay in the processor's cache
LAST = 0x7FFFFFFF  # more than the bits of any float


def _keep_freed_memory():
    """Make glibc keep up to 32 MB of freed memory for the next step, instead of giving it back after each.

    It keeps twice the size of the largest block that was ever freed; with other allocators, this does nothing.
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

    position (m) is (E, N, 2), velocity and preferred_velocity (m/s) broadcast to it, radius (m) and max_speed (m/s) to
    (E, N). An agent whose position is NaN is absent: it gets NaN and influences nobody. `polygons` (E, P, V, 2) in m or
    their `polygon_edges` stand still. `agents`, which broadcast to (E, N), are those to compute, all by default; the
    others get NaN but are avoided. time_step and horizons are in s, neighbor_distance in m. Raises ValueError for wrong
    shapes and polygons, and for numbers that are not finite or out of range. A scene may lie anywhere, but its agents
    within a few kilometres: they are computed in float32 relative to an origin near most of them.
    Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011.
    """
    position = numbers("position", position)
    if position.ndim != 3 or position.shape[2] != 2:
        raise ValueError(f"position must have shape (E, N, 2), not {position.shape}")
    episodes, rows = shape = position.shape[:2]
    time_step, time_horizon = _positive("time_step", time_step), _positive("time_horizon", time_horizon)
    obstacle_time_horizon = _positive("obstacle_time_horizon", obstacle_time_horizon)
    neighbor_distance = _positive("neighbor_distance", neighbor_distance, least=0.0, most=np.inf)
    if not isinstance(max_neighbors, Integral) or max_neighbors < 0:
        raise ValueError(f"max_neighbors is {max_neighbors!r}; it must be a whole number, 0 or more")
    outline = _edges(polygons, position)
    edges = outline.values
    planes = np.empty((8, rows, episodes), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        np.subtract(position.T, outline.origin.T[:, None], out=planes[0:2], casting="same_kind")
        planes[2:4] = broadcast("velocity", velocity, position.shape).T
        planes[4] = broadcast("radius", radius, shape).T
        planes[5] = broadcast("max_speed", max_speed, shape).T
        planes[6:8] = broadcast("preferred_velocity", preferred_velocity, position.shape).T
    wanted = present = ~np.isnan(position).any(axis=2).T
    _check_finite(planes, present)
    if agents is not None:
        wanted = present & (broadcast("agents", agents, shape) != 0).T
    others, own = present.any(axis=1).nonzero()[0], wanted.any(axis=1).nonzero()[0]

    velocities = np.full((episodes, rows, 2), np.nan)
    pairs = max(1, edges.shape[1], min(max_neighbors, len(others)))  # of each agent
    size = max(1, BLOCK // (pairs * max(1, len(own))))
    columns = max(1, BLOCK // (pairs * size))
    everybody = columns >= len(own) == len(others) <= max_neighbors + 1  # then pairs are the same seen from both sides
    with np.errstate(all="ignore"):
        for first in range(0, episodes, size):
            block = slice(first, first + size)
            for column in range(0, len(own), columns):
                part = own[column : column + columns]
                agent = planes[:, :, block].take(part, axis=1)
                if everybody:
                    lines = mutual_half_planes(agent, time_step, neighbor_distance, time_horizon)
                else:
                    other = _neighbors(planes[:5, :, block], part, others, max_neighbors)
                    lines = agent_half_planes(agent, other, time_step, neighbor_distance, time_horizon)
                found = _velocities(agent, lines, edges[:, :, block], obstacle_time_horizon)
                velocities[block, part] = found.T
    velocities[~wanted.T] = np.nan
    return velocities


def _velocities(agent, lines, edges, obstacle_time_horizon):
    """Return the velocities (2, C, E) of agents (8, C, E) who keep their half-planes (4, M, C, E) and off the edges."""
    shape = agent.shape[1:]
    preferred, speed = agent[6:].reshape(2, -1), agent[5].reshape(-1)
    lines = lines.reshape(4, -1, speed.size)
    if not edges.shape[1]:
        return _permitted(lines, 0, speed, preferred).reshape(2, *shape)

    # Which edges cover others matters only to agents whose preferred velocity is not permitted.
    velocity = limit_speed(preferred, speed)
    hard, owner, ends = edge_half_planes(edges, agent[:6], obstacle_time_horizon)
    moved = (violations(lines, velocity) > 0).any(axis=0)
    moved[owner[violations(hard, velocity.take(owner, axis=1)) > 0]] = True
    pair = moved[owner].nonzero()[0]
    owner = (np.cumsum(moved) - 1)[owner[pair]]
    moved = moved.nonzero()[0]
    radius = agent[4].reshape(-1)[moved]
    hard = uncovered(hard.take(pair, axis=1), owner, ends.take(pair, axis=1), radius, obstacle_time_horizon)
    lines = np.concatenate([hard, lines.take(moved, axis=2)], axis=1)
    velocity[:, moved] = _permitted(lines, hard.shape[1], speed[moved], preferred.take(moved, axis=1))
    return velocity.reshape(2, *shape)


def _permitted(half_planes, n_hard, max_speed, preferred):
    """Return the velocities (2, Q) nearest to the preferred ones, or those that violate the soft half-planes least.

    The first n_hard of the half-planes (4, M, Q) are hard. Standing still violates none of them but by rounding, so an
    agent stops where no velocity is found that does better.
    """
    velocity, feasible = nearest_velocities(half_planes, max_speed, preferred)
    rest = (~feasible).nonzero()[0]
    if len(rest):
        velocity[:, rest], found = least_violations(
            half_planes.take(rest, axis=2), n_hard, max_speed[rest], velocity.take(rest, axis=1)
        )
        velocity[:, rest[~found]] = 0.0
    return velocity


def _neighbors(planes, own, others, most):
    """Return the planes (5, M, C, E) of the others of the agents in rows `own`: all of them, or the nearest `most`.

    planes (5, N, E) start with the position, others are the rows in which anybody is present.
    """
    if len(others) - 1 <= most or most == 0:
        rank = np.arange(min(len(others) - 1, most))[:, None]
        return planes.take(others[rank + (rank >= np.searchsorted(others, own))], axis=1)
    episodes = planes.shape[2]
    nearest = np.empty((most, len(own), episodes), np.int64)
    at_once = max(1, BLOCK // (len(others) * episodes))
    position = np.ascontiguousarray(planes[:2].take(others, axis=1).transpose(0, 2, 1))
    for first in range(0, len(own), at_once):
        columns = own[first : first + at_once]
        x, y = position[:, None] - planes[:2].take(columns, axis=1)[..., None]
        x *= x
        y *= y
        x += y
        distance = np.fmin(x, INFINITY, out=x).view(np.int32)  # bits of positive floats are ordered as the floats are
        distance[np.arange(len(columns)), :, np.searchsorted(others, columns)] = LAST
        chosen = _least(distance, most).reshape(len(columns), episodes, most)
        nearest[:, first : first + at_once] = others[chosen].transpose(2, 0, 1)
    return planes.reshape(len(planes), -1).take(nearest * episodes + np.arange(episodes), axis=1)


def _least(distance, count):
    """Return where the least of the integers (..., M) are, (K, count) in ascending order; of equal ones the first."""
    distance = distance.reshape(-1, distance.shape[-1])
    limit = np.partition(distance, count - 1, axis=1)[:, count - 1 : count]
    chosen = np.flatnonzero(distance <= limit)
    if len(chosen) > count * len(distance):
        key = distance.astype(np.int64) << 32 | np.arange(distance.shape[1])
        return np.sort(np.partition(key, count - 1, axis=1)[:, :count] & 0xFFFFFFFF, axis=1)
    return chosen.reshape(-1, count) % distance.shape[1]


def _edges(polygons, position):
    """Return the polygons' Edges, of no polygon where they are None, for agents at the positions (E, N, 2)."""
    if not isinstance(polygons, Edges):
        return polygon_edges(np.empty((len(position), 0, 1, 2)) if polygons is None else polygons, position)
    if len(polygons) != len(position):
        raise ValueError(f"polygons must belong to {len(position)} episodes, not to {len(polygons)}")
    return polygons


def _check_finite(planes, present):
    """Raise ValueError where planes (8, N, E) hold for somebody present (N, E) what is no number or below its range."""
    good = np.isfinite(planes)
    good[4:6] &= planes[4:6] >= 0
    bad = (present & ~good).any(axis=(1, 2))
    if bad.any():
        names = ("position", "velocity", "radius", "max_speed", "preferred_velocity")
        name = names[(0, 0, 1, 1, 2, 3, 4, 4)[bad.argmax()]]
        least = " and not below 0" if name in ("radius", "max_speed") else ""
        raise ValueError(f"{name} must be finite{least} for everybody whose position is not NaN")


def _positive(name, value, least=np.finfo(np.float32).tiny, most=np.finfo(np.float32).max):
    number = numbers(name, value)
    if number.ndim or not least <= number <= most:
        raise ValueError(f"{name} is {value!r}; it must be a finite number{' above 0' if least else ', 0 or more'}")
    return float(number)
