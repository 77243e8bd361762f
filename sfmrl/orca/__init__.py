"""Optimal Reciprocal Collision Avoidance (ORCA): velocities at which nobody collides if everybody does the same.

For each neighbour (`agents.py`) and each edge of a polygon near by (`edges.py`), an agent gives up the velocities on
one side of a line in velocity space. Of the velocities on the permitted side of every line, it then takes the one
nearest to its preferred velocity (`programs.py`).

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, sections 4 and 5, and where the paper leaves
details open, the behaviour of the authors' RVO2 library. Left out: a search tree for neighbours.

Everything is computed in float32 by component, with the neighbour as the first axis (M, C, E), so that each operation
runs through one long row, and linear programs run only for agents whose preferred velocity is not permitted. Nothing is
summed over an axis: an episode's result has the same bits whatever the batch.
"""

from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike

from sfmrl.geometry import broadcast, numbers
from sfmrl.orca.agents import agent_half_planes, mutual_half_planes
from sfmrl.orca.edges import edge_half_planes, uncovered
from sfmrl.orca.polygons import Edges, polygon_edges
from sfmrl.orca.programs import least_violations, nearest_velocities, violations
from sfmrl.orca.vectors import INFINITY, limit_speed

__all__ = ["Edges", "orca_velocities", "polygon_edges"]

BLOCK = 32768  # pairs at a time: a few such rows stay in the processor's cache
LAST = 0x7FFFFFFF  # more than the bits of any float

# Once a block of 16 MB has been freed, glibc keeps up to 32 MB of freed memory for the next step, instead of returning
# it to the system after each.
np.empty(1 << 24, np.uint8)


def orca_velocities(
    position: ArrayLike,
    velocity: ArrayLike,
    preferred_velocity: ArrayLike,
    radius: ArrayLike,
    max_speed: ArrayLike,
    polygons: ArrayLike | Edges | None = None,
    *,
    agents: ArrayLike | None = None,
    time_step: float = 0.25,
    neighbor_distance: float = 10.0,
    max_neighbors: int = 10,
    time_horizon: float = 5.0,
    obstacle_time_horizon: float = 5.0,
) -> np.ndarray:
    """Return everybody's collision-avoiding velocities (E, N, 2) in m/s for the coming time step.

    position (m) is (E, N, 2), velocity and preferred_velocity (m/s) broadcast to it, radius (m) and max_speed (m/s) to
    (E, N). An agent whose position is NaN is absent: it gets NaN and influences nobody. `polygons` (E, P, V, 2) in m or
    their `polygon_edges` stand still; a square is one of them, and has NaN where `position` has a row for it. ORCA
    looks for the velocity nearest to the preferred one, also where that is faster than max_speed. `agents` broadcasts
    to (E, N) and is True for those to compute, all by default; the others get NaN but are avoided. time_step and
    horizons are in s, neighbor_distance in m. Raises ValueError for wrong shapes and polygons, and for numbers that are
    not finite or out of range. A scene may lie anywhere, but its agents must be within a few kilometres of each other:
    they are computed in float32 relative to an origin near most of them.
    """
    position = numbers("position", position)
    if position.ndim != 3 or position.shape[2] != 2:
        raise ValueError(f"position must have shape (E, N, 2), not {position.shape}")
    time_step, time_horizon = _positive("time_step", time_step), _positive("time_horizon", time_horizon)
    obstacle_time_horizon = _positive("obstacle_time_horizon", obstacle_time_horizon)
    neighbor_distance = _positive("neighbor_distance", neighbor_distance, least=0.0, most=np.inf)
    if not isinstance(max_neighbors, Integral) or max_neighbors < 0:
        raise ValueError(f"max_neighbors is {max_neighbors!r}; it must be a whole number, 0 or more")
    if agents is not None and np.asarray(agents).dtype != bool:
        raise ValueError("agents must be an array of bool: True for the agents to compute, False for the others")
    if polygons is None:
        polygons = np.empty((len(position), 0, 0, 2))
    edges = polygons if isinstance(polygons, Edges) else polygon_edges(polygons, position)
    if len(edges) != len(position):
        raise ValueError(f"polygons must belong to {len(position)} episodes, not to {len(edges)}")
    planes, present = _planes(position, velocity, radius, max_speed, preferred_velocity, edges.origin)
    wanted = present if agents is None else present & (broadcast("agents", agents, position.shape[:2]) != 0).T
    others, own = present.any(axis=1).nonzero()[0], wanted.any(axis=1).nonzero()[0]

    velocities = np.full(position.shape, np.nan)
    with np.errstate(all="ignore"):
        for block, part in _blocks(len(position), own, max(edges.values.shape[1], min(max_neighbors, len(others)))):
            agent = planes[:, :, block].take(part, axis=1)
            if len(part) == len(others) <= max_neighbors + 1:  # then pairs are the same seen from both sides
                lines = mutual_half_planes(agent, time_step, neighbor_distance, time_horizon)
            else:
                other = _neighbors(planes[:5, :, block], part, others, max_neighbors)
                lines = agent_half_planes(agent, other, time_step, neighbor_distance, time_horizon)
            velocities[block, part] = _velocities(agent, lines, edges.values[:, :, block], obstacle_time_horizon).T
    velocities[~wanted.T] = np.nan
    return velocities


def _velocities(agent, lines, edges, obstacle_time_horizon):
    """Return the velocities (2, C, E) of agents (8, C, E), given their half-planes (4, M, C, E) and nearby edges."""
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
        rank = np.arange(min(len(others) - 1, most))[:, None]  # from an agent's own place in `others` on, one more
        return planes.take(others[rank + (rank >= np.searchsorted(others, own))], axis=1)
    episodes = planes.shape[2]
    nearest = np.empty((most, len(own), episodes), np.int64)
    at_once = max(1, BLOCK // (len(others) * episodes))
    position = np.ascontiguousarray(planes[:2].take(others, axis=1).transpose(0, 2, 1))
    for first in range(0, len(own), at_once):
        columns = own[first : first + at_once]
        away = position[:, None] - planes[:2].take(columns, axis=1)[..., None]
        away *= away
        squared = np.add(*away, out=away[0])
        np.fmin(squared, INFINITY, out=squared)  # absent ones last
        distance = squared.view(np.int32)  # bits of positive floats are ordered as the floats are
        distance[np.arange(len(columns)), :, np.searchsorted(others, columns)] = LAST
        chosen = _least(distance.reshape(-1, len(others)), most).reshape(len(columns), episodes, most)
        nearest[:, first : first + at_once] = others[chosen].transpose(2, 0, 1)
    return planes.reshape(len(planes), -1).take(nearest * episodes + np.arange(episodes), axis=1)


def _least(distance, count):
    """Return the indices (K, count) of the least integers in each row (K, M), ascending; of equal ones the first."""
    limit = np.partition(distance, count - 1, axis=1)[:, count - 1 : count]
    chosen = np.flatnonzero(distance <= limit)
    if len(chosen) > count * len(distance):  # ties
        return np.sort(np.argsort(distance, axis=1, kind="stable")[:, :count], axis=1)
    return chosen.reshape(-1, count) % distance.shape[1]


def _blocks(episodes, own, pairs):
    """Yield slices of the episodes with parts of the rows `own`, whose agents have `pairs` each: BLOCK in all."""
    size = max(1, BLOCK // max(1, pairs * len(own)))
    columns = max(1, BLOCK // (max(1, pairs) * size))
    for first in range(0, episodes, size):
        for column in range(0, len(own), columns):
            yield slice(first, first + size), own[column : column + columns]


def _planes(position, velocity, radius, max_speed, preferred_velocity, origin):
    """Return ORCA's inputs, checked, as one array (8, N, E) of components, and which agents are present, (N, E)."""
    episodes, rows = shape = position.shape[:2]
    planes = np.empty((8, rows, episodes), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        np.subtract(position.T, origin.T[:, None], out=planes[0:2], casting="same_kind")
        planes[2:4] = broadcast("velocity", velocity, position.shape).T
        planes[4] = broadcast("radius", radius, shape).T
        planes[5] = broadcast("max_speed", max_speed, shape).T
        planes[6:8] = broadcast("preferred_velocity", preferred_velocity, position.shape).T
    present = ~np.isnan(position).any(axis=2).T
    good = np.isfinite(planes)
    good[4:6] &= planes[4:6] >= 0
    bad = (present & ~good).any(axis=(1, 2))
    if bad.any():
        names = (*["position"] * 2, *["velocity"] * 2, "radius", "max_speed", *["preferred_velocity"] * 2)
        name = names[bad.argmax()]
        least = " and not below 0" if name in ("radius", "max_speed") else ""
        raise ValueError(f"{name} must be finite{least} for everybody whose position is not NaN")
    return planes, present


def _positive(name, value, least=np.finfo(np.float32).tiny, most=np.finfo(np.float32).max):
    number = numbers(name, value)
    if number.ndim or not least <= number <= most:
        raise ValueError(f"{name} is {value!r}; it must be a finite number{' above 0' if least else ', 0 or more'}")
    return float(number)
