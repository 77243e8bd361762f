"""Half-planes that keep agents clear of standing polygons.

Each edge of a polygon, widened by the agent's radius and divided by the time horizon, is a set of velocities that hit
it, its velocity obstacle: a segment as the near end (the cut-off), round corners, and two legs to infinity. The
half-plane touches that set where it is nearest to the agent's velocity. The agent alone is responsible, so nothing is
halved.

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, section 5.4. Details that the paper leaves
open follow the authors' RVO2 library, also the order of equally near edges, which both sides of a corner often are: the
one that comes first in RVO2's search tree goes first (`polygons.py`). Left out: that tree's splitting of edges.

Pairs of an edge and an agent that it faces are listed one after the other, K in all. Vectors are (2, K); what a pair
has for both ends of its edge, start (left) and end (right), has one more axis for them, (2, 2, K).
"""

import numpy as np

from sfmrl.orca.polygons import FIELDS
from sfmrl.orca.vectors import INFINITY, det, dot, turn_left, unit

COVERED = np.float32(1e-5)  # m/s by which a covered edge may stick out
SIDES = np.array([[1], [-1]], np.float32)  # an edge's start is at the left, its end at the right
NEAREST_FIRST = 4000  # pairs; with more, it pays to sort out those that the nearest edge covers first


def edge_half_planes(edges, agent, time_horizon):
    """Return the half-planes (4, K) of edges that count, the agents (K,) they are for, and the edges' ends (4, K).

    edges (12, S, E) are as in `Edges`, agent (6, C, E) is position, velocity, radius and maximum speed; float32, in m
    and m/s, time_horizon in s. Agents are numbered in the order of (C, E), and come in this order, each with its
    nearest edge first. The ends are x of start and end, and y of both, in m, seen from the agent.
    """
    episodes = edges.shape[2]
    sight = _sights(edges, agent, np.float32(time_horizon))
    agent, edges = agent.reshape(6, -1), edges.reshape(FIELDS, -1)
    agents, ends, squared = agent.shape[1], sight[:4], sight[6]

    def planes_of(slot, owner):
        seen = sight.reshape(len(sight), -1).take(slot * agents + owner, axis=1)
        outline = edges[4:].take(slot * episodes + owner % episodes, axis=1)
        planes, counts = _half_planes(seen, outline, agent[2:5].take(owner, axis=1), 1 / np.float32(time_horizon))
        counts = counts.nonzero()[0]
        return planes.take(counts, axis=1), slot[counts], owner[counts]

    remaining, parts = squared < INFINITY, []
    if remaining.size > NEAREST_FIRST:
        owner = remaining.any(axis=0).nonzero()[0]
        slot = squared.argmin(axis=0)[owner]
        remaining[slot, owner] = False
        parts.append(planes_of(slot, owner))
        planes, _, owner = parts[0]
        covering = np.zeros((4, agents), np.float32)
        covering[:, owner] = planes
        remaining &= ~covers(covering, ends, agent[4], time_horizon)
    parts.append(planes_of(*np.divmod(remaining.ravel().nonzero()[0], agents)))
    planes, slot, owner = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
    pair = slot * agents + owner
    # Sort by agent, distance and slot, all in one integer of 16 + 31 + 16 bits: positive floats are ordered as their
    # bits are, and a block has fewer than 2^16 agents.
    order = np.argsort(owner << 47 | squared.view(np.int32).ravel()[pair].astype(np.int64) << 16 | slot)
    return planes.take(order, axis=1), owner[order], ends.reshape(4, -1).take(pair[order], axis=1)


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
    # A covered edge covers no other itself: each round settles at least one more edge of every agent.
    stays, before = np.ones(len(owner), bool), None
    while not np.array_equal(stays, before):
        before, stays = stays, np.ones(len(owner), bool)
        stays[later[before[nearer]]] = False

    owner, half_planes = owner[stays], half_planes.compress(stays, axis=1)
    row = np.arange(len(owner)) - _firsts(owner, agents)
    packed = np.zeros((4, row.max(initial=-1) + 1, agents), np.float32)
    packed[:, row, owner] = half_planes
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

    The rows are x of start and end, y of both; where along the edge, from 0 to 1, the agent is; and the squared
    distances to the edge's line and to the edge.
    """
    slots, episodes = edges.shape[1:]
    ends = edges[:4].reshape(2, 2, slots, 1, episodes)
    edge = ends[:, 1] - ends[:, 0]
    sight = np.empty((7, slots, *agent.shape[1:]), np.float32)
    at = sight[:4].reshape(2, 2, *sight.shape[1:])
    np.subtract(ends, agent[:2, None, None], out=at)
    along = np.divide(dot(at[:, 0], edge), -dot(edge, edge), out=sight[4])
    foot = at[:, 0] + along * edge
    line_squared = sight[5] = dot(foot, foot)
    to_start, to_end = dot(at, at)
    # The nearest point is the foot of the perpendicular if that lies on the edge, and otherwise a corner.
    squared = np.where((along >= 0) & (along <= 1), line_squared, np.minimum(to_start, to_end))
    # The agent must be in front of the edge, and able to reach it within the time horizon.
    reach = time_horizon * agent[5] + agent[4]
    sight[6] = np.where((det(at[:, 0], edge) < 0) & (squared < reach * reach), squared, INFINITY)
    return sight.reshape(7, slots, -1)


def _half_planes(sight, outline, agent, inverse):
    """Return the half-planes (4, K) of pairs of edges and agents, and whether they constrain (K,).

    sight (7, K) is as in `_sights`, outline (8, K) the last rows of `Edges`, agent (3, K) velocity and radius.
    """
    corner, (along, line_squared, squared) = sight[:4].reshape(2, 2, -1), sight[4:]
    wall, convex, own = outline[:4].reshape(2, 2, -1), outline[4:6] > 0, outline[6:]
    velocity, radius = agent[:2], agent[2]
    radius_squared = radius * radius

    # The agent sees the edge end-on: only the nearer corner counts, as the left end and as the right end.
    end_on = line_squared <= radius_squared
    before_start, behind_end = end_on & (along < 0), end_on & (along > 1)
    single = before_start | behind_end
    for seen, near, far in ((before_start, 0, 1), (behind_end, 1, 0)):
        if len(seen := seen.nonzero()[0]):
            corner[:, far, seen] = corner[:, near, seen]
            convex[far, seen] = convex[near, seen]
            wall[:, far, seen] = own[:, seen] * -SIDES[far]

    leg, foreign = _legs(corner, convex, radius, own, wall)
    half_planes, counts = _tangents(corner * inverse, velocity, leg, foreign, single, own, radius * inverse)

    # The agent touches the edge, or its corner: it may move along it and away from it, but not nearer.
    touching = squared <= radius_squared
    if len(touched := touching.nonzero()[0]):
        half_planes[:2, touched] = 0
        around = unit(turn_left(corner[:, 0, touched]))
        half_planes[2:, touched] = np.where(single[touched], around, -own[:, touched])
    counts |= touching
    # The agent sees only a corner at which the outline turns inwards: the neighbouring edge stands before it.
    counts &= convex[0] | ~single
    # The agent touches the right corner and faces the next edge too: that edge takes care of it.
    counts &= ~(touching & behind_end) | (det(corner[:, 1], wall[:, 1]) >= 0)
    return half_planes, counts


def _legs(corner, convex, radius, own, wall):
    """Return the unit directions (2, 2, K) of the two legs, and whether they are foreign (2, K): do not constrain."""
    # The agent passes a corner along the tangent to the disc around it.
    squared = dot(corner, corner)
    length, side, scale = np.sqrt(squared - radius * radius), SIDES * radius, 1 / squared
    leg = np.empty_like(corner)
    np.multiply(corner[0] * length - corner[1] * side, scale, out=leg[0])
    np.multiply(corner[0] * side + corner[1] * length, scale, out=leg[1])
    # The outline turns inwards at this end: there is no corner to pass, and the edge goes on in its own direction.
    end, pair = np.divmod((~convex).ravel().nonzero()[0], len(radius))
    leg[:, end, pair] = own[:, pair] * -SIDES[end, 0]
    # The leg would cut into the neighbouring edge: it runs along that edge, whose own half-plane keeps the agent off.
    foreign = convex & (det(leg, wall) * SIDES >= 0)
    return np.where(foreign, wall, leg), foreign


def _tangents(cut, velocity, leg, foreign, single, own, margin):
    """Return the half-planes (4, K) that touch the obstacles nearest to the velocities, and if they constrain (K,).

    An obstacle starts at the cut-off between the two ends of `cut`, goes on along the legs, and is `margin` wider. In
    RVO2's names `across` is t, and `up` tLeft and tRight. Of equally near parts, cut-off, left leg and right leg come
    in this order; a leg counts only at up >= 0, and with a `single` corner there is no cut-off.
    """
    towards = velocity[:, None] - cut
    up = dot(towards, leg)
    to_leg = velocity[:, None] - (cut + up * leg)
    to_leg = np.where(up < 0, INFINITY, dot(to_leg, to_leg))
    span = cut[:, 1] - cut[:, 0]
    across = dot(towards[:, 0], span) / dot(span, span)
    to_cut = velocity - (cut[:, 0] + across * span)
    to_cut = dot(to_cut, to_cut)

    # The velocity is beyond an end of the cut-off and below the leg there: nearest to the round corner.
    left_corner = (up[0] < 0) & ((across < 0) | (single & (up[1] < 0)))
    right_corner = ~left_corner & (across > 1) & (up[1] < 0)
    at_corner = left_corner | right_corner
    # It is nearest to the cut-off if there is one and neither leg is nearer; of the legs, the nearer one counts.
    on_cut = ~single & (across >= 0) & (across <= 1) & (to_cut <= to_leg[0]) & (to_cut <= to_leg[1])
    on_right = right_corner | (~left_corner & ~on_cut & (to_leg[1] < to_leg[0]))

    outward = unit(np.where(on_right, towards[:, 1], towards[:, 0]))
    direction = np.where(on_cut, -own, np.where(on_right, -leg[:, 1], leg[:, 0]))
    direction = np.where(at_corner, -turn_left(outward), direction)
    point = np.where(on_right, cut[:, 1], cut[:, 0]) + margin * turn_left(direction)
    # Nearest to a foreign leg: the neighbouring edge has a half-plane of its own there.
    counts = at_corner | on_cut | ~np.where(on_right, foreign[1], foreign[0])
    return np.concatenate([point, direction]), counts


def _firsts(owner, agents):
    """Return the index of the first pair of the same agent, for all pairs (K,), sorted by their owners (K,)."""
    count = np.bincount(owner, minlength=agents)
    return (np.cumsum(count) - count)[owner]
