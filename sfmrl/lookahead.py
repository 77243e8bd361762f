"""SARL's choice: look one step ahead with every action, and take the one with the highest reward plus value.

The people's next states come from the simulator, as in CrowdNav. They do not depend on the robot's action, so one step
of the crowd serves all 81.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache

import numpy as np

from sfmrl.actions import Notes, robot_actions
from sfmrl.config import Config, ConfigError, Simulation
from sfmrl.fast import as_fast
from sfmrl.rewards import COLLISION, reward_terms, total
from sfmrl.states import OWN, elements_within, robot_states, states_of
from sfmrl.traps import best_untrapped
from sfmrl.world import TURN_RATE, World, transition, turned

BLOCK = 4  # episodes at most whose actions are valued together, so that the arrays stay in the processor's cache


@dataclass(frozen=True)
class Lookahead:
    """What SARL chooses from: the 81 actions (E, A, 2) in m/s, their values (E, A), and the index of the best (E,)."""

    actions: np.ndarray
    values: np.ndarray
    best: np.ndarray

    @property
    def action(self) -> np.ndarray:
        """The best actions, (E, 2) m/s."""
        return self.actions[np.arange(len(self.best)), self.best]


class SarlPolicy:
    """Takes the action with the highest reward plus discounted value of the state after it; a `Policy`.

    `network` is a FastNetwork, or a ValueNetwork to make one of; `config` sets the reward, the discount and the state.
    Blocks of episodes are spread over `threads` threads; the numbers do not depend on how. Raises ConfigError if the
    columns of the network are not those of the config's `forces`.
    """

    batch = 32  # episodes side by side: the network takes most of the time, and larger batches would not reduce it

    def __init__(self, network, config: Config, threads: int = 1) -> None:
        self.network, self.config, self.threads = as_fast(network), config, threads
        if self.network.forces != config.forces:
            differ = f"the config has forces {config.forces}, the network {self.network.forces}"
            raise ConfigError(f"{differ}; give the config that the network was trained with")
        self.trap_steps = int(config.careful)  # how many steps deep the traps are that it avoids
        self._terms = reward_terms(config.reward)

    def __repr__(self) -> str:
        state = "17 columns, with forces" if self.config.forces else "13 columns"
        return f"SarlPolicy(reward {self.config.reward.reward}, state of {state})"

    def __call__(self, world: World, crowd_velocity: np.ndarray) -> np.ndarray:
        return self.lookahead(world, crowd_velocity).action

    def explain(self, world: World, crowd_velocity: np.ndarray) -> tuple[np.ndarray, Notes]:
        """The actions and, as notes, the arrays of the `Lookahead` from which they were chosen."""
        look = self.lookahead(world, crowd_velocity)
        return look.action, vars(look)

    def lookahead(self, world: World, crowd_velocity: np.ndarray) -> Lookahead:
        """The values of all actions, and the best, in every episode of the world."""
        actions = robot_actions(world)  # (E, A, 2)
        values, outcome = self.judge(world, crowd_velocity, actions)
        if not np.isfinite(values).all():
            raise ConfigError(
                "the network's values are not finite: its weights are too large, so its training diverged"
            )
        best = values.argmax(1)
        if self.trap_steps:
            best = best_untrapped(world, crowd_velocity, actions, values, outcome, self.trap_steps)
        return Lookahead(actions, values, best)

    def judge(self, world: World, crowd_velocity: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The values and outcomes (E, A) of actions (E, A, 2) in m/s, computed in blocks on all threads."""
        size = max(1, min(BLOCK, -(-len(world) // self.threads)))
        blocks = [slice(e, e + size) for e in range(0, max(len(world), 1), size)]
        pool = _pool(self.threads, os.getpid())
        parts = pool.map(lambda rows: self._values(world.take(rows), crowd_velocity[rows], actions[rows]), blocks)
        values, outcome = (np.concatenate(part) for part in zip(*parts, strict=True))
        return values, outcome

    def attention(self, world: World) -> np.ndarray:
        """The share of attention that each element gets in the world as it is, (E, K)."""
        return self.network.evaluate(world_states(world, self.config))[1]

    def _values(self, world: World, crowd_velocity: np.ndarray, action: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The values and outcomes (e, A) of actions (e, A, 2) in a block of e episodes."""
        step = transition(world, action)  # (e, A)
        robot = world.position_after(action), action, world.goal[:, :1], world.radius[:, :1], world.v_pref[:, :1]
        places = elements_within(self.config.reach, world.position) + crowd_velocity[:, 1:] * world.simulation.time_step
        elements = places[:, None], crowd_velocity[:, None, 1:], world.radius[:, None, 1:]
        heading = turned(world, action)
        states = robot_states(*robot, *elements, heading=heading, forces=self.config.forces)  # (e, A, K, F)
        next_value = self.network.evaluate(states)[0]
        if self.config.careful:
            way = step.goal_distance
            if heading is not None:  # a turn costs as much as the way that is lost meanwhile
                way = way + world.v_pref[:, :1] * np.abs(states[..., 0, OWN.index("theta")]) / TURN_RATE
            alone = np.isnan(places[..., 0]).all(1, keepdims=True)  # (e, 1): nobody and nothing within reach
            next_value = np.where(alone, value_alone(self.config, way, world.radius[:, :1]), next_value)
            next_value = np.where(step.outcome == COLLISION, 0.0, next_value)
        discount = step_discount(self.config.discount, world.v_pref[:, :1], world.simulation)
        return total(self._terms(step)) + discount * next_value, step.outcome


@cache
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """The threads of a process, by its id: a forked one has none of its parent's, and would wait for them forever."""
    return ThreadPoolExecutor(threads)


def value_alone(config: Config, goal_distance: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The value for a robot with nothing around it that goes straight to its goal, `goal_distance` m away.

    The reward for arriving is the setting `success`, also with a user's own reward.
    """
    return config.reward.success * config.discount ** np.maximum(goal_distance - radius, 0.0)


def world_states(world: World, config: Config) -> np.ndarray:
    """Robot-centred states of a world, (E, K, F), with a config's columns and reach."""
    return states_of(world.position, world.velocity, world.goal, world.radius, world.v_pref, world.heading, config)


def step_discount(discount: float, v_pref: np.ndarray, simulation: Simulation) -> np.ndarray:
    """CrowdNav's discount for one step, gamma^(dt v_pref), in the shape of the robot's `v_pref` (m/s)."""
    return discount ** (simulation.time_step * v_pref)
