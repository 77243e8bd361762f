"""The robot's 81 actions, and which of them lead into a trap: a place that no action leaves without a collision."""

from dataclasses import replace

import numpy as np

from sfmrl.crowd import World, advance, transition
from sfmrl.geometry import length
from sfmrl.rewards import COLLISION, RUNNING


def _actions() -> np.ndarray:
    """CRI's 81 actions as shares of v_pref: stop, then 16 headings with 5 speeds (e^(i/5) - 1) / (e - 1) each."""
    speeds = (np.exp(np.arange(1, 6) / 5) - 1) / (np.e - 1)
    headings = np.arange(16) * (2 * np.pi / 16)
    moves = speeds[None, :, None] * np.stack((np.cos(headings), np.sin(headings)), -1)[:, None]
    return np.concatenate((np.zeros((1, 2)), moves.reshape(80, 2)))


ACTIONS = _actions()
# Those that are tried where sequences of actions are: stop, and all headings at full speed and at 0.48 of it.
OUTLOOK = np.flatnonzero(np.isin(np.arange(81) % 5, (0, 3)))
FORESEEN = 0.1  # m: how far the robot keeps from where people will be if they go straight on


def best_untrapped(
    world: World,
    crowd_velocity: np.ndarray,
    actions: np.ndarray,
    values: np.ndarray,
    outcome: np.ndarray,
    steps: int = 1,
) -> np.ndarray:
    """The most valuable actions (E,) that neither collide nor lead where every action (E, A, 2) does.

    `values` and `outcome` (E, A) are those of the actions. With more `steps`, actions are preferred that so many others
    (of `OUTLOOK`) can follow without a collision. The most valuable of all where none is free.

    The first step is exact without another one of the crowd: a collision is judged by the velocities that people had
    before the step, and those of the next step are the `crowd_velocity` (E, N, 2) of this one.
    """
    best = values.argmax(1)
    safe = np.where(outcome == COLLISION, -np.inf, values)
    watched = np.flatnonzero(outcome[np.arange(len(best)), best] == RUNNING)
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


def trapped(world: World, actions: np.ndarray, steps: int = 1, margin: float = 0.0) -> np.ndarray:
    """Whether all sequences of `steps` actions (E, A, 2) collide if people keep their velocities, (E,) bool.

    To come closer to a person than `margin` (m) is a collision, too; from the second step on, which is a guess, than
    `FORESEEN`.
    """
    step = transition(world, actions)
    collides = step.outcome == COLLISION
    if margin:
        people = np.where(world.square[:, None, 1:], np.inf, step.separations)
        collides |= people.min(axis=-1, initial=np.inf) < margin
    lost = collides.all(1)
    if steps == 1:
        return lost
    # Nobody can be met who is farther away than both can go.
    gap = length(world.position[:, 1:] - world.position[:, :1]) - world.radius[:, 1:] - world.radius[:, :1]
    reach = steps * world.simulation.time_step * (length(world.velocity[:, 1:]) + world.v_pref[:, :1]) + FORESEEN
    doubtful = np.flatnonzero(~lost & ((gap < reach) & ~world.square[:, 1:]).any(1))
    row, action = np.nonzero(~collides[doubtful])
    first, then = actions[doubtful[row], action], actions[doubtful[row]]
    before = replace(world, edges=world.edges.none()).take(doubtful[row])  # edges are for ORCA, and large
    open_end = ~trapped(advance(before, before.velocity, first), then, steps - 1, FORESEEN)
    lost[doubtful] = True
    lost[doubtful[row[open_end]]] = False
    return lost
