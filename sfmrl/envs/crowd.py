"""Observations and actions of agents, and E episodes side by side.

Observations and actions are in the frame of the value network's states: the robot is the origin, and the x axis points
to its goal. `observe` and `robot_velocity` are functions of a `World`, so that a trained agent can be a policy of
`sfmrl.play`.
"""

from dataclasses import replace
from typing import Any, cast

import numpy as np

from sfmrl.actions import ACTIONS, robot_actions
from sfmrl.config import LARGEST_SEED, MOST_EPISODES, Config, ConfigError, Reward, Simulation, in_range
from sfmrl.geometry import direction, limit, unit_at
from sfmrl.lookahead import world_states
from sfmrl.orca import Edges
from sfmrl.rewards import OUTCOMES, RUNNING, SUCCESS, OwnReward, Transition, reward_terms, total
from sfmrl.scenes import sample_scenes
from sfmrl.states import ELEMENT, own_columns
from sfmrl.world import TURN_RATE, World, advance, crowd_velocities, drive, reset, transition

CONFIGS = {forces: Config(forces=forces) for forces in (False, True)}  # for the columns of the states
AHEAD = 16  # the least number of scenes to sample together, which is faster than one by one
STANDS = 1e-9  # share of v_pref at which a unicycle turns on the spot: a velocity of 0 would keep its heading
FIRST = 10**9  # a seed chooses an episode's number below this


def observe(world: World, forces: bool = False) -> dict[str, np.ndarray]:
    """What agents observe in E episodes: the columns of `robot_states`, but the robot's own only once.

    `robot` (E, 6), or (E, 8) with forces; `elements` (E, K, 7) or (E, K, 9), nearest first, 0 where absent; `mask`
    (E, K), 1 where an element is present.
    """
    states, own = world_states(world, CONFIGS[forces]), own_columns(forces)
    distance = states[..., own + ELEMENT.index("distance")]
    order = distance.argsort(axis=1, kind="stable")  # absent ones, NaN, last
    elements = np.take_along_axis(states[..., own:], order[..., None], axis=1)
    mask = ~np.isnan(elements[..., 0])
    elements[~mask] = 0.0
    return {"robot": states[:, 0, :own], "elements": elements, "mask": mask.astype(np.int8)}


def robot_velocity(world: World, action: np.ndarray) -> np.ndarray:
    """The robots' velocities (E, 2) in m/s for the agents' actions.

    An action is a share of v_pref (forward, left), cut to the unit disc, (E, 2), or the index of one of SARL's 81
    actions with heading 0 as forward, (E,) integers. A unicycle's is its speed (-1 is 0, 1 is v_pref) and its turn (-1
    is the fastest to the right, 1 to the left); its 81 are `robot_actions`. Raises ValueError for other shapes, where
    one is not finite, and for other indices.
    """
    action, shapes = np.asarray(action), ((len(world), 2), (len(world),))
    if action.shape not in shapes:
        raise ValueError(
            f"the actions have shape {action.shape}; they must have {shapes[0]}, or {shapes[1]} as indices"
        )
    if action.ndim == 1 and not (action.dtype.kind in "iu" and ((action >= 0) & (action < len(ACTIONS))).all()):
        raise ValueError(f"an action is not an index; it must be a whole number from 0 to {len(ACTIONS) - 1}")
    share = ACTIONS[action] if action.ndim == 1 else limit(action.astype(float), 1.0)
    if not np.isfinite(share).all():
        raise ValueError("an action is NaN or infinite; it must be two finite numbers")
    if world.heading is not None:
        return robot_actions(world)[np.arange(len(world)), action] if action.ndim == 1 else _driven(world, action)
    ahead = direction(world.goal[:, 0] - world.position[:, 0])
    left = np.stack((-ahead[:, 1], ahead[:, 0]), axis=-1)
    return (share[:, :1] * ahead + share[:, 1:] * left) * world.v_pref[:, :1]


def _driven(world: World, action: np.ndarray) -> np.ndarray:
    """A unicycle's velocity (E, 2) in m/s for a speed and a turn; all but 0 where it turns on the spot."""
    speed = np.clip((1.0 + action[:, 0]) / 2.0, STANDS, 1.0) * world.v_pref[:, 0]
    turn = np.clip(action[:, 1], -1.0, 1.0) * TURN_RATE * world.simulation.time_step
    return speed[:, None] * unit_at(world.heading + turn)


class Crowd:
    """`count` episodes side by side: those of `phase` ("train", "validation" or "test"), in the order of their numbers.

    `environment` is a name as for `sample_scenes`; `reward`, `crowd`, `robot_visible` and `kinematics` are as for
    `play`; `forces` adds the social forces to the observation. Raises ConfigError where an argument is none of these.
    """

    def __init__(
        self,
        count: int,
        *,
        environment: str | int = "table1",
        reward: str | Reward | OwnReward = "sfm",
        forces: bool = False,
        crowd: str = "orca",
        robot_visible: bool = True,
        kinematics: str = "holonomic",
        phase: str = "train",
    ) -> None:
        self.count = int(in_range("num_envs", count, 1, MOST_EPISODES))
        self.forces = Config(forces=forces).forces
        self.simulation = Simulation(crowd=crowd, robot_visible=robot_visible, kinematics=kinematics)
        self.reward = Reward(reward=reward) if isinstance(reward, str) else reward
        self.terms = reward_terms(self.reward)
        self.scene: dict[str, Any] = {"environment": environment, "phase": phase}
        self.following: int | None = None  # number of the next episode
        self._ahead = self._prepare(range(1))  # one scene, from which the spaces are made
        self.world, self.labels = self._ahead

    def start(self, rng: np.random.Generator, seeded: bool, options: dict[str, Any]) -> None:
        """Start the episodes from number `options["episode"]` on, else from a random one if `seeded`, else the next."""
        if unknown := [name for name in options if name != "episode"]:
            raise ConfigError(f"reset has no option {unknown[0]!r}; its one option is 'episode', a scene's number")
        if "episode" in options:
            self.following = int(in_range("episode", options["episode"], 0, LARGEST_SEED))
        elif seeded or self.following is None:
            self.following = int(rng.integers(FIRST))
        self.world, self.labels = self._next(self.count)

    def check_started(self, called: str) -> None:
        """Raise RuntimeError, with what was `called`, before the first `start`."""
        if self.following is None:
            raise RuntimeError(f"{called} was called before reset; call reset first")

    def step(self, action: np.ndarray) -> tuple[Transition, np.ndarray]:
        """Move everybody; returns the transition and the reward of each episode, (E,)."""
        self.check_started("step")
        velocity = robot_velocity(self.world, action)
        step = transition(self.world, drive(self.world, velocity))
        self.world = advance(self.world, crowd_velocities(self.world), velocity)
        return step, total(self.terms(step))

    def renew(self, ended: np.ndarray) -> None:
        """Put the next episodes in place of those that have `ended`, (E,) bool."""
        world, labels = self._next(int(ended.sum()))
        rows = np.arange(self.count)
        rows[ended] = self.count + np.arange(len(world))
        self.world = _joined(self.world, world).take(rows)
        self.labels = np.concatenate((self.labels, labels))[rows]

    def info(self, step: Transition | None = None) -> dict[str, np.ndarray]:
        """Facts about each episode, (E,), after a `step` or, without one, at the start."""
        if step is None:
            outcome = np.full(self.count, RUNNING)
            separation = np.fmin(self.world.gap, np.inf).min(axis=1, initial=np.inf)
        else:
            outcome, separation = step.outcome, step.separation
        return {
            "outcome": OUTCOMES[outcome],
            "is_success": outcome == SUCCESS,
            "episode_number": self.world.episode.copy(),  # under "episode", other libraries keep an episode's return
            "environment": self.labels.copy(),
            "separation": separation,  # m
            "time": self.world.time,  # s
        }

    def _prepare(self, episodes: range) -> tuple[World, np.ndarray]:
        """The world at the start of some episodes, and the names of their environments."""
        scenes = sample_scenes(episodes=episodes, **self.scene)
        return replace(reset(scenes, self.simulation), episode=scenes.episode), scenes.environment

    def _next(self, count: int) -> tuple[World, np.ndarray]:
        """The next `count` episodes, from those that are prepared."""
        world, labels = self._ahead
        number = cast(int, self.following)  # which `start` has chosen
        first = number - int(world.episode[0])
        if not 0 <= first <= len(world) - count:
            first, most = 0, max(self.count, AHEAD)
            self._ahead = self._prepare(range(number, number + most))
            world, labels = self._ahead
        self.following = number + count
        return world.take(slice(first, first + count)), labels[first : first + count]


def _joined(*worlds: World) -> World:
    """The episodes of several worlds in one; worlds with fewer edges get absent ones (NaN)."""
    most = max(world.edges.values.shape[1] for world in worlds)
    values = np.full((len(worlds[0].edges.values), most, sum(map(len, worlds))), np.nan, np.float32)
    end = 0
    for world in worlds:
        start, end = end, end + len(world)
        values[:, : world.edges.values.shape[1], start:end] = world.edges.values
    edges = Edges(values, np.concatenate([world.edges.origin for world in worlds]))
    arrays = [name for name, part in vars(worlds[0]).items() if isinstance(part, np.ndarray)]
    joined: dict[str, Any] = {name: np.concatenate([getattr(world, name) for world in worlds]) for name in arrays}
    return replace(worlds[0], edges=edges, **joined)
