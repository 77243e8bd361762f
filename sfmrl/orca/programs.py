"""Two-dimensional linear programs over velocities, many at once.

Each program has M half-planes and a disc of radius `max_speed`. A half-plane is the left side of the directed line
(point, direction), so a velocity v violates it by det(direction, point - v) > 0. Half-planes come as one float32 array
(4, M, Q): point x, point y, direction x, direction y, then half-plane, then program; a half-plane of zeros constrains
nothing.

The paper adds one half-plane after the other. Here all programs take the same three steps instead:
1. the best velocity of the disc; if some half-plane forbids it,
2. the best velocity of the disc on the line that it violates most; if some half-plane forbids that one,
3. the best permitted velocity on the line of each half-plane that it violates. One of them is the optimum: the optimum
   lies on the boundaries of some half-planes, and a velocity that is better under fewer constraints must violate one of
   these.

Where no velocity is permitted, the largest violation of a soft half-plane is minimised. At that minimum some
half-plane, the carrier, is violated most. The velocities at which a given carrier is violated most are again those that
half-planes permit, bounded by its bisectors with the others. So the same steps minimise the carrier's violation within
these; step 2 runs twice, since many half-planes are violated then. Every velocity violates some carrier most.

Source: van den Berg et al., "Reciprocal n-body collision avoidance", 2011, sections 5.2 and 5.3; de Berg et al.,
"Computational Geometry", chapter 4. Left out: the random order of insertion, which only the paper's way needs.
"""

import numpy as np

from sfmrl.orca.vectors import INFINITY, det, dot, limit_speed, turn_left

OUT_OF_REACH = np.float32(1e6)  # m/s
ROUNDING = np.float32(1e-6)  # m/s by which a velocity on a line may violate it
HUGE, TINY, TINIER = np.float32(1e38), np.float32(1e-20), np.float32(1e-30)


def nearest_velocities(half_planes, max_speed, preferred):
    """Return the permitted velocities (2, Q) nearest to the preferred ones, and whether there are any (Q,).

    half_planes (4, M, Q), max_speed (Q,) in m/s, preferred (2, Q) in m/s; all float32. Where there is none, the
    velocity is within the disc.
    """
    return _optima(half_planes, max_speed, limit_speed(preferred, max_speed), preferred, linear=False)


def least_violations(half_planes, n_hard, max_speed, velocity):
    """Return the velocities (2, Q) that violate the soft half-planes least, and whether there are any (Q,).

    The first n_hard of the half_planes (4, M, Q) are hard: never violated. max_speed (Q,) and any velocities (2, Q)
    within it, which are overwritten, are in m/s; all float32.
    """
    # Every velocity that no hard half-plane forbids violates some carrier: of the given one and rest, take the one that
    # leaves fewer half-planes to try.
    violated = violations(half_planes, velocity) > 0
    violated_at_rest = violations(half_planes, np.zeros((2, 1), np.float32)) > 0
    at_rest = violated_at_rest.sum(axis=0) < violated.sum(axis=0)
    at_rest |= violated[:n_hard].any(axis=0)
    violated = np.where(at_rest, violated_at_rest, violated)
    _, owner, carrier = _lines_where(violated[n_hard:], half_planes[:, n_hard:])
    speed, outward = max_speed[owner], turn_left(carrier[2:])
    bisectors, possible = _bisectors(half_planes.take(owner, axis=2), n_hard, carrier)
    best, feasible = _optima(bisectors, speed, outward * speed, outward, linear=True)
    fits = (feasible & possible).nonzero()[0]
    found = np.zeros(len(max_speed), bool)
    _keep_best(velocity, found, owner[fits], best.take(fits, axis=1), violations(carrier, best)[fits])
    return velocity, found


def violations(half_planes, velocity):
    """Return by how much, in m/s, each velocity (2, Q) lies outside each of its half-planes (4, M, Q) or (4, Q)."""
    if half_planes.ndim > velocity.ndim:
        velocity = velocity[:, None]
    sideways, excess = products = half_planes[:2] - velocity
    products *= half_planes[:1:-1]  # direction y, direction x
    excess -= sideways
    return excess


def _optima(half_planes, max_speed, velocity, aim, linear):
    """Return the best permitted velocities (2, Q), and whether there are any (Q,).

    The best are those nearest to `aim` (2, Q), or if `linear`, those farthest in its direction. `velocity` (2, Q) is
    the best within the disc alone, the result of step 1, and is overwritten.
    """
    feasible, (x, y) = np.ones(len(max_speed), bool), velocity

    def move(m, q, line, left, right):
        """Put programs q on the best places of their lines m between two ends; return those m and q that have any."""
        best, fits = _best_on(line, left, right, aim.take(q, axis=1), linear)
        feasible[q] = False
        m, q = m[fits], q[fits]
        feasible[q] = True
        x[q], y[q] = best
        return m, q

    # Step 2: the best on the line that is violated most.
    m, q, line = _most_violated(violations(half_planes, velocity), half_planes)
    m, q = move(m, q, line, *_chord(line, max_speed[q]))
    excess, programs = violations(half_planes, velocity), np.arange(len(max_speed))
    excess[m, q] -= ROUNDING
    if linear:
        # Once more, within the half-plane of the first line. Programs without a second one are settled.
        first = np.zeros(len(max_speed), int)
        first[q] = m
        m, q, line = _most_violated(excess * feasible, half_planes)
        m, q = move(m, q, line, *_interval(line, half_planes[:, first[q], q][:, None], max_speed[q]))
        programs, half_planes, column = q, half_planes.take(q, axis=2), np.arange(len(q))
        excess = violations(half_planes, velocity.take(q, axis=1))
        excess[m, column] -= ROUNDING
        excess[first[q], column] -= ROUNDING

    # Step 3: the best of the permitted parts of all lines that are still violated.
    _, column, line = _lines_where(excess > 0, half_planes)
    q = programs[column]
    feasible[q] = False
    left, right = _interval(line, half_planes.take(column, axis=2), max_speed[q])
    best, fits = _best_on(line, left, right, aim.take(q, axis=1), linear)
    q = q[fits]
    away = best - aim.take(q, axis=1)
    _keep_best(velocity, feasible, q, best, -dot(aim.take(q, axis=1), best) if linear else dot(away, away))
    return velocity, feasible


def _best_on(line, left, right, aim, linear):
    """Return the best velocities (2, F) between two ends (K,) of lines (4, K), and which of the lines have any (F,)."""
    wish = np.copysign(INFINITY, dot(aim, line[2:])) if linear else dot(aim - line[:2], line[2:])
    best = line[:2] + np.minimum(np.maximum(wish, left), right) * line[2:]
    fits = (left <= right).nonzero()[0]
    return best.take(fits, axis=1), fits


def _keep_best(velocity, found, program, candidate, cost):
    """Write each program's candidate (2, K) of the least cost (K,) into velocity (2, Q), and True into found (Q,)."""
    least = np.full(len(found), INFINITY)
    np.minimum.at(least, program, cost)
    best = (cost == least[program]).nonzero()[0]
    program, (x, y) = program[best], velocity
    found[program] = True
    x[program], y[program] = candidate.take(best, axis=1)


def _most_violated(excess, half_planes):
    """Return `_lines_where` a violation (M, Q) is its program's greatest, for the programs that have any."""
    most = excess.max(axis=0, initial=0)
    most[most <= 0] = np.nan
    return _lines_where(excess == most, half_planes)


def _lines_where(condition, half_planes):
    """Return the indices m and q (K,) at which the condition (M, Q) holds, and the lines (4, K) there."""
    chosen = condition.ravel().nonzero()[0]
    m = chosen // condition.shape[1]
    return m, chosen - m * condition.shape[1], half_planes.reshape(4, -1).take(chosen, axis=1)


def _chord(line, max_speed):
    """Return the left and right ends (K,) of the part of lines (4, K) inside the disc, NaN where they miss it."""
    point = line[:2]
    middle = dot(point, line[2:])
    half = np.sqrt(middle * middle + max_speed * max_speed - dot(point, point))
    return -middle - half, half - middle


def _interval(line, others, max_speed):
    """Return the left and right ends (K,) of the part of lines (4, K) that others (4, M, K) permit inside the disc.

    It is empty unless left <= right. Of the line point + t direction, a half-plane permits t sine <= offset, where
    sine = det(direction, its direction) and offset = det(its direction, point - its point). So t = offset / sine is a
    right end where sine > 0, else a left end. The tiny numbers put the end of parallel lines, of the line itself and of
    half-planes of zeros far away: to the right, where all is permitted, or to the left, where nothing is.
    """
    sine = det(line[2:, None], others[2:])
    sine += TINIER
    end = det(others[2:], line[:2, None] - others[:2])  # the offset
    end += TINY
    end /= sine
    none = np.multiply(sine, -HUGE, out=sine)  # for a right end no left end, and the reverse
    left, right = _chord(line, max_speed)
    right = np.minimum(np.maximum(end, none).min(axis=0, initial=INFINITY), right)
    left = np.maximum(np.minimum(end, none).max(axis=0, initial=-INFINITY), left)
    return left, right


def _bisectors(half_planes, n_hard, line):
    """Return the half-planes (4, M, K) where each line (4, K) is the most violated soft one, and whether any may (K,).

    half_planes (4, M, K), all those of the line's program, are overwritten; the hard ones stay as they are.
    """
    soft = half_planes[:, n_hard:]
    more = det(soft[2:], soft[:2]) - det(line[2:], line[:2])  # violated at rest
    more -= OUT_OF_REACH * (soft[2:] == 0).all(axis=0)  # half-planes of zeros
    turn = soft[2:] - line[2:, None]
    squared = dot(turn, turn)
    # Of two lines in the same direction, one is violated more everywhere.
    possible = ~((squared == 0) & (more > 0)).any(axis=0)
    squared += TINIER
    scale = 1 / np.sqrt(squared)
    more *= scale
    np.multiply(turn, scale, out=soft[2:])
    np.multiply(turn_left(soft[2:]), more, out=soft[:2])
    return half_planes, possible
