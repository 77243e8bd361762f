"""Two-dimensional linear programs over velocities, many at once.

Each program has M half-planes and a disc of radius `max_speed`. A half-plane is the left side of the directed line
(point, direction), so a velocity v violates it by det(direction, point - v) > 0. Half-planes come as one float32 array
(4, M, Q): point x, point y, direction x, direction y, then half-plane, then program; a half-plane of zeros constrains
nothing.

The paper adds one half-plane after the other. Here all programs take the same three steps instead:
1. the best velocity of the disc; if some half-plane forbids it,
2. the best velocity of the disc on the line that it violates most; if some half-plane forbids that one,
3. the best permitted velocity on each line violated by it. One of them is the optimum, for the way from the optimum to
   any velocity that is best under fewer constraints leads out of one of the half-planes that hold the optimum.

Where no velocity fits, the greatest violation of the soft half-planes is minimised. One of them, the carrier, is
violated most at that optimum, and being so is again a set of half-planes, those of its bisectors with the others: the
carrier's own violation is minimised in it by the same steps, the second taken twice, since many half-planes are
violated then. Every velocity violates at least one carrier.

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, sections 5.2 and 5.3; de Berg et al.,
"Computational Geometry", chapter 4. Left out: the random order of insertion, which only the paper's way needs.
"""

import numpy as np

from sfmrl.orca.vectors import INFINITY, dot, limit_speed, put, turn_left

OUT_OF_REACH = np.float32(1e6)  # m/s
ROUNDING = np.float32(1e-6)  # m/s
HUGE, TINY, TINIER = np.float32(1e38), np.float32(1e-20), np.float32(1e-30)


def nearest_velocities(half_planes, max_speed, preferred):
    """Return the permitted velocities (2, Q) nearest to the preferred ones, and whether there are any (Q,).

    half_planes (4, M, Q), max_speed (Q,) in m/s, preferred (2, Q) in m/s; all float32. Where there is none, the
    velocity is within the disc.
    """

    def wish(line, program):
        wish_x, wish_y = preferred.take(program, axis=1)
        return line[2] * (wish_x - line[0]) + line[3] * (wish_y - line[1])

    def cost(velocity, program):
        away_x, away_y = velocity - preferred.take(program, axis=1)
        return away_x * away_x + away_y * away_y

    return _optima(half_planes, max_speed, limit_speed(preferred, max_speed), wish, cost, crowded=False)


def least_violations(half_planes, n_hard, max_speed, velocity):
    """Return the velocities (2, Q) that violate the soft half-planes least, and whether there are any (Q,).

    The first n_hard of the half_planes (4, M, Q) are hard: never violated. max_speed (Q,) and any velocities (2, Q)
    within it, the fewer half-planes they violate the better, are in m/s; all float32.
    """
    # Every velocity that no hard half-plane forbids violates some carrier: take the one that leaves fewer to try.
    violated = violations(half_planes, velocity) > 0
    violated_at_rest = violations(half_planes, np.zeros((2, 1), np.float32)) > 0
    at_rest = violated_at_rest.sum(axis=0) < violated.sum(axis=0)
    if n_hard:
        at_rest |= violated[:n_hard].any(axis=0)
    violated ^= (violated ^ violated_at_rest) & at_rest
    _, carrier, owner = _lines_where(violated[n_hard:], half_planes[:, n_hard:])
    speed = max_speed[owner]
    normal_x, normal_y = normal = turn_left(carrier[2:])
    projected, possible = _bisectors(half_planes.take(owner, axis=2, mode="clip"), n_hard, carrier)

    def wish(line, program):
        return np.copysign(INFINITY, normal_x[program] * line[2] + normal_y[program] * line[3])

    def cost(velocity, program):
        return -(normal_x[program] * velocity[0] + normal_y[program] * velocity[1])

    best, feasible = _optima(projected, speed, normal * speed, wish, cost, crowded=True)
    fits = (feasible & possible).nonzero()[0]
    found = np.zeros(len(max_speed), bool)
    _keep_best(velocity, found, owner[fits], violations(carrier, best)[fits], best.take(fits, axis=1))
    return velocity, found


def violations(half_planes, velocity):
    """Return by how much, in m/s, each velocity (2, Q) lies outside each of its half-planes (4, M, Q) or (4, Q)."""
    if half_planes.ndim > velocity.ndim:
        velocity = velocity[:, None]
    sideways, excess = products = half_planes[:2] - velocity
    products *= half_planes[:1:-1]  # direction y, direction x
    excess -= sideways
    return excess


def _optima(half_planes, max_speed, velocity, wish, cost, *, crowded):
    """Return the best permitted velocities (2, Q), and whether there are any (Q,).

    `velocity` (2, Q) is the best within the disc alone. For lines (4, K) and their programs (K,), `wish` tells how far
    along the line the best velocity would be, and `cost` how bad velocities (2, K) are. `crowded` adds a step between
    the second and the third: the best on the line that is now violated most, within the one before. It pays where
    several half-planes are still violated; the others come to the same end without it.
    """
    feasible = np.ones(len(max_speed), bool)

    def settle(line, program, left, right):
        """Move to the best velocities between the ends of lines, and return which of the lines there are any on."""
        feasible[program] = fits = left <= right
        fits = fits.nonzero()[0]
        put(velocity, program[fits], _along(line, left, right, wish(line, program)).take(fits, axis=1))
        return fits

    first, line, program = _most_violated(violations(half_planes, velocity), half_planes)
    fits = settle(line, program, *_chord(line, max_speed[program]))
    used, program = first[fits], program[fits]
    excess = violations(half_planes, velocity)
    excess.reshape(-1)[used] -= ROUNDING  # by which a velocity on the line may violate it
    programs = np.arange(len(max_speed))
    if crowded:
        first = programs.copy()
        first[program] = used
        second, line, program = _most_violated(excess * feasible, half_planes)
        first = first[program]
        others = half_planes.reshape(4, -1).take(first, axis=1)[:, None]
        fits = settle(line, program, *_interval(line, others, max_speed[program]))
        programs = program[fits]
        half_planes = half_planes.take(programs, axis=2)
        excess = violations(half_planes, velocity.take(programs, axis=1))
        for used in (first, second):
            excess.reshape(-1)[used[fits] // len(max_speed) * len(fits) + np.arange(len(fits))] -= ROUNDING

    _, line, column = _lines_where(excess > 0, half_planes)
    program = programs[column]
    feasible[program] = False
    left, right = _interval(line, half_planes.take(column, axis=2, mode="clip"), max_speed[program])
    candidate = _along(line, left, right, wish(line, program))
    fits = (left <= right).nonzero()[0]
    program, candidate = program[fits], candidate.take(fits, axis=1)
    _keep_best(velocity, feasible, program, cost(candidate, program), candidate)
    return velocity, feasible


def _most_violated(excess, half_planes):
    """Return `_lines_where` a violation (M, Q) is its program's greatest, for the programs that have any."""
    most = excess.max(axis=0, initial=0)
    most[most <= 0] = np.nan
    return _lines_where(excess == most, half_planes)


def _lines_where(condition, half_planes):
    """Return where the condition (M, Q) holds (K,), the lines (4, K) there, and the programs (K,) whose they are."""
    chosen = condition.ravel().nonzero()[0]
    return chosen, half_planes.reshape(4, -1).take(chosen, axis=1), chosen % condition.shape[1]


def _along(line, left, right, wish):
    """Return the velocities (2, K) on lines (4, K) that are nearest to `wish` between their ends `left` and `right`."""
    return line[:2] + np.minimum(np.maximum(wish, left), right) * line[2:]


def _chord(line, max_speed):
    """Return the left and right ends (K,) of the part of lines (4, K) inside the disc, NaN where they miss it."""
    point = line[:2]
    middle = dot(point, line[2:])
    half = np.sqrt(middle * middle + max_speed * max_speed - dot(point, point))
    return -middle - half, half - middle


def _interval(line, others, max_speed):
    """Return the left and right ends (K,) of the permitted part of lines (4, K); it is empty unless left <= right.

    A line coincides with itself, and half-planes of zeros with everything: the tiny numbers make such pairs meet far
    away on the right. Other parallel lines meet far away on the side that permits or forbids everything.
    """
    sideways, sine = products = others[2:] * line[:1:-1, None]
    sine -= sideways
    sine += TINIER
    sideways, meeting = products = line[:2, None] - others[:2]
    products *= others[:1:-1]
    meeting -= sideways
    meeting += TINY
    meeting /= sine
    # Where the sine is positive, the meeting is a right end, and the guard drops out of the maximum.
    guard = np.multiply(sine, -HUGE, out=sine)
    left, right = _chord(line, max_speed)
    right = np.minimum(np.maximum(meeting, guard, out=sideways).min(axis=0, initial=INFINITY), right)
    left = np.maximum(np.minimum(meeting, guard, out=sideways).max(axis=0, initial=-INFINITY), left)
    return left, right


def _bisectors(half_planes, n_hard, line):
    """Return the half-planes (4, M, K) where each line (4, K) is the most violated soft one, and whether any may (K,).

    half_planes (4, M, K), all those of the line's program, are overwritten; the hard ones stay as they are.
    """
    soft = half_planes[:, n_hard:]
    none = (soft[2:] == 0).all(axis=0)
    sideways, more = soft[:2] * soft[:1:-1]  # both offsets from the origin
    more -= sideways
    more -= line[2] * line[1] - line[3] * line[0]
    more -= OUT_OF_REACH * none  # half-planes of zeros
    turn = soft[2:]
    turn -= line[2:, None]
    squared = dot(turn, turn)
    # Of two lines in the same direction, one is violated more everywhere.
    possible = ~((squared == 0) & (more > 0)).any(axis=0)
    squared += TINIER
    scale = 1 / np.sqrt(squared, out=squared)
    more *= scale
    turn *= scale
    np.multiply(more, turn[::-1], out=soft[:2])
    np.negative(soft[0], out=soft[0])
    return half_planes, possible


def _keep_best(velocity, found, program, cost, candidate):
    """Write each program's candidate (2, K) of the least cost (K,) into velocity (2, Q), and True into found (Q,)."""
    least = np.full(len(found), INFINITY)
    np.minimum.at(least, program, cost)
    best = (cost == least[program]).nonzero()[0]
    program = program[best]
    put(velocity, program, candidate.take(best, axis=1))
    found[program] = True
