"""Recovery: a robot that makes no progress follows the way around the squares until the straight way is free.

Stuck is a robot whose way to the goal (`planner.py`) has not become shorter by `stall_distance` within `stall_time`.
From then on it takes, in its policy's place, the action that shortens the way most, of those that neither collide nor
lead into a trap; once no square stands between it and the goal, its policy chooses again. A network's choice, too, is
held to look farther ahead for traps than in training, with the people's moves as the simulator will make them. This
is at play alone: nothing is learnt from it.
"""

import copy
from typing import Any

import numpy as np

from sfmrl.config import Planner
from sfmrl.geometry import closest_approach
from sfmrl.lookahead import ACTIONS, Policy
from sfmrl.rewards import COLLISION, SUCCESS
from sfmrl.traps import best_untrapped
from sfmrl.world import World, transition

TRAP_STEPS = 2  # after the one that is chosen


class RecoveringPolicy:
    """A policy that is helped out where it is stuck; what else it can do (`lookahead`, `attention`) stays its own.

    It remembers each episode's progress by the episode's row in the scenes, from the episode's first step on.
    """

    def __init__(self, policy: Policy, planner: Planner) -> None:
        self.policy, self.planner, self.original = policy, planner, policy
        if hasattr(policy, "trap_steps"):
            self.policy = copy.copy(policy)
            self.policy.trap_steps = TRAP_STEPS
        self._nearest = np.zeros(0)  # m, the way that was left when there was progress last
        self._since = np.zeros(0, dtype=int)  # the step of it
        self._stuck = np.zeros(0, dtype=bool)
        self.helped = np.zeros(0, dtype=bool)  # whether an episode has ever been stuck

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # whoever copies this asks before there is a policy
            raise AttributeError(name)
        return getattr(self.policy, name)

    def __call__(self, world: World, crowd_velocity: np.ndarray) -> np.ndarray:
        stuck = self.watch(world)
        action = np.empty((len(world), 2))
        for rows, choose in ((np.flatnonzero(~stuck), self.policy), (np.flatnonzero(stuck), way_out)):
            if len(rows):
                action[rows] = choose(world.take(rows), crowd_velocity[rows])
        return action

    def watch(self, world: World) -> np.ndarray:
        """Note how far the robots have come, and return which of them are stuck, (E,) bool."""
        e = world.episode
        self._make_room(e.max(initial=-1) + 1)
        first = world.steps == 0
        left = world.geodesic_distance(world.position[:, 0])
        nearer = first | (left <= self._nearest[e] - self.planner.stall_distance)
        self._nearest[e] = np.where(nearer, left, self._nearest[e])
        self._since[e] = np.where(nearer, world.steps, self._since[e])
        stalled = (world.steps - self._since[e]) * world.simulation.time_step >= self.planner.stall_time
        self._stuck[e] = stalled | (self._stuck[e] & ~first & ~straight_way_is_free(world, self.planner.inflation))
        self.helped[e] = self._stuck[e] | (self.helped[e] & ~first)
        return self._stuck[e]

    def watch_all(self, worlds: World) -> np.ndarray:
        """The same for one episode's worlds before each of its T steps, (T,) bool."""
        return np.concatenate([self.watch(worlds.take(np.array([t]))) for t in range(len(worlds))])

    def _make_room(self, episodes: int) -> None:
        """Let there be an entry for so many episodes."""
        for name in ("_nearest", "_since", "_stuck", "helped"):
            old = getattr(self, name)
            if len(old) < episodes:
                setattr(self, name, np.concatenate((old, np.zeros(episodes - len(old), dtype=old.dtype))))


def way_out(world: World, crowd_velocity: np.ndarray) -> np.ndarray:
    """The action (E, 2) in m/s that leads nearest to the goal, around squares, of those that are safe; a Policy."""
    actions = ACTIONS * world.v_pref[:, 0, None, None]  # (E, A, 2)
    outcome = transition(world, actions).outcome
    left = world.geodesic_distance(world.position[:, :1] + actions * world.simulation.time_step)
    left = np.where(outcome == SUCCESS, -1.0, np.where(outcome == COLLISION, np.inf, left))
    best = best_untrapped(world, crowd_velocity, actions, -left, outcome, TRAP_STEPS)
    return actions[np.arange(len(world)), best]


def straight_way_is_free(world: World, inflation: float) -> np.ndarray:
    """Whether the robot could go straight to its goal and keep `inflation` (m) from all squares, (E,) bool."""
    way = world.goal[:, :1] - world.position[:, :1]
    half, radius = (part[:, 1:] for part in world.shape)
    gap = closest_approach(world.position[:, 1:] - world.position[:, :1], -way, 1.0, half) - radius
    near = gap < world.radius[:, :1] + inflation
    return ~(near & world.square[:, 1:]).any(1)


def with_recovery(policy: Policy, planner: Planner) -> Policy:
    """The policy with the recovery that `planner` asks for, or without any."""
    own = policy.original if isinstance(policy, RecoveringPolicy) else policy
    return RecoveringPolicy(own, planner) if planner.recover else own
