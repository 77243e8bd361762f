"""Optimal Reciprocal Collision Avoidance (ORCA): velocities at which nobody collides if everybody does the same.

1. For each neighbour, an agent gives up the velocities on one side of a line in velocity space (`agents.py`).
2. For each polygon edge within reach, it gives up those on one side of another line (`edges.py`).
3. It takes the velocity nearest to its preferred one that all these half-planes permit. If there is none, it keeps to
   the half-planes of edges and violates those of its neighbours as little as possible (`programs.py`).

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, sections 4 and 5, and where the paper leaves
details open, the behaviour of the authors' RVO2 library. Left out: a search tree for neighbours.

Everything is computed in float32 for whole batches. Arrays have their components first (`vectors.py`), then half-plane,
agent and episode, (4, M, C, E). Nothing is summed over an axis: an episode has the same bits in any batch.
"""

from numbers import Integral

import numpy as np

from sfmrl.orca.agents import Agents, agent_half_planes, mutual_half_planes, neighbors
from sfmrl.orca.edges import Edges, edge_half_planes, polygon_edges, uncovered
from sfmrl.orca.programs import least_violations, nearest_velocities, violations
from sfmrl.orca.vectors import limit_speed, numbers

__all__ = ["Edges", "orca_velocities", "polygon_edges"]

BLOCK = 65536  # pairs of agents, or of agents and edges, at a time: a few such rows stay in the processor's cache


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
    """Return the agents' collision-avoiding velocities (E, N, 2) in m/s for the coming time step.

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
    time_step, time_horizon = _positive("time_step", time_step), _positive("time_horizon", time_horizon)
    obstacle_time_horizon = _positive("obstacle_time_horizon", obstacle_time_horizon)
    neighbor_distance = _positive("neighbor_distance", neighbor_distance, least=0.0, most=np.inf)
    if not isinstance(max_neighbors, Integral) or max_neighbors < 0:
        raise ValueError(f"max_neighbors is {max_neighbors!r}; it must be a whole number, 0 or more")
    edges = _edges(polygons, position)
    wanted = present = ~np.isnan(position).any(axis=2)
    scene = position, velocity, radius, max_speed, preferred_velocity, present, edges.origin
    everybody, max_speed, preferred = _scene(*scene)
    if agents is not None:
        wanted = present & (numbers("agents", agents, present.shape) != 0)

    others, own = present.any(axis=0).nonzero()[0], wanted.any(axis=0).nonzero()[0]
    velocities = np.full(position.shape, np.nan)
    pairs = max(1, len(own)) * max(1, edges.ends.shape[2], min(max_neighbors, len(others)))
    size = max(1, BLOCK // pairs)
    with np.errstate(all="ignore"):
        for first in range(0, len(position), size):
            block = slice(first, first + size)
            seen, walls = Agents(*(v[..., block] for v in everybody)), Edges(*(v[..., block] for v in edges))
            movers = seen.take(own)
            if len(own) == len(others) <= max_neighbors + 1:
                soft = mutual_half_planes(movers, time_step, neighbor_distance, time_horizon)
            else:
                near = neighbors(seen, own, others, max_neighbors)
                soft = agent_half_planes(movers, near, time_step, neighbor_distance, time_horizon)
            wish = preferred[..., block].take(own, axis=1), max_speed[:, block].take(own, axis=0)
            velocities[block, own] = _velocities(movers, *wish, soft, walls, obstacle_time_horizon).T
    velocities[~wanted] = np.nan
    return velocities


def _velocities(agents, preferred, max_speed, half_planes, edges, time_horizon):
    """Return the velocities (2, C, E) of agents who keep to their half-planes (4, M, C, E) and off the edges."""
    shape, preferred, speed = preferred.shape, preferred.reshape(2, -1), max_speed.reshape(-1)
    half_planes = half_planes.reshape(4, half_planes.shape[1], speed.size)
    if not edges.ends.shape[2]:
        return _permitted(half_planes, 0, speed, preferred).reshape(shape)
    # Which edges cover others matters only to agents whose preferred velocity is not permitted.
    velocity = limit_speed(preferred, speed)
    hard, ends, key, owner = edge_half_planes(edges, agents, max_speed, time_horizon)
    moved = (violations(half_planes, velocity) > 0).any(axis=0)
    moved[owner[violations(hard, velocity.take(owner, axis=1)) > 0]] = True
    hard = uncovered(hard, ends, key, owner, moved, agents.radius.reshape(-1)[moved], time_horizon)
    moved = moved.nonzero()[0]
    lines = np.concatenate([hard, half_planes.take(moved, axis=2)], axis=1)
    velocity[:, moved] = _permitted(lines, hard.shape[1], speed[moved], preferred.take(moved, axis=1))
    return velocity.reshape(shape)


def _permitted(half_planes, n_hard, max_speed, preferred):
    """Return the velocities (2, Q) nearest to the preferred ones, or those that violate the soft half-planes least.

    The first n_hard of the half-planes (4, M, Q) are hard. Standing still violates none of them but by rounding, so an
    agent stops where no velocity is found that does better.
    """
    velocity, feasible = nearest_velocities(half_planes, max_speed, preferred)
    rest = (~feasible).nonzero()[0]
    if len(rest):
        lines = half_planes.take(rest, axis=2)
        velocity[:, rest], found = least_violations(lines, n_hard, max_speed[rest], velocity.take(rest, axis=1))
        velocity[:, rest[~found]] = 0.0
    return velocity


def _scene(position, velocity, radius, max_speed, preferred, present, origin):
    """Return all Agents (N, E), their maximum speeds (N, E) and preferred velocities (2, N, E) in float32.

    Positions are relative to the origin (2, E). Raises ValueError for what is not finite or below its range, where
    somebody is `present` (E, N).
    """
    values = np.empty((8, *position.shape[1::-1]), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        values[0:2] = position.T - origin[:, None]
        values[2:4] = numbers("velocity", velocity, position.shape).T
        values[4] = numbers("radius", radius, position.shape[:2]).T
        values[5] = numbers("max_speed", max_speed, position.shape[:2]).T
        values[6:8] = numbers("preferred_velocity", preferred, position.shape).T
    good = np.isfinite(values)
    good[4:6] &= values[4:6] >= 0
    bad = (~good & present.T).any(axis=(1, 2))
    if bad.any():
        names = ("position", "velocity", "radius", "max_speed", "preferred_velocity")
        name = names[(0, 0, 1, 1, 2, 3, 4, 4)[bad.argmax()]]
        least = " and not below 0" if name in ("radius", "max_speed") else ""
        raise ValueError(f"{name} must be finite{least} for everybody whose position is not NaN")
    return Agents(values[0:2], values[2:4], values[4]), values[5], values[6:8]


def _edges(polygons, position):
    """Return the polygons' Edges, of no polygon where they are None, for agents at the positions (E, N, 2)."""
    if not isinstance(polygons, Edges):
        return polygon_edges(np.empty((len(position), 0, 1, 2)) if polygons is None else polygons, position)
    if polygons.origin.shape[1] != len(position):
        raise ValueError(f"polygons must belong to {len(position)} episodes, not to {polygons.origin.shape[1]}")
    return polygons


def _positive(name, value, least=np.finfo(np.float32).tiny, most=np.finfo(np.float32).max):
    """Return a single number as a float; raises ValueError, with its `name`, where it is out of range."""
    number = numbers(name, value)
    if number.ndim or not least <= number <= most:
        raise ValueError(f"{name} is {value!r}; it must be a finite number{' above 0' if least else ', 0 or more'}")
    return float(number)


# glibc keeps twice the size of the largest block that was ever freed, instead of giving all memory back after each
# step: with these 16 MB, a step takes a sixth less time. With other allocators, this does nothing.
np.empty(1 << 24, np.uint8)
