"""Traps: situations in which every action collides, and the choice of an action that leads into none.

The rule for one episode; `best_untrapped` and `trapped` compute it for many:

    for depth in (steps, ..., 2, 1):  # prefer the longer outlook
        for action in the actions that do not collide, the most valuable first:
            if the episode ends with it, or not trapped(the world after it, depth): return action
    return the most valuable action that does not collide; if all do, the most valuable of all

    trapped(world, depth): every action collides, or depth > 1 and trapped(the world after it, depth - 1)

Every step is exact. As in `transition`, a collision is judged by the velocities that people had before the step: in the
first step after the choice by their `crowd_velocity`, in later ones by what the simulator computes. A unicycle robot
has other actions after it has turned: the same, seen from itself.
"""

from dataclasses import replace

import numpy as np

from sfmrl.geometry import length
from sfmrl.rewards import COLLISION, RUNNING
from sfmrl.world import World, advance, crowd_velocities, transition, turned_actions

# Of the 81 actions (`actions.ACTIONS`: stop, then speeds 0 to 4 for each heading), those that are tried in sequences:
# stop, and all headings at 0.48 of full speed and at full speed.
OUTLOOK = np.append(0, 1 + np.flatnonzero(np.isin(np.arange(80) % 5, (2, 4))))
ROUNDING = 1e-9  # m, more than the error of a distance


def best_untrapped(
    world: World,
    crowd_velocity: np.ndarray,
    actions: np.ndarray,
    values: np.ndarray,
    outcome: np.ndarray,
    steps: int = 1,
) -> np.ndarray:
    """The index (E,) of each episode's most valuable action that neither collides nor leads into a trap.

    `actions` (E, A, 2) in m/s have `values` and `outcome` (E, A); `crowd_velocity` (E, N, 2) in m/s is everybody's in
    the coming step. A trap may be up to `steps` deep; sequences of two and more steps consist of actions in `OUTLOOK`.
    """
    safe = np.where(outcome == COLLISION, -np.inf, values)
    has_way_out = np.isfinite(safe).any(1)
    best = np.where(has_way_out, safe.argmax(1), values.argmax(1))
    # The shorter outlook first: if it finds no way out, the longer one finds none either.
    for depth in range(1, steps + 1):
        candidates, undecided = safe.copy(), np.flatnonzero(has_way_out)
        has_way_out = np.zeros(len(best), dtype=bool)
        following = actions if depth == 1 else actions[:, OUTLOOK]
        while len(undecided):
            choice = candidates[undecided].argmax(1)
            before = world.take(undecided)
            after = advance(before, crowd_velocity[undecided], actions[undecided, choice])
            later = turned_actions(following[undecided], before, after)
            bad = (outcome[undecided, choice] == RUNNING) & trapped(after, later, depth)
            best[undecided[~bad]] = choice[~bad]
            has_way_out[undecided[~bad]] = True
            candidates[undecided[bad], choice[bad]] = -np.inf
            undecided = undecided[bad]
            undecided = undecided[np.isfinite(candidates[undecided]).any(1)]
    return best


def trapped(world: World, actions: np.ndarray, steps: int = 1) -> np.ndarray:
    """Whether all sequences of `steps` actions, of (E, A, 2) in m/s, collide, (E,) bool.

    One of the actions must be to stand still: then squares alone trap no robot that does not overlap one.
    """
    # An element is out of reach if it is farther away than it and the robot can move together.
    gap = world.gap - ROUNDING
    speed, robot_speed = length(world.velocity[:, 1:]), length(actions).max(1, initial=0.0)[:, None]
    in_reach = gap < world.simulation.time_step * (speed + robot_speed)
    collides = transition(world.with_elements(in_reach), actions).outcome == COLLISION  # (E, A)
    lost = collides.all(1)
    if steps == 1:
        return lost
    later_speed = np.maximum(speed, world.v_pref[:, 1:])
    near = (gap < steps * world.simulation.time_step * (later_speed + robot_speed)) & ~world.square[:, 1:]
    doubtful = np.flatnonzero(~lost & near.any(1))  # in the other episodes the robot can stand still
    before = world.take(doubtful)
    moves = crowd_velocities(before)
    if steps == 2:  # the last step needs no ORCA, whose edges are slow to copy
        before = replace(before, edges=before.edges.none())
    row, action = np.nonzero(~collides[doubtful])  # every possible first action, in all doubtful episodes
    before = before.take(row)
    after = advance(before, moves[row], actions[doubtful[row], action])
    goes_on = ~trapped(after, turned_actions(actions[doubtful[row]], before, after), steps - 1)
    lost[doubtful] = True
    lost[doubtful[row[goes_on]]] = False
    return lost
