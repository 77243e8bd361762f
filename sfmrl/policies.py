"""How the robot chooses: straight for the goal, ORCA, the Social Force Model, or SARL looking one step ahead.

A policy is a function (world, crowd_velocity) -> action (E, 2) in m/s, where `crowd_velocity` (E, N, 2) is what the
people are about to do. SARL's lookahead takes them from the simulator, as CRI does: their next states do not depend
on the robot's action, so one step of the crowd serves all 81.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sfmrl.config import CROWD_FORCE, Config, ConfigError, Simulation, suggest
from sfmrl.crowd import World, advance, orca_crowd, transition
from sfmrl.rewards import COLLISION, RUNNING, reward_terms, total
from sfmrl.sfm import sfm_velocities
from sfmrl.states import robot_states

WEIGHTS = "weights.pt"  # a run's trained network, in its folder
BLOCK = 16  # episodes at most that are looked at together: few enough for their layers to stay in the cache

Policy = Callable[[World, np.ndarray], np.ndarray]


def _actions() -> np.ndarray:
    """CRI's 81 actions as shares of v_pref: stop, then 16 headings with 5 speeds (e^(i/5) - 1) / (e - 1) each."""
    speeds = (np.exp(np.arange(1, 6) / 5) - 1) / (np.e - 1)
    headings = np.arange(16) * (2 * np.pi / 16)
    moves = speeds[None, :, None] * np.stack((np.cos(headings), np.sin(headings)), -1)[:, None]
    return np.concatenate((np.zeros((1, 2)), moves.reshape(80, 2)))


ACTIONS = _actions()


def linear_policy(world: World, crowd_velocity: np.ndarray) -> np.ndarray:
    """Straight for the goal, blind to everything: (E, 2) m/s."""
    return world.preferred_velocity[:, 0]


def orca_policy(world: World, crowd_velocity: np.ndarray) -> np.ndarray:
    """ORCA with the simulation's safety space, (E, 2) m/s."""
    simulation = world.simulation
    if simulation.crowd == "orca" and simulation.robot_visible and not simulation.safety_space:
        return crowd_velocity[:, 0]  # the crowd's own computation has been the same one
    robot_only = np.zeros(world.square.shape, dtype=bool)
    robot_only[:, 0] = True
    return orca_crowd(world, world.position, robot_only, simulation.safety_space)[:, 0]


def sfm_policy(world: World, crowd_velocity: np.ndarray) -> np.ndarray:
    """The Social Force Model with the crowd's parameters, (E, 2) m/s."""
    return sfm_velocities(
        world.position,
        world.velocity,
        world.preferred_velocity,
        world.v_pref,
        force=CROWD_FORCE,
        time_step=world.simulation.time_step,
    )[:, 0]


POLICIES: dict[str, Policy] = {"linear": linear_policy, "orca": orca_policy, "sfm": sfm_policy}


def find_policy(policy: str | Policy) -> Policy:
    """A policy from what `load_policy` takes, or the policy itself."""
    return load_policy(policy) if isinstance(policy, (str, Path)) else policy


def load_policy(name_or_path: str | Path, threads: int | None = None, device: str = "cpu") -> Policy:
    """The policy of a name (linear, orca, sfm), a run folder, or a weights file (sfmrl's or a CrowdNav SARL's).

    A CrowdNav file says nothing of its reward: it looks ahead with CRI's. Raises ConfigError where there is no such
    policy, DamagedFile where a run's weights are not what was written.
    """
    if str(name_or_path) in POLICIES:
        return POLICIES[str(name_or_path)]
    path = Path(name_or_path)
    if not path.exists():
        known = ", ".join(POLICIES)
        raise ConfigError(
            f"there is no policy {name_or_path}; name {known}, a run folder or a weights file{suggest(path, POLICIES)}"
        )
    if path.is_dir():
        if not (path / "run.json").exists() and not (path / WEIGHTS).exists():
            raise ConfigError(f"{path} is not a run folder: it has neither run.json nor {WEIGHTS}")
        if not (path / WEIGHTS).exists():
            raise ConfigError(
                f"{path} holds no {WEIGHTS}: that training has not ended; go on with it by --resume {path}"
            )
        path = path / WEIGHTS
    from sfmrl.weights import load_weights  # torch takes seconds to import: only for those who need it

    network, config = load_weights(path)
    return SarlPolicy(network.to(device), config, threads or available_cores())


def world_states(world: World, forces: bool) -> np.ndarray:
    """Robot-centred states of a world, (E, K, F)."""
    return robot_states(
        world.position[:, 0],
        world.velocity[:, 0],
        world.goal[:, 0],
        world.radius[:, 0],
        world.v_pref[:, 0],
        world.position[:, 1:],
        world.velocity[:, 1:],
        world.radius[:, 1:],
        forces=forces,
    )


@dataclass(frozen=True)
class Lookahead:
    """What SARL weighs up: the 81 actions (E, A, 2) in m/s, their values (E, A), and the best one's index (E,)."""

    actions: np.ndarray
    values: np.ndarray
    best: np.ndarray


class SarlPolicy:
    """Take the action with the highest reward plus discounted value of where it leads; a Policy.

    `network` is a ValueNetwork, `config` says with which reward, discount and state it looks ahead. Blocks of episodes
    are spread over `threads` threads, each with one of torch's own; what shares a block changes no number.
    """

    batch = 32  # episodes side by side: the network is what takes the time, and more would only end later

    def __init__(self, network, config: Config, threads: int = 1) -> None:
        self.network, self.config = network, config
        self.threads = threads
        self._terms = reward_terms(config.reward)
        self._pool = worker_threads(threads)

    def __call__(self, world: World, crowd_velocity: np.ndarray) -> np.ndarray:
        look = self.lookahead(world, crowd_velocity)
        return look.actions[np.arange(len(world)), look.best]

    def lookahead(self, world: World, crowd_velocity: np.ndarray) -> Lookahead:
        """Values of all actions in every episode of the world."""
        actions = ACTIONS * world.v_pref[:, 0, None, None]  # (E, A, 2)
        size = max(1, min(BLOCK, -(-len(world) // self.threads)))
        blocks = [slice(e, e + size) for e in range(0, len(world), size)] or [slice(0)]
        parts = self._pool.map(lambda rows: self._values(world, crowd_velocity, actions, rows), blocks)
        values, outcome = (np.concatenate(part) for part in zip(*parts, strict=True))
        wary = self.config.avoid_traps
        best = best_untrapped(world, crowd_velocity, actions, values, outcome) if wary else values.argmax(1)
        return Lookahead(actions, values, best)

    def attention(self, world: World) -> np.ndarray:
        """The share of attention each element gets in the world as it is, (E, K)."""
        return self.network.evaluate(world_states(world, self.config.forces))[1]

    def _values(
        self, world: World, crowd_velocity: np.ndarray, actions: np.ndarray, rows: slice
    ) -> tuple[np.ndarray, np.ndarray]:
        """The values and outcomes (e, A) of all actions in some of the episodes."""
        world, crowd_velocity, action = world.take(np.arange(len(world))[rows]), crowd_velocity[rows], actions[rows]
        step = transition(world, action)  # (e, A)
        reward = total(self._terms(step))
        dt = world.simulation.time_step
        states = robot_states(
            world.position[:, :1] + action * dt,
            action,
            world.goal[:, :1],
            world.radius[:, :1],
            world.v_pref[:, :1],
            (world.position + crowd_velocity * dt)[:, None, 1:],
            crowd_velocity[:, None, 1:],
            world.radius[:, None, 1:],
            forces=self.config.forces,
        )  # (e, A, K, F)
        ahead = self.network.evaluate(states.reshape(-1, *states.shape[2:]))[0].reshape(reward.shape)
        if self.config.collision_ends:
            ahead = np.where(step.outcome == COLLISION, 0.0, ahead)
        return reward + step_discount(self.config.discount, world.v_pref[:, :1], world.simulation) * ahead, step.outcome


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def worker_threads(count: int) -> ThreadPoolExecutor:
    """Threads to compute on, with torch kept to the one thread in each that it is."""
    import torch

    def prepare() -> None:
        torch.get_num_threads()  # makes torch settle on a number for this thread, which it would else do later
        torch.set_num_threads(1)

    return ThreadPoolExecutor(count, initializer=prepare)


def best_untrapped(
    world: World, crowd_velocity: np.ndarray, actions: np.ndarray, values: np.ndarray, outcome: np.ndarray
) -> np.ndarray:
    """The most valuable actions (E,) that neither collide nor lead where every action (E, A, 2) does.

    `values` and `outcome` (E, A) are those of the actions.

    Exact without another step of the crowd: a collision is judged by the velocities that people had before the step,
    and those of the next step are the `crowd_velocity` (E, N, 2) of this one. The most valuable of all where none is
    free.
    """
    best = values.argmax(1)
    left = np.where(outcome == COLLISION, -np.inf, values)
    pending = np.flatnonzero(outcome[np.arange(len(best)), best] == RUNNING)
    while len(pending):
        choice = left[pending].argmax(1)
        after = advance(world.take(pending), crowd_velocity[pending], actions[pending, choice])
        trapped = (transition(after, actions[pending]).outcome == COLLISION).all(1)
        trapped &= outcome[pending, choice] == RUNNING
        best[pending[~trapped]] = choice[~trapped]
        left[pending[trapped], choice[trapped]] = -np.inf
        pending = pending[trapped]
        pending = pending[np.isfinite(left[pending]).any(1)]
    return best


def step_discount(discount: float, v_pref: np.ndarray, simulation: Simulation) -> np.ndarray:
    """CRI's discount of one step, gamma^(dt v_pref), in the shape of the robot's `v_pref` (m/s)."""
    return discount ** (simulation.time_step * v_pref)
