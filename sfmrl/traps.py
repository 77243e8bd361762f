"""Traps: places that no action leaves without a collision, and the choice of an action that leads into none."""

from dataclasses import replace

import numpy as np

from sfmrl.geometry import length
from sfmrl.rewards import COLLISION, RUNNING
from sfmrl.world import World, advance, crowd_velocities, transition

# Those that are tried where sequences of actions are: stop, and all headings at full speed and at 0.48 of it.
OUTLOOK = np.flatnonzero(np.isin(np.arange(81) % 5, (0, 3)))
ROUNDING = 1e-9  # m, more than a distance may be off by


def best_untrapped(
    world: World,
    crowd_velocity: np.ndarray,
    actions: np.ndarray,
    values: np.ndarray,
    outcome: np.ndarray,
    steps: int = 1,
) -> np.ndarray:
    """The most valuable actions (E,) that neither collide nor lead where every action (E, A, 2) does.

    `values` and `outcome` (E, A) are those of the actions. With more `steps`, actions are preferred after which `steps`
    others (of `OUTLOOK`) are possible without a collision. Where every free action leads into a trap, the most valuable
    of them; where every action collides, the most valuable of all.

    Every step is exact. A collision is judged by the velocities that people had before the step: those of the next are
    the `crowd_velocity` (E, N, 2) of this one, in m/s, and those after it are asked of the simulator.
    """
    safe = np.where(outcome == COLLISION, -np.inf, values)
    free = np.isfinite(safe).any(1)
    best = np.where(free, safe.argmax(1), values.argmax(1))
    watched = np.flatnonzero(free)
    for depth in range(1, steps + 1):
        left, pending, free = safe.copy(), watched, np.zeros(len(best), dtype=bool)
        following = actions if depth == 1 else actions[:, OUTLOOK]
        while len(pending):
            choice = left[pending].argmax(1)
            after = advance(world.take(pending), crowd_velocity[pending], actions[pending, choice])
            bad = (outcome[pending, choice] == RUNNING) & trapped(after, following[pending], depth)
            best[pending[~bad]] = choice[~bad]
            free[pending[~bad]] = True
            left[pending[bad], choice[bad]] = -np.inf
            pending = pending[bad]
            pending = pending[np.isfinite(left[pending]).any(1)]
        watched = watched[free[watched]]
    return best


def trapped(world: World, actions: np.ndarray, steps: int = 1) -> np.ndarray:
    """Whether all sequences of `steps` actions, of (E, A, 2) in m/s, collide, (E,) bool.

    To stop is taken to be one of the actions, so that squares alone trap nobody who has not run into one.
    """
    # Nobody can be met who is farther away than both can go.
    gap = world.gap - ROUNDING
    speed, own = length(world.velocity[:, 1:]), length(actions).max(1, initial=0.0)[:, None]
    collides = transition(world.among(gap < world.simulation.time_step * (speed + own)), actions).outcome == COLLISION
    lost = collides.all(1)
    if steps == 1:
        return lost
    later = np.maximum(speed, world.v_pref[:, 1:])
    near = (gap < steps * world.simulation.time_step * (later + own)) & ~world.square[:, 1:]
    doubtful = np.flatnonzero(~lost & near.any(1))
    before = world.take(doubtful)
    moves = crowd_velocities(before)
    row, action = np.nonzero(~collides[doubtful])
    first, then = actions[doubtful[row], action], actions[doubtful[row]]
    if steps == 2:  # edges are for ORCA, which the last step does not ask, and large
        before = replace(before, edges=before.edges.none())
    open_end = ~trapped(advance(before.take(row), moves[row], first), then, steps - 1)
    lost[doubtful] = True
    lost[doubtful[row[open_end]]] = False
    return lost
