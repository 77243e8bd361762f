"""Half-planes that keep agents clear of standing polygons.

Each edge of a polygon, widened by the agent's radius and divided by the time horizon, is a set of velocities that hit
it, its velocity obstacle: a segment as the near end (the cut-off), round corners, and two legs to infinity. The
half-plane touches that set where it is nearest to the agent's velocity. The agent alone is responsible, so nothing is
halved.

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, section 5.4. What the paper leaves open is
done as the authors' RVO2 library does it: an edge counts only for agents outside of it and within range, and only where
the half-planes of nearer edges do not cover it already; a leg that would cut into the neighbouring edge runs along that
edge and does not constrain. Of edges that are
equally near, as both sides of a corner often are, the one that stands earlier in RVO2's search tree goes first
(`polygons.py`). Left out: the tree's habit of splitting an edge in two along another one's line.

Pairs of an edge and an agent that it faces are listed one after the other, K in all, agent by agent and nearest first.
Vectors are (2, K); what a pair has for both ends of its edge, start and end, has one more axis for them, (2, 2, K).
"""

import numpy as np

from sfmrl.orca.polygons import FIELDS
from sfmrl.orca.vectors import INFINITY, det, dot, turn_left

COVERED = np.float32(1e-5)  # m/s by which a covered edge may stick out
SIDES = np.array([[1], [-1]], np.float32)  # an edge's start is at the left, its end at the right
FAR = np.int64(0x7F800000) << 16  # the sorting key of infinity
FEW = 4000  # pairs; with more, it pays to sort out those that the nearest edge covers first


def edge_half_planes(edges, agent, time_horizon):
    """Return the half-planes (4, K) of edges that count, the agents (K,) they are for, and the edges' ends (4, K).

    edges (15, S, E) are as in `Edges`, agent (6, C, E) is position, velocity, radius and maximum speed; float32, in m
    and m/s, time_horizon in s. Agents are numbered in the order of (C, E). The ends are x, y of start and end, in m,
    seen from the agent.
    """
    slots, episodes = edges.shape[1:]
    sight = _sights(edges, agent, np.float32(time_horizon))
    agent, edges = agent.reshape(6, -1), edges.reshape(FIELDS, -1)
    agents = agent.shape[1]
    episode = np.tile(np.arange(episodes), agents // episodes)
    squared = sight[-1]
    # To sort by: the distance (bits of positive floats are ordered as the floats are), and equally near edges in order.
    key = squared.view(np.int32).astype(np.int64) << 16
    key |= np.arange(slots)[:, None]

    def planes_of(slot, owner):
        seen = sight.reshape(len(sight), -1).take(slot * agents + owner, axis=1)
        outline = edges[4:12].take(slot * episodes + episode[owner], axis=1)
        planes, counts = _half_planes(seen, outline, agent[2:5].take(owner, axis=1), 1 / np.float32(time_horizon))
        counts = counts.nonzero()[0]
        return planes.take(counts, axis=1), slot[counts], owner[counts]

    left = squared < INFINITY
    found = []
    if left.size > FEW:
        nearest = key.min(axis=0)
        owner = (nearest < FAR).nonzero()[0]
        slot = nearest[owner] & 0xFFFF
        left.reshape(-1)[slot * agents + owner] = False
        planes, slot, owner = planes_of(slot, owner)
        found.append((planes, slot, owner))
        covering = np.zeros((4, agents), np.float32)
        covering[:, owner] = planes
        left &= ~covers(covering, sight[:4], agent[4], time_horizon)
    found.append(planes_of(*np.divmod(left.ravel().nonzero()[0], agents)))
    planes, slot, owner = (np.concatenate(parts, axis=-1) for parts in zip(*found, strict=True))
    pair = slot * agents + owner
    order = np.argsort(owner << 47 | key.reshape(-1)[pair])
    return planes.take(order, axis=1), owner[order], sight[:4].reshape(4, -1).take(pair[order], axis=1)


def uncovered(half_planes, owner, ends, radius, time_horizon):
    """Return each agent's half-planes (4, M, Q), nearest edge first, without those of edges that nearer ones cover.

    half_planes, owner and ends are those of `edge_half_planes`, radius (Q,) in m the agents', time_horizon in s. M is
    as large as the agent with the most half-planes needs.
    """
    agents, index = len(radius), np.arange(len(owner))
    first = _firsts(owner, agents)
    # All couples of a later and a nearer edge of the same agent.
    rank = index - first
    later = np.repeat(index, rank)
    nearer = first[later] + np.arange(len(later)) - (np.cumsum(rank) - rank)[later]
    covered = covers(half_planes.take(nearer, axis=1), ends.take(later, axis=1), radius[owner[later]], time_horizon)
    later, nearer = later[covered], nearer[covered]
    # An edge that is covered itself covers nothing: each round settles at least one more edge of every agent.
    kept, before = np.ones(len(owner), bool), None
    while not np.array_equal(kept, before):
        before, kept = kept, np.ones(len(owner), bool)
        kept[later[before[nearer]]] = False

    kept = kept.nonzero()[0]
    half_planes, owner = half_planes.take(kept, axis=1), owner[kept]
    row = np.arange(len(owner)) - _firsts(owner, agents)
    packed = np.zeros((4, int(row.max(initial=-1)) + 1, agents), np.float32)
    packed.reshape(4, -1)[:, row * agents + owner] = half_planes
    return packed


def covers(half_planes, ends, radius, time_horizon):
    """Return whether half-planes (4, ...) forbid whole edges, given by their ends (4, ...), widened by the radius."""
    point_x, point_y, direction_x, direction_y = half_planes
    start_x, end_x, start_y, end_y = ends
    reached = direction_y * point_x - direction_x * point_y - COVERED
    needed = reached * np.float32(time_horizon) + radius
    covered = direction_y * start_x - direction_x * start_y >= needed
    return covered & (direction_y * end_x - direction_x * end_y >= needed)


def _sights(edges, agent, time_horizon):
    """Return how edges look from agents, (7, S, C * E), and where they do not count, an infinite distance.

    The rows are x and y for start and end; where along the edge, from 0 to 1, the agent is; and the squared distances
    to the edge's line and to the edge. An edge does not count if it turns its back to the agent or is out of reach.
    """
    slots, episodes = edges.shape[1:]
    ends = edges[:4].reshape(2, 2, slots, 1, episodes)
    edge = ends[:, 1] - ends[:, 0]
    minus_squared = -dot(edge, edge)
    sight = np.empty((7, slots, *agent.shape[1:]), np.float32)
    at = sight[:4].reshape(2, 2, *sight.shape[1:])
    np.subtract(ends, agent[:2, None, None], out=at)
    along = np.divide(dot(at[:, 0], edge), minus_squared, out=sight[4])
    foot = at[:, 0] + along * edge
    line_squared = sight[5] = dot(foot, foot)
    to_start, to_end = dot(at, at)
    squared = np.where((along >= 0) & (along <= 1), line_squared, np.minimum(to_start, to_end))
    reach = time_horizon * agent[5] + agent[4]
    counts = (det(at[:, 0], edge) < 0) & (squared < reach * reach)
    sight[6] = np.where(counts, squared, INFINITY)
    return sight.reshape(7, slots, -1)


def _half_planes(sight, outline, agent, inverse):
    """Return the half-planes (4, K) of pairs of edges and agents, and whether they constrain (K,).

    sight (7, K) is as in `_sights`, outline (8, K) the edges' rows from 4 to 11, agent (3, K) velocity and radius.
    """
    velocity, radius = agent[:2], agent[2]
    radius_squared = radius * radius
    along, line_squared, squared = sight[4:]

    # An edge seen end-on counts as its nearer corner: that one is then both its left and its right end.
    end_on = line_squared <= radius_squared
    beyond = end_on & (along < 0), end_on & (along > 1)
    single = beyond[0] | beyond[1]
    corner, wall = sight[:4].reshape(2, 2, -1), outline[:4].reshape(2, 2, -1)
    convex, own = outline[4:6] > 0, outline[6:]
    for end in (0, 1):
        if len(seen := beyond[end].nonzero()[0]):
            corner[:, 1 - end, seen] = corner[:, end, seen]
            convex[1 - end, seen] = convex[end, seen]
            wall[:, 1 - end, seen] = own[:, seen] * -SIDES[1 - end]

    leg, foreign = _legs(corner, convex, radius, own, wall)
    half_planes, counts = _tangents(corner * inverse, velocity, leg, foreign, single, own, radius * inverse)

    # An agent that touches the edge must not come nearer: a half-plane through the origin. At the edge's end, the next
    # edge takes care of it if the agent faces that one, too.
    touching = squared <= radius_squared
    if len(touched := touching.nonzero()[0]):
        half_planes[:, touched] = _clear(corner[:, 0, touched], single[touched], own[:, touched])
    counts |= touching
    counts &= convex[0] | ~single
    counts &= ~(touching & beyond[1]) | (det(corner[:, 1], wall[:, 1]) >= 0)
    return half_planes, counts


def _legs(corner, convex, radius, own, wall):
    """Return the unit directions (2, 2, K) of the two legs, and whether they are foreign (2, K): do not constrain.

    A leg touches the disc around its corner, but runs along the edge where the outline turns inwards there, and along
    the neighbouring edge where it would cut into that.
    """
    squared = dot(corner, corner)
    length, side, scale = np.sqrt(squared - radius * radius), SIDES * radius, 1 / squared
    leg = np.empty_like(corner)
    np.multiply(corner[0] * length - corner[1] * side, scale, out=leg[0])
    np.multiply(corner[0] * side + corner[1] * length, scale, out=leg[1])
    end, pair = np.divmod((~convex).ravel().nonzero()[0], len(radius))
    leg[:, end, pair] = own[:, pair] * -SIDES[end, 0]
    foreign = convex & (det(leg, wall) * SIDES >= 0)
    return np.where(foreign, wall, leg), foreign


def _tangents(cut, velocity, leg, foreign, single, own, margin):
    """Return the half-planes (4, K) that touch the obstacles nearest to the velocities, and if they constrain (K,).

    An obstacle starts at the cut-off between the two ends of `cut`, goes on along the legs, and is `margin` wider.
    """
    towards = velocity[:, None] - cut
    up = dot(towards, leg)
    to_leg = velocity[:, None] - (cut + up * leg)
    to_leg = np.where(up < 0, INFINITY, dot(to_leg, to_leg))
    span = cut[:, 1] - cut[:, 0]
    across = dot(towards[:, 0], span) / dot(span, span)
    to_cut = velocity - (cut[:, 0] + across * span)
    to_cut = dot(to_cut, to_cut)

    left_corner = (up[0] < 0) & ((across < 0) | (single & (up[1] < 0)))
    right_corner = ~left_corner & (across > 1) & (up[1] < 0)
    at_corner = left_corner | right_corner
    on_cut = ~single & (across >= 0) & (across <= 1) & (to_cut <= to_leg[0]) & (to_cut <= to_leg[1])
    on_right = right_corner | (~left_corner & ~on_cut & (to_leg[1] < to_leg[0]))

    towards = np.where(on_right, towards[:, 1], towards[:, 0])
    towards *= 1 / np.sqrt(dot(towards, towards))
    direction = np.where(on_cut, -own, np.where(on_right, -leg[:, 1], leg[:, 0]))
    direction = np.where(at_corner, -turn_left(towards), direction)
    point = np.where(on_right, cut[:, 1], cut[:, 0]) + margin * turn_left(direction)
    counts = at_corner | on_cut | ~((on_right & foreign[1]) | (~on_right & foreign[0]))
    return np.concatenate([point, direction]), counts


def _clear(corner, single, own):
    """Return the half-planes (4, K) of velocities that lead away from the corners, where single, or the edges."""
    around = turn_left(corner) * (1 / np.sqrt(dot(corner, corner)))
    return np.concatenate([np.zeros_like(own), np.where(single, around, -own)])


def _firsts(owner, agents):
    """Return the index of the first pair of the same agent, for all pairs (K,), sorted by their owners (K,)."""
    count = np.bincount(owner, minlength=agents)
    return (np.cumsum(count) - count)[owner]
