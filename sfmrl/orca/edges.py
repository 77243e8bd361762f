"""ORCA half-planes that keep agents clear of solid polygons, edge by edge.

The velocities at which an agent hits an edge within the time horizon are its velocity obstacle. The edge, divided by
the horizon and widened by the agent's radius, is the near end: the cut-off, with a round corner at either end. From the
corners, two legs run to infinity. The half-plane touches this set where it is nearest to the agent's velocity. The
agent alone is responsible, so nothing is halved.

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, section 5.4, and where the paper leaves
details open, the authors' RVO2 library. Of edges that are equally near, as the two at a corner often are, the one that
is earlier in RVO2's search tree goes first. Left out: polygons that move, outlines that cross themselves, and the
tree's habit of splitting an edge in two along another one's line.

Seen from outside, an edge starts at the left. Values for both its ends have an axis for them: x and y of start and end
are (2, 2, ...).
"""

from typing import NamedTuple

import numpy as np

from sfmrl.orca.agents import Agents
from sfmrl.orca.vectors import INFINITY, choose, det, dot, numbers, order_key, turn_left, unit

SPACING = 64.0  # m between possible origins; a power of two, so that subtracting one does not round
ON_LINE = np.float32(1e-5)  # m^2, twice the area between a line and an edge that lies on it
COVERED = np.float32(1e-5)  # m/s by which a covered edge may stick out
SIDES = np.array([[1], [-1]], np.float32)  # an edge's start is at the left, its end at the right


class Edges(NamedTuple):
    """The polygons' edges, at most S in each of E episodes: arrays that end in (S, E), NaN after the last one.

    ends: (2, 2, S, E) float32 m, relative to the episode's origin
    onward: (2, 2, S, E) float32, unit directions in which the outline goes on from either end, away from the edge
    convex: (2, S, E) bool, whether the outline turns outwards at either end
    direction: (2, S, E) float32, unit directions from start to end
    origin: (2, E) float64 m
    """

    ends: np.ndarray
    onward: np.ndarray
    convex: np.ndarray
    direction: np.ndarray
    origin: np.ndarray

    def take(self, rows: np.ndarray) -> "Edges":
        """The edges of some of the episodes: an index array, a mask or a slice."""
        return Edges(*(values[..., rows].copy() for values in self))

    def none(self) -> "Edges":
        """The same episodes without an edge."""
        return Edges(*(values[..., :0, :] for values in self[:-1]), self.origin)


def polygon_edges(polygons: np.ndarray, position: np.ndarray) -> Edges:
    """Return the edges of solid polygons (E, P, V, 2) in m, given counter-clockwise; absent vertices are NaN.

    Absent vertices come last in their polygon; two vertices make a wall. `position` (E, N, 2) in m is where the agents
    are who will see them, or where they start. Raises ValueError for other shapes, for vertices that are not finite,
    for a polygon that is clockwise, and for one with a single vertex or with two equal vertices in a row.
    """
    polygons = numbers("polygons", polygons)
    if polygons.ndim != 4 or polygons.shape[3] != 2:
        raise ValueError(f"polygons must have shape (E, P, V, 2), not {polygons.shape}")
    if len(polygons) != len(position):
        raise ValueError(f"polygons must belong to {len(position)} episodes, not to {len(polygons)}")
    if not polygons.shape[2]:
        polygons = np.empty((len(polygons), 0, 1, 2))
    origin = _origin_among(position)
    present = ~np.isnan(polygons).any(axis=3)
    with np.errstate(over="ignore", invalid="ignore"):
        polygons = (polygons - origin[:, None, None]).astype(np.float32)
    if not np.isfinite(polygons[present]).all():
        raise ValueError("polygons: vertices must be finite, or NaN where they are absent")
    if (present[:, :, 1:] & ~present[:, :, :-1]).any():
        raise ValueError("polygons: absent vertices (NaN) must come after a polygon's last vertex")

    # All edges one after the other, (K,), with the vertices around them.
    episode, polygon, vertex = np.nonzero(present)
    size = present.sum(axis=2)[episode, polygon]
    before, start, end, after = (polygons[episode, polygon, (vertex + shift) % size].T for shift in (-1, 0, 1, 2))
    _check_outlines(start, end, polygons[episode, polygon, 0].T, size, episode * polygons.shape[1] + polygon)
    turns = np.stack([det(start - before, end - start), det(end - start, after - end)])

    # Each episode's edges, in the order of RVO2's tree.
    count = present.sum(axis=(1, 2))
    listed = np.split(np.arange(len(episode)), np.cumsum(count)[:-1])
    slot = np.concatenate([np.argsort(_tree_order(start[:, edges], end[:, edges])) for edges in listed])

    def arranged(values, absent=np.float32(np.nan)):
        arrays = np.full((*values.shape[:-1], count.max(initial=0), len(count)), absent)
        arrays[..., slot, episode] = values
        return arrays

    return Edges(
        ends=arranged(np.stack([start, end], axis=1)),
        onward=arranged(np.stack([-unit(start - before), unit(after - end)], axis=1)),
        convex=arranged((turns >= 0) | (size == 2), absent=False),
        direction=arranged(unit(end - start)),
        origin=origin.T,
    )


def _origin_among(points):
    """Return the median of points (E, n, 2) in m, rounded to a multiple of 64 m, (E, 2); absent points are NaN.

    float32 has 7 digits, too few to tell people apart in map coordinates. Scenes near (0, 0) have it as their origin.
    """
    if not points.shape[1]:
        return np.zeros((len(points), 2))
    ordered = np.sort(points, axis=1)  # absent ones last
    middle = np.maximum((~np.isnan(ordered)).sum(axis=1, keepdims=True) - 1, 0) // 2
    origin = np.round(np.take_along_axis(ordered, middle, axis=1)[:, 0] / SPACING) * SPACING
    return np.nan_to_num(origin) + 0.0  # no -0, which would change the sign of a 0 when it is subtracted


def _check_outlines(start, end, first, size, outline):
    """Raise ValueError for edges (2, K), numbered by their `outline`, that are no counter-clockwise polygons."""
    if (size == 1).any():
        raise ValueError("polygons: a polygon needs two vertices (a wall) or more, not one")
    if (start == end).all(axis=0).any():
        raise ValueError("polygons: two equal vertices in a row make an edge without a direction")
    twice_area = np.bincount(outline, det(start - first, end - first))
    if (twice_area[outline[size > 2]] <= 0).any():
        raise ValueError("polygons: vertices must run counter-clockwise around a solid area")


def _tree_order(start, end):
    """Return the indices of one episode's edges (2, S) in the order of RVO2's search tree.

    The root is the edge whose line divides the others most evenly, of several the first. After it come the edges on
    the left of its line, as a tree of their own, and then those on its right. An edge that the line crosses, which RVO2
    splits, stays whole on the left.
    """
    # For each edge's line (rows), twice the areas that it spans with every edge's start and end: > 0 on its left.
    way, from_line = end - start, start[:, None] - start[:, :, None]
    areas = [det(way[:, :, None], to) for to in (from_line, from_line + way[:, None])]
    right = np.minimum(*areas) < -ON_LINE
    left = ~right | (np.maximum(*areas) > ON_LINE)
    np.fill_diagonal(left, False)
    order, trees = [], [np.arange(start.shape[1])]
    while trees:
        tree = trees.pop()
        if len(tree) > 1:
            lefts, rights = (side[tree].take(tree, axis=1).sum(axis=1) for side in (left, right))
            root = tree[(np.maximum(lefts, rights) * len(tree) + np.minimum(lefts, rights)).argmin()]
            trees += [tree[right[root, tree] & ~left[root, tree]], tree[left[root, tree]]]
            tree = [root]
        order.extend(tree)
    return order


def edge_half_planes(edges, agents, max_speed, time_horizon):
    """Return half-planes (4, K), one for each pair of an agent and an edge that counts for it, ends, keys and owners.

    max_speed (C, E) is in m/s, time_horizon in s. The ends (2, 2, K) are those of the edges in m, seen from the agents;
    keys (K,) are integers, lower for nearer edges; owners (K,) are the agents, numbered in the order of (C, E).
    """
    time_horizon = np.float32(time_horizon)
    sights, counts = _sights(edges, agents, time_horizon * max_speed + agents.radius)
    # From here on for pairs alone, given by their numbers in (S, C, E), and those of edges in (S, E), agents in (C, E).
    pair = counts.ravel().nonzero()[0]
    slot, owner = np.divmod(pair, max_speed.size)
    edge = slot * max_speed.shape[1] + owner % max_speed.shape[1]
    ends, along, line_squared, squared = _pick(sights, pair, axes=3)
    edges, agents = Edges(*_pick(edges[:-1], edge, axes=2), edges.origin), Agents(*_pick(agents, owner, axes=2))
    half_planes, counts = _half_planes(ends, along, line_squared, squared, edges, agents, 1 / time_horizon)
    return _pick((half_planes, ends, order_key(squared, slot), owner), counts.nonzero()[0], axes=1)


def _pick(arrays, index, axes):
    """Return the values (..., K) of arrays at an index (K,) into their last `axes`, taken as one axis."""
    return [values.reshape(*values.shape[:-axes], -1).take(index, axis=-1) for values in arrays]


def _sights(edges, agents, reach):
    """Return where edges are, seen from agents, and whether they count for agents with a `reach` (C, E) in m.

    Four arrays that end in (S, C, E) say where: both ends (2, 2, ...) in m; how far along the edge the agent is, from 0
    at its start to 1 at its end; and the squared distances in m^2 to the edge's line and to the edge.
    """
    ends = edges.ends[..., None, :] - agents.position[:, None, None]
    start, way = ends[:, 0], (edges.ends[:, 1] - edges.ends[:, 0])[..., None, :]
    along = dot(start, way) / -dot(way, way)
    foot = start + along * way
    line_squared = dot(foot, foot)
    squared = choose((along >= 0) & (along <= 1), line_squared, np.minimum(*dot(ends, ends)))
    # The agent is on the edge's outer side, and can reach it within the time horizon.
    counts = (det(start, way) < 0) & (squared < reach * reach)
    return (ends, along, line_squared, squared), counts


def uncovered(half_planes, ends, key, owner, chosen, radius, time_horizon):
    """Return the half-planes (4, M, Q) of the chosen agents, nearest edge first, but not those that nearer ones cover.

    The first four are from `edge_half_planes`, chosen (C * E,) is a mask, radius (Q,) of those chosen is in m,
    time_horizon in s. M is as large as the agent with the most half-planes needs; the others have zeros.
    """
    pair = chosen[owner].nonzero()[0]
    column = (np.cumsum(chosen) - 1)[owner[pair]]
    pair = pair[np.argsort(column << 47 | key[pair])]  # agent by agent, and then nearest first; keys have 47 bits
    pair, kept = _in_columns(pair, np.bincount(column, minlength=len(radius)))
    # A half-plane covers an edge where it forbids both ends, widened by the radius: (nearer, farther, Q).
    lines, ends = half_planes.take(pair, axis=1), ends.take(pair, axis=-1)
    needed = (det(lines[:2], lines[2:]) - COVERED) * np.float32(time_horizon) + radius
    covers = (det(ends[:, :, None], lines[2:, None, :, None]) >= needed[:, None]).all(axis=0)
    for k in range(1, len(kept)):
        kept[k] &= ~(covers[:k, k] & kept[:k]).any(axis=0)  # an edge that is covered itself covers nothing
    pair, kept = _in_columns(pair.T[kept.T], kept.sum(axis=0))
    return choose(kept, half_planes.take(pair, axis=1), np.float32(0))


def _in_columns(listed, count):
    """Return a list, column by column, as an array (M, Q), and its mask: each column has `count` (Q,) of the values."""
    rank = np.arange(count.max(initial=0))[:, None]
    return listed.take(np.cumsum(count) - count + rank, mode="clip"), rank < count


def _half_planes(ends, along, line_squared, squared, edges, agents, rate):
    """Return the half-planes (4, K) of pairs of edges and agents, and whether they constrain (K,).

    The first four are as in `_sights`, rate is 1 / time_horizon.
    """
    corner, onward, convex, direction = ends.copy(), edges.onward, edges.convex, edges.direction
    # The agent is beyond an end and sees the edge all but end-on: that corner alone is the obstacle, as both its left
    # and its right end, and on one side the outline goes on with the edge itself.
    end_on = line_squared <= agents.radius * agents.radius
    beyond = end_on & (along < 0), end_on & (along > 1)
    single = beyond[0] | beyond[1]
    for end, other in ((0, 1), (1, 0)):
        np.copyto(corner[:, other], corner[:, end], where=beyond[end])
        np.copyto(convex[other], convex[end], where=beyond[end])
        np.copyto(onward[:, other], direction * SIDES[end], where=beyond[end])

    leg, foreign = _legs(corner, convex, onward, direction, agents.radius)
    cut, margin = corner * rate, agents.radius * rate
    half_planes, counts = _tangents(cut, margin, agents.velocity, leg, foreign, direction, single)

    # The agent touches the edge: it must not come nearer to the corner, if it sees that alone, or else to the edge.
    touching = squared <= agents.radius * agents.radius
    away = choose(single, unit(turn_left(corner[:, 0])), -direction)
    half_planes = choose(touching, np.concatenate([np.zeros_like(away), away]), half_planes)
    counts |= touching
    # It sees only a corner at which the outline turns inwards: the neighbouring edge is in front and counts instead.
    counts &= convex[0] | ~single
    # It touches the end's corner and is on the outer side of the next edge, too: that one counts instead.
    counts &= ~(touching & beyond[1]) | (det(corner[:, 1], onward[:, 1]) >= 0)
    return half_planes, counts


def _legs(corner, convex, onward, direction, radius):
    """Return the unit directions (2, 2, K) of the two legs, and whether they are foreign (2, K): do not constrain."""
    # A leg touches the disc around its corner.
    squared = dot(corner, corner)
    leg = (corner * np.sqrt(squared - radius * radius) + turn_left(corner) * (SIDES * radius)) * (1 / squared)
    # Where the outline turns inwards there is no way past the corner: the leg prolongs the cut-off.
    leg = choose(convex, leg, direction[:, None] * -SIDES)
    # It would cut into the neighbouring edge: it runs along that one, whose own half-plane does the constraining.
    foreign = convex & (det(leg, onward) * SIDES >= 0)
    return choose(foreign, onward, leg), foreign


def _tangents(cut, margin, velocity, leg, foreign, direction, single):
    """Return the half-planes (4, K) that touch the obstacles nearest to the velocities, and if they constrain (K,).

    An obstacle starts with the cut-off between the two ends of `cut`, goes on along the legs, and is `margin` wider.
    """
    # How far up either leg the velocity lies, how far across the cut-off, and at what squared distances from them.
    towards = velocity[:, None] - cut
    up = dot(towards, leg)
    to_leg = velocity[:, None] - (cut + up * leg)
    to_leg = choose(up < 0, INFINITY, dot(to_leg, to_leg))
    span = cut[:, 1] - cut[:, 0]
    across = dot(towards[:, 0], span) / dot(span, span)
    to_cut = velocity - (cut[:, 0] + across * span)
    to_cut = dot(to_cut, to_cut)

    # The velocity lies beyond an end of the cut-off, and below the leg there: the round corner is nearest.
    left_corner = (up[0] < 0) & ((across < 0) | (single & (up[1] < 0)))
    right_corner = ~left_corner & (across > 1) & (up[1] < 0)
    at_corner = left_corner | right_corner
    # Else the nearest of cut-off, left leg and right leg counts; a single corner has no cut-off.
    on_cut = ~single & (across >= 0) & (across <= 1) & (to_cut <= to_leg[0]) & (to_cut <= to_leg[1])
    on_right = right_corner | (~left_corner & ~on_cut & (to_leg[1] < to_leg[0]))

    along = choose(on_cut, -direction, choose(on_right, -leg[:, 1], leg[:, 0]))
    along = choose(at_corner, -turn_left(unit(choose(on_right, towards[:, 1], towards[:, 0]))), along)
    point = choose(on_right, cut[:, 1], cut[:, 0]) + margin * turn_left(along)
    counts = at_corner | on_cut | ~np.where(on_right, foreign[1], foreign[0])
    return np.concatenate([point, along]), counts
