"""Recovery: a robot that makes no progress follows the shortest path around the squares until the straight way is free.

A robot is stuck when its path to the goal (`planner.py`) has not shrunk by `stall_distance` within `stall_time`. From
then on recovery takes, in the policy's place, the action that shortens the path most, of those that neither collide nor
lead into a trap. Once no square stands between the robot and its goal, the policy chooses again. Recovery also makes a
network look farther ahead for traps than in training. It is used in tests and replays, never in training.
"""

import copy
from typing import Any

import numpy as np

from sfmrl.actions import ACTIONS, Notes, Policy, explained, robot_actions
from sfmrl.config import Planner, Simulation
from sfmrl.geometry import closest_approach, wrapped
from sfmrl.lookahead import SarlPolicy
from sfmrl.own_code import OwnPolicy, checked_action
from sfmrl.recovery.planner import Geodesics, plan
from sfmrl.rewards import COLLISION, SUCCESS
from sfmrl.scenes import Scenes
from sfmrl.traps import best_untrapped
from sfmrl.world import TURN_RATE, World, transition, turned

TRAP_STEPS = 2  # steps after the chosen action that must be possible without a collision


class RecoveringPolicy:
    """Wrap a policy and take over while the robot is stuck; all other attributes are those of the wrapped policy.

    `original` is the policy as given; `helped` (E,) marks episodes of the latest play in which the robot was stuck.
    """

    def __init__(self, policy: Policy, planner: Planner) -> None:
        self.policy, self.planner, self.original = policy, planner, policy
        network = policy.own if isinstance(policy, OwnPolicy) else policy
        if isinstance(network, SarlPolicy):
            farther = copy.copy(network)
            farther.trap_steps = TRAP_STEPS
            self.policy = policy.around(farther) if isinstance(policy, OwnPolicy) else farther
        self._geodesics: Geodesics | None = None
        self.helped = np.zeros(0, dtype=bool)

    def __repr__(self) -> str:
        return f"RecoveringPolicy({self.original!r})"

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # copy.copy() looks up dunders before __init__ has run
            raise AttributeError(name)
        return getattr(self.policy, name)

    def begin(self, scenes: Scenes, simulation: Simulation) -> None:
        """Plan the paths around the squares of all scenes, and forget the progress of earlier plays."""
        if hasattr(self.policy, "begin"):
            self.policy.begin(scenes, simulation)
        reach = simulation.longest * simulation.time_step * scenes.v_pref[:, 0]
        self._geodesics = plan(scenes, self.planner, reach)
        self._left = np.full(len(scenes), np.inf)  # m, the path's length at the latest progress
        self._since = np.zeros(len(scenes), dtype=int)  # the step of that progress
        self._stuck = np.zeros(len(scenes), dtype=bool)
        self.helped = np.zeros(len(scenes), dtype=bool)

    def __call__(self, world: World, crowd_velocity: np.ndarray) -> np.ndarray:
        stuck = self.watch(world)
        action = np.empty((len(world), 2))
        for rows, choose in ((np.flatnonzero(~stuck), self.policy), (np.flatnonzero(stuck), self.way_out)):
            if len(rows):
                chosen = choose(world.take(rows), crowd_velocity[rows])
                action[rows] = checked_action(choose, chosen, len(rows))
        return action

    def explain(self, world: World, crowd_velocity: np.ndarray) -> tuple[np.ndarray, Notes]:
        """The call's actions, and the policy's own notes with whether each robot is `stuck`."""
        stuck = self.watch(world)
        action, notes = explained(self.policy, world, crowd_velocity)
        action = checked_action(self.policy, action, len(world)).copy()
        if stuck.any():
            action[stuck] = self.way_out(world.take(np.flatnonzero(stuck)), crowd_velocity[stuck])
        return action, notes | {"stuck": stuck}

    def watch(self, world: World) -> np.ndarray:
        """Record the robots' progress, and return which of them are stuck, (E,) bool."""
        e = world.episode
        left = self.path_length(world, world.position[:, 0])
        nearer = left <= self._left[e] - self.planner.stall_distance
        self._left[e] = np.where(nearer, left, self._left[e])
        self._since[e] = np.where(nearer, world.steps, self._since[e])
        stalled = (world.steps - self._since[e]) * world.simulation.time_step >= self.planner.stall_time
        self._stuck[e] = stalled | (self._stuck[e] & ~straight_way_is_free(world, self.planner.inflation))
        self.helped[e] |= self._stuck[e]
        return self._stuck[e]

    def way_out(self, world: World, crowd_velocity: np.ndarray) -> np.ndarray:
        """The action (E, 2) in m/s after which the path to the goal is shortest, of those that are safe."""
        actions = robot_actions(world)  # (E, A, 2)
        outcome = transition(world, actions).outcome
        left = self.path_length(world, world.position_after(actions))
        if world.heading is not None:
            left = left + self.turns_left(world, actions)
        left = np.where(outcome == SUCCESS, -1.0, np.where(outcome == COLLISION, np.inf, left))
        best = best_untrapped(world, crowd_velocity, actions, -left, outcome, TRAP_STEPS)
        return actions[np.arange(len(world)), best]

    def turns_left(self, world: World, actions: np.ndarray) -> np.ndarray:
        """How far a unicycle could go while it turns to where the path leads, after each action (E, A, 2): (E, A) m."""
        moves = ACTIONS * world.v_pref[:, 0, None, None]
        shortest = self.path_length(world, world.position_after(moves)).argmin(1)
        x, y = moves[np.arange(len(world)), shortest].T[..., None]
        return world.v_pref[:, :1] * np.abs(wrapped(turned(world, actions) - np.arctan2(y, x))) / TURN_RATE

    def path_length(self, world: World, position: np.ndarray) -> np.ndarray:
        """How far it is from positions (E, ..., 2) to the robot's goal around the squares, (E, ...) m."""
        if self._geodesics is None:
            raise ValueError("recovery has planned no paths; call begin(scenes, simulation) before the first step")
        return self._geodesics.at(world.episode, position)


def straight_way_is_free(world: World, inflation: float) -> np.ndarray:
    """Whether the robot could go straight to its goal and keep `inflation` (m) from all squares, (E,) bool."""
    way = world.goal[:, :1] - world.position[:, :1]
    half, radius = (part[:, 1:] for part in world.half_and_radius)
    gap = closest_approach(world.position[:, 1:] - world.position[:, :1], -way, 1.0, half) - radius
    near = gap < world.radius[:, :1] + inflation
    return ~(near & world.square[:, 1:]).any(1)


def with_recovery(policy: Policy, planner: Planner) -> Policy:
    """The policy with recovery if `planner.recover`, else without; recovery that it already has is removed first."""
    own = policy.original if isinstance(policy, RecoveringPolicy) else policy
    return RecoveringPolicy(own, planner) if planner.recover else own
