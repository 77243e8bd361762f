"""Half-planes that keep agents clear of standing polygons.

Each edge of a polygon, widened by the agent's radius and divided by the time horizon, is a set of velocities that hit
it: a segment as the near end (the cut-off), round corners, and two legs to infinity. The half-plane touches that set
where it is nearest to the agent's velocity. The agent alone is responsible, so nothing is halved.

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, section 5.4. What the paper leaves open is
done as the authors' RVO2 library does it: an edge counts only for agents outside of it and within range, and only where
the half-planes of nearer edges do not cover it already; a leg that would cut into the neighbouring edge runs along that
edge and does not constrain. Left out: RVO2's search tree, which now and then splits an edge in two along another one's
line, and with it the order among edges that are exactly equally near (here: the order in which they were given).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sfmrl.linear_programs import INFINITY, bits, choose

COVERED = np.float32(1e-5)  # m/s by which a covered edge may stick out

FIELDS = 12
SIDES = np.array([[1], [-1]], np.float32)  # the left and the right end of an edge, as seen from outside


@dataclass(frozen=True)
class Edges:
    """The polygons' edges of E episodes: `values` is float32 (12, S, E), NaN from each episode's last edge on.

    The twelve rows, each pair for an edge's start and end: x; y (m); the unit direction, x; y, in which the outline goes
    on from there, away from this edge; whether the corner is convex (1 or 0); and last the edge's own direction x, y.
    Seen from outside, an edge of a counter-clockwise polygon starts at the left.
    """

    values: np.ndarray

    def __len__(self) -> int:
        return self.values.shape[2]

    def take(self, rows: np.ndarray) -> "Edges":
        """The edges of some of the episodes: an index array, a mask or a slice."""
        return Edges(self.values[:, :, rows])

    @staticmethod
    def concatenate(parts: Sequence["Edges"]) -> "Edges":
        """The episodes of all parts, one after the other."""
        most = max(part.values.shape[1] for part in parts)
        episodes = sum(len(part) for part in parts)
        values = np.full((FIELDS, most, episodes), np.nan, np.float32)
        first = 0
        for part in parts:
            values[:, : part.values.shape[1], first : first + len(part)] = part.values
            first += len(part)
        return Edges(values)


def polygon_edges(polygons: np.ndarray) -> Edges:
    """Return the edges of solid polygons (E, P, V, 2) in m, given counter-clockwise; absent vertices are NaN.

    Absent vertices come last in their polygon; two vertices make a wall. Raises ValueError for other shapes, for a
    polygon that is clockwise, and for one with a single vertex or with two equal vertices in a row.
    """
    polygons = np.asarray(polygons, np.float32)
    if polygons.ndim != 4 or polygons.shape[3] != 2:
        raise ValueError(f"polygons must have shape (E, P, V, 2), not {polygons.shape}")
    present = ~np.isnan(polygons).any(axis=3)
    if (present[:, :, 1:] & ~present[:, :, :-1]).any():
        raise ValueError("polygons: absent vertices (NaN) must come after a polygon's last vertex")

    count = present.sum(axis=2)
    episode, polygon, vertex = np.nonzero(present)
    size = count[episode, polygon]
    before, start, end, after = (polygons[episode, polygon, (vertex + shift) % size].T for shift in (-1, 0, 1, 2))
    _check_outlines(start, end, polygons[episode, polygon, 0].T, size, episode * polygons.shape[1] + polygon)
    previous, own, following = _unit(start - before), _unit(end - start), _unit(after - end)
    start_convex = (_det(start - before, end - start) >= 0) | (size == 2)
    end_convex = (_det(end - start, after - end) >= 0) | (size == 2)

    per_episode = count.sum(axis=1)
    slot = np.arange(len(episode)) - (np.cumsum(per_episode) - per_episode)[episode]
    values = np.full((FIELDS, per_episode.max(initial=0), len(polygons)), np.nan, np.float32)
    ends = [start[0], end[0], start[1], end[1], -previous[0], following[0], -previous[1], following[1]]
    values[:, slot, episode] = [*ends, start_convex, end_convex, *own]
    return Edges(values)


def _check_outlines(start, end, first, size, outline):
    """Raise ValueError for edges (2, K), numbered by their `outline`, that are no counter-clockwise polygons."""
    if (size == 1).any():
        raise ValueError("polygons: a polygon needs two vertices (a wall) or more, not one")
    if (start == end).all(axis=0).any():
        raise ValueError("polygons: two equal vertices in a row make an edge without a direction")
    twice_area = np.bincount(outline, _det(start - first, end - first))
    if (twice_area[outline[size > 2]] <= 0).any():
        raise ValueError("polygons: vertices must run counter-clockwise around a solid area")


def edge_half_planes(edges, agent, time_horizon):
    """Return the half-planes (4, K) of edges, the agents (K,) they are for, and the edges' distances (K,) and ends (4, K).

    edges (12, S, E) are as in `Edges`, agent (6, C, E) is position, velocity, radius and maximum speed; float32, in m
    and m/s, time_horizon in s. Agents are numbered in the order of (C, E). Distances are squared, in m^2; ends, in m/s,
    are how fast one would reach start and end of the edge at the time horizon.
    """
    edge, agent, owner = _facing(edges, agent)
    radius, inverse = agent[4], np.float32(1 / time_horizon)
    at = edge[:4].reshape(2, 2, -1) - agent[:2, None]  # x and y, start and end, pair
    corner_squared = _dot(at, at)
    edge_vector = np.stack([edge[1] - edge[0], edge[3] - edge[2]])
    along = -_dot(at[:, 0], edge_vector) / _dot(edge_vector, edge_vector)
    foot = at[:, 0] + along * edge_vector
    line_squared = _dot(foot, foot)
    before, behind = along < 0, along > 1
    squared = choose(bits(before), corner_squared[0], choose(bits(behind), corner_squared[1], line_squared))
    radius_squared = radius * radius
    touching = squared <= radius_squared
    reach = np.float32(time_horizon) * agent[5] + radius
    counts = squared < reach * reach

    # An edge seen end-on counts as its nearer corner: that one is then both its left and its right end.
    end_on = line_squared <= radius_squared
    corner, wall, convex, own = at.copy(), edge[4:8].reshape(2, 2, -1), edge[8:10] > 0, edge[10:]
    single = end_on & (before | behind)
    for here, there, seen in ((1, 0, end_on & before), (0, 1, end_on & behind)):
        seen = np.flatnonzero(seen)
        corner[:, here, seen] = at[:, there, seen]
        corner_squared[here, seen] = corner_squared[there, seen]
        convex[here, seen] = convex[there, seen]
        wall[:, here, seen] = own[:, seen] * -SIDES[here]

    leg, foreign = _legs(corner, corner_squared, convex, radius, own, wall)
    half_planes, constrains = _tangents(corner * inverse, agent[2:4], leg, foreign, single, own, radius * inverse)

    # An agent that touches the edge must not come nearer: a half-plane through the origin.
    touched = np.flatnonzero(touching)
    half_planes[:, touched] = _clear(corner[:, 0, touched], corner_squared[0, touched], single[touched], own[:, touched])
    # At its end, the next edge takes care of it if the agent faces that one, too.
    alone = ~(end_on & behind) | (_det(corner[:, 1], wall[:, 1]) >= 0)
    counts &= (convex[0] | ~single) & ((touching & alone) | (constrains & ~touching))
    counts = np.flatnonzero(counts)
    ends = (at * inverse).reshape(4, -1)
    return half_planes.take(counts, axis=1), owner[counts], squared[counts], ends.take(counts, axis=1)


def _facing(edges, agent):
    """Return the pairs of edges (12, K) and agents (6, K) outside of them, and the agents' numbers (K,)."""
    start_x, end_x, start_y, end_y = edges[:4, :, None]
    outside = (start_x - agent[0]) * (end_y - start_y) - (start_y - agent[1]) * (end_x - start_x) < 0
    agents, episodes = agent[0].size, edges.shape[2]
    slot = np.repeat(np.arange(len(outside)), np.count_nonzero(outside, axis=(1, 2)))
    owner = np.flatnonzero(outside) - slot * agents
    episode = np.tile(np.arange(episodes), agents // episodes)[owner]
    edge = edges.reshape(FIELDS, -1).take(slot * episodes + episode, axis=1)
    return edge, agent.reshape(len(agent), -1).take(owner, axis=1), owner


def _legs(corner, squared, convex, radius, own, wall):
    """Return the unit directions (2, 2, K) of the two legs, and whether they are foreign (2, K): do not constrain.

    A leg touches the disc around its corner, but runs along the edge where the outline turns inwards there, and along
    the neighbouring edge where it would cut into that.
    """
    length, side, scale = np.sqrt(squared - radius * radius), SIDES * radius, 1 / squared
    leg = np.empty_like(corner)
    np.multiply(corner[0] * length - corner[1] * side, scale, out=leg[0])
    np.multiply(corner[0] * side + corner[1] * length, scale, out=leg[1])
    end, pair = np.nonzero(~convex)
    leg[:, end, pair] = own[:, pair] * -SIDES[end, 0]
    foreign = convex & (_det(leg, wall) * SIDES >= 0)
    return choose(bits(foreign), wall, leg), foreign


def _tangents(cut, velocity, leg, foreign, single, own, margin):
    """Return the half-planes (4, K) that touch the velocity obstacles nearest to the velocities, and if they count (K,).

    The obstacle starts at the cut-off from cut[:, 0] to cut[:, 1], goes on along the legs and is `margin` wider.
    """
    towards = velocity[:, None] - cut
    up = _dot(towards, leg)
    to_leg = velocity[:, None] - (cut + up * leg)
    to_leg = choose(bits(up < 0), INFINITY, _dot(to_leg, to_leg))
    span = cut[:, 1] - cut[:, 0]
    across = _dot(towards[:, 0], span) / _dot(span, span)
    to_cut = velocity - (cut[:, 0] + across * span)
    to_cut = _dot(to_cut, to_cut)

    left_corner = (up[0] < 0) & ((across < 0) | (single & (up[1] < 0)))
    right_corner = ~left_corner & (across > 1) & (up[1] < 0)
    at_corner = left_corner | right_corner
    on_cut = ~single & (across >= 0) & (across <= 1) & (to_cut <= to_leg[0]) & (to_cut <= to_leg[1])
    on_right = right_corner | (~left_corner & ~on_cut & (to_leg[1] < to_leg[0]))

    right = bits(on_right)
    towards = choose(right, towards[:, 1], towards[:, 0])
    towards *= 1 / np.sqrt(_dot(towards, towards))
    direction = choose(bits(on_cut), -own, choose(right, -leg[:, 1], leg[:, 0]))
    direction = choose(bits(at_corner), np.stack([towards[1], -towards[0]]), direction)
    point = choose(right, cut[:, 1], cut[:, 0]) + margin * np.stack([-direction[1], direction[0]])
    counts = at_corner | on_cut | ~np.where(on_right, foreign[1], foreign[0])
    return np.concatenate([point, direction]), counts


def _clear(corner, squared, single, own):
    """Return the half-planes (4, K) of velocities that lead away from the corners, where single, or the edges."""
    around = np.stack([-corner[1], corner[0]]) * (1 / np.sqrt(squared))
    return np.concatenate([np.zeros_like(own), np.where(single, around, -own)])


def uncovered(half_planes, owner, squared, ends, margin):
    """Return each agent's half-planes (4, M, Q), nearest edge first, without those of edges that nearer ones cover.

    half_planes, owner, squared and ends are those of `edge_half_planes`, with the agents (Q,) whose radii would be
    covered at the speeds `margin` (Q,) at the time horizon. M is as large as the most crowded agent needs.
    """
    # One integer to sort by: the agent, the distance (bits of positive floats are ordered as the floats are), the edge.
    key = (owner << 31 | squared.view(np.int32)) << 17 | np.arange(len(owner))
    key.sort()
    pair, owner = key & 0x1FFFF, key >> 48
    agents = len(margin)
    count = np.bincount(owner, minlength=agents)
    rank = np.arange(len(owner)) - (np.cumsum(count) - count)[owner]
    point_x, point_y, *direction, start_x, end_x, start_y, end_y = _packed(
        np.concatenate([half_planes, ends]), pair, rank, owner, agents
    )
    most = len(point_x)
    needed = direction[1] * point_x - direction[0] * point_y + (margin - COVERED)
    later, nearer = np.tril_indices(most, -1)
    needed, direction_x, direction_y = (each.take(nearer, axis=0) for each in (needed, *direction))
    covered = direction_y * start_x.take(later, axis=0) - direction_x * start_y.take(later, axis=0) >= needed
    covered &= direction_y * end_x.take(later, axis=0) - direction_x * end_y.take(later, axis=0) >= needed
    present = np.arange(most)[:, None] < count
    for edge in range(1, most):
        first = edge * (edge - 1) // 2
        present[edge] &= ~(covered[first : first + edge] & present[:edge]).any(axis=0)

    kept = present[rank, owner]
    rank = np.cumsum(present, axis=0)[rank, owner] - 1
    return _packed(half_planes, pair[kept], rank[kept], owner[kept], agents)


def _packed(values, pair, row, column, width):
    """Return an array (F, M, width) with values[:, pair] (F, K) at row (K,) and column (K,), and zeros elsewhere."""
    height = int(row.max(initial=-1)) + 1
    source = np.full(height * width, values.shape[1])
    source[row * width + column] = pair
    padded = np.concatenate([values, np.zeros((len(values), 1), values.dtype)], axis=1)
    return padded.take(source, axis=1).reshape(len(values), height, width)


def _det(a, b):
    """Two-dimensional cross product of vectors (2, ...)."""
    return a[0] * b[1] - a[1] * b[0]


def _dot(a, b):
    """Scalar product of vectors (2, ...)."""
    return a[0] * b[0] + a[1] * b[1]


def _unit(vector):
    """Vectors (2, ...) scaled to length 1."""
    return vector * (1 / np.sqrt(vector[0] * vector[0] + vector[1] * vector[1]))
