"""Policies by name: straight to the goal, ORCA, the Social Force Model, or a trained SARL network."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from sfmrl.actions import Policy
from sfmrl.config import Config, ConfigError
from sfmrl.geometry import direction
from sfmrl.lookahead import SarlPolicy
from sfmrl.own_code import OwnPolicy, described, names_code
from sfmrl.own_code.trust import trusted
from sfmrl.world import World, orca_crowd, sfm_crowd


def linear_policy(world: World, crowd_velocity: np.ndarray) -> np.ndarray:
    """Straight to the goal at v_pref, whatever is in the way: (E, 2) m/s."""
    return direction(world.goal[:, 0] - world.position[:, 0]) * world.v_pref[:, :1]


def orca_policy(world: World, crowd_velocity: np.ndarray) -> np.ndarray:
    """ORCA with the simulation's safety space, (E, 2) m/s."""
    simulation = world.simulation
    if simulation.crowd == "orca" and simulation.robot_visible and not simulation.safety_space:
        return crowd_velocity[:, 0]  # the crowd's ORCA has computed the same for row 0
    robot_only = np.arange(world.square.shape[1]) == 0
    return orca_crowd(world, world.position, robot_only, simulation.safety_space)[:, 0]


def sfm_policy(world: World, crowd_velocity: np.ndarray) -> np.ndarray:
    """The Social Force Model with the crowd's parameters, (E, 2) m/s."""
    return sfm_crowd(world, world.position)[:, 0]


POLICIES: dict[str, Policy] = {"linear": linear_policy, "orca": orca_policy, "sfm": sfm_policy}


def find_policy(policy: str | Path | Policy, reward: Any = None) -> Policy:
    """The policy, given as a function or by a name for `load_policy`; the `reward` that the user names may be run."""
    if isinstance(policy, (str, Path)):
        return load_policy(policy, trust_reward=getattr(reward, "reward", reward))
    if not callable(policy):
        raise ConfigError(f"policy is {described(policy)}; it takes a name, or a function of (world, crowd_velocity)")
    return policy


def config_of(policy: Policy) -> Config:
    """The config that a policy was trained with; `Config()` if its attribute `config` is missing or of another type."""
    config = getattr(policy, "config", None)
    return config if isinstance(config, Config) else Config()


def load_policy(name_or_path: str | Path, threads: int | None = None, *, trust_reward: bool | str = False) -> Policy:
    """The policy with a name: linear, orca, sfm, a model that comes with sfmrl (sarl, sarl-sfm6, ...), a run folder, a
    weights file (sfmrl's or CrowdNav's SARL), CrowdNav's output folder, or a user's own (see `own_code.OwnPolicy`).

    A CrowdNav file does not name its reward, so its policy looks ahead with CrowdNav's. A network that was trained with
    a user's own reward looks ahead with that Python code, which is run only if `trust_reward` is True or the reward's
    name, file.py:function (or that of a copy, if the file is gone and run.json has the copy's SHA-256). Raises
    ConfigError if there is no such policy, DamagedFile if a run's weights, config.json or run.json have changed since
    they were written.
    """
    if str(name_or_path) in POLICIES:
        return POLICIES[str(name_or_path)]
    if names_code(str(name_or_path)):
        return OwnPolicy(str(name_or_path))
    from sfmrl.recovery import with_recovery
    from sfmrl.runs.weights import find_weights, load_weights, reward_digest

    path = find_weights(name_or_path)
    network, config = load_weights(path)
    config = trusted(config, trust_reward, reward_digest(path))
    return with_recovery(SarlPolicy(network, config, threads or available_cores()), config.planner)


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
