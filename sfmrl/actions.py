"""The robot's 81 actions, and the protocol of the policies that `play` takes."""

from typing import Protocol

import numpy as np

from sfmrl.config import ConfigError
from sfmrl.geometry import unit_at
from sfmrl.own_code import name_of
from sfmrl.world import TURN_RATE, World


def _actions(headings: np.ndarray) -> np.ndarray:
    """Shares of v_pref, (..., 81, 2): stop, then 5 speeds (e^(i/5) - 1) / (e - 1) along 16 `headings` (..., 16) rad."""
    speeds = (np.exp(np.arange(1, 6) / 5) - 1) / (np.e - 1)
    moves = speeds[:, None] * unit_at(headings)[..., None, :]  # (..., 16, 5, 2)
    many = headings.shape[:-1]
    return np.concatenate((np.zeros((*many, 1, 2)), moves.reshape(*many, 80, 2)), axis=-2)


ACTIONS = _actions(np.arange(16) * (2 * np.pi / 16))  # CrowdNav's, of a holonomic robot
ACTIONS.flags.writeable = False


def robot_actions(world: World) -> np.ndarray:
    """The 81 actions of each robot in the world, (E, 81, 2) m/s.

    A unicycle's headings are evenly spaced from its fastest turn to the right to its fastest to the left (CrowdNav).
    """
    if world.heading is None:
        return ACTIONS * world.v_pref[:, 0, None, None]
    most = min(TURN_RATE * world.simulation.time_step, np.pi)
    return _actions(world.heading[:, None] + np.linspace(-most, most, 16)) * world.v_pref[:, 0, None, None]


Notes = dict[str, np.ndarray]  # a policy's notes on its choice: arrays (E, ...) by name


class Policy(Protocol):
    """Chooses the robot's actions: a function of (world, crowd_velocity), or an object that is called like one.

    An object may also have any of these, which are then used:
    begin(scenes, simulation): called before the first step of every play, to prepare for its episodes
    explain(world, crowd_velocity): the call's actions and `Notes` on them, for records that keep these
    attention(world): the share of attention that each element gets, (E, K), for replays
    batch: how many episodes to play side by side
    config: the `Config` that it was trained with, for the default settings of tests
    """

    def __call__(self, world: World, crowd_velocity: np.ndarray) -> np.ndarray:
        """The robots' velocities (E, 2) in m/s; `crowd_velocity` (E, N, 2) in m/s is everybody's in the coming step."""


def explained(policy: Policy, world: World, crowd_velocity: np.ndarray) -> tuple[np.ndarray, Notes]:
    """A policy's actions (E, 2) in m/s and its notes on them, none if it cannot `explain`.

    Raises ConfigError if `explain` returns anything else.
    """
    explain = getattr(policy, "explain", None)
    if not explain:
        return policy(world, crowd_velocity), {}
    returned = explain(world, crowd_velocity)
    if not (isinstance(returned, tuple) and len(returned) == 2 and isinstance(returned[1], dict)):
        raise ConfigError(f"explain of policy {name_of(policy)} must return (actions, notes), the notes a dict")
    action, notes = returned
    if not all(isinstance(note, np.ndarray) and note.shape[:1] == (len(world),) for note in notes.values()):
        said = "must return its notes as arrays with a row for each episode"
        raise ConfigError(f"explain of policy {name_of(policy)} {said}")
    return action, notes
