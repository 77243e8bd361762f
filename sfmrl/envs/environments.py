"""Gymnasium's two interfaces to `Crowd`: an episode at a time, and many side by side in one simulator.

Success and collision terminate an episode, a time-out truncates it. Arguments of both are those of `Crowd`, and
`actions`: "continuous" (forward and left; for a unicycle, speed and turn: see `robot_velocity`) or "discrete" (one of
SARL's 81 actions).
"""

from typing import Any

import numpy as np

from sfmrl.actions import ACTIONS
from sfmrl.config import ConfigError, suggest
from sfmrl.envs.crowd import Crowd, observe
from sfmrl.envs.pictures import as_image, as_text
from sfmrl.rewards import RUNNING, TIMEOUT, Transition
from sfmrl.world import World

try:
    from gymnasium import Env, Space, register, spaces
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError:
    raise ImportError("sfmrl.envs needs Gymnasium; install it with: pip install gymnasium") from None

BOUND = 100.0  # m, m/s or m/s^2, of all observations: maps are at most 36 m wide, and a robot goes at most 25 m


def _spaces(crowd: Crowd, actions: str) -> tuple[Space, Space]:
    """The spaces of an episode's observations and actions."""
    shapes = {name: part.shape[1:] for name, part in observe(crowd.world, crowd.forces).items()}
    boxes = {name: spaces.Box(-BOUND, BOUND, shapes[name], np.float32) for name in ("robot", "elements")}
    kinds = {"continuous": spaces.Box(-1.0, 1.0, (2,), np.float32), "discrete": spaces.Discrete(len(ACTIONS))}
    if actions not in kinds:
        raise ConfigError(f"actions is {actions!r}; choose {', '.join(kinds)}{suggest(actions, kinds)}")
    return spaces.Dict(boxes | {"mask": spaces.MultiBinary(shapes["mask"])}), kinds[actions]


def _mode(mode: str | None, known: list[str]) -> str | None:
    """A render mode that is known; raises ConfigError for others."""
    if mode not in (None, *known):
        raise ConfigError(f"render_mode is {mode!r}; choose {', '.join(known)} or None")
    return mode


def _checked(given: Any, space: Space) -> np.ndarray:
    """The action, or those of all episodes, as an array; raises ValueError if it is not of the kind of its `space`."""
    action, whole = np.asarray(given), np.issubdtype(space.dtype, np.integer)
    if action.shape != space.shape or action.dtype.kind not in ("iu" if whole else "iuf"):
        numbers = f"indices from 0 to {len(ACTIONS) - 1}" if whole else "numbers from -1 to 1"
        raise ValueError(
            f"the actions have shape {action.shape} and type {action.dtype}; the environment takes {numbers}, "
            f"shape {space.shape}"
        )
    return action


class CrowdEnv(Env):
    """One episode at a time.

    `reset(options={"episode": 17})` starts scene 17 of the phase, and `reset()` the scene after the last; with a seed,
    `reset` starts a scene chosen at random.
    """

    metadata = {"render_modes": ["ansi", "rgb_array"], "render_fps": 4}  # noqa: RUF012

    def __init__(self, render_mode: str | None = None, actions: str = "continuous", **arguments: Any) -> None:
        self.render_mode = _mode(render_mode, self.metadata["render_modes"])
        self.crowd = Crowd(1, **arguments)
        self.observation_space, self.action_space = _spaces(self.crowd, actions)
        self._past: list[tuple[World, Transition]] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        """The first observation and info of an episode."""
        super().reset(seed=seed)
        self.crowd.start(self.np_random, seed is not None, options or {})
        self._past = []
        return self._observation(), _one(self.crowd.info())

    def step(self, action: Any) -> tuple[dict, float, bool, bool, dict]:
        """The observation after a step, its reward, terminated, truncated, and info.

        Raises ValueError if the action is not of the kind that the environment takes.
        """
        world = self.crowd.world
        step, reward = self.crowd.step(_checked(action, self.action_space)[None])
        if self.render_mode == "ansi":
            self._past.append((world, step))
        outcome = int(step.outcome[0])
        ended, late = outcome not in (RUNNING, TIMEOUT), outcome == TIMEOUT
        return self._observation(), float(reward[0]), ended, late, _one(self.crowd.info(step))

    def render(self) -> str | np.ndarray | None:
        """The moment as 24 lines of text ("ansi") or as an image, uint8 (400, 400, 3) ("rgb_array")."""
        self.crowd.check_started("render")
        if self.render_mode == "ansi":
            return as_text(self.crowd, self._past)
        return as_image(self.crowd.world, 0) if self.render_mode else None

    def _observation(self) -> dict[str, np.ndarray]:
        return {name: part[0] for name, part in observe(self.crowd.world, self.crowd.forces).items()}


class CrowdVectorEnv(VectorEnv):
    """`num_envs` episodes side by side.

    An episode that ends is replaced by the next in the same step: observation and info are then those of the new one,
    and `final_obs` and `final_info` those of the old. `reset(options={"episode": 17})` starts scenes 17, 18 and so on.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 4, "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self, num_envs: int = 1, render_mode: str | None = None, actions: str = "continuous", **arguments: Any
    ) -> None:
        self.render_mode = _mode(render_mode, self.metadata["render_modes"])
        self.crowd, self.num_envs = Crowd(num_envs, **arguments), num_envs
        self.single_observation_space, self.single_action_space = _spaces(self.crowd, actions)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._all = np.ones(num_envs, dtype=bool)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        """The first observations and infos."""
        super().reset(seed=seed)
        self.crowd.start(self.np_random, seed is not None, options or {})
        return observe(self.crowd.world, self.crowd.forces), _masked(self.crowd.info(), self._all)

    def step(self, actions: np.ndarray) -> tuple[dict, np.ndarray, np.ndarray, np.ndarray, dict]:
        """The observations after a step, its rewards, terminated, truncated, (E,) each, and infos.

        Raises ValueError if the actions are not of the kind that the environments take.
        """
        step, reward = self.crowd.step(_checked(actions, self.action_space))
        late = step.outcome == TIMEOUT
        over = step.outcome != RUNNING
        observation, info, final = observe(self.crowd.world, self.crowd.forces), self.crowd.info(step), {}
        if over.any():
            last = np.full(self.num_envs, None, dtype=object)
            last[over] = [{name: part[e].copy() for name, part in observation.items()} for e in np.flatnonzero(over)]
            final = _masked({"final_obs": last, "final_info": _masked(info, over)}, over)
            self.crowd.renew(over)
            for name, part in observe(self.crowd.world.take(over), self.crowd.forces).items():
                observation[name][over] = part
            info = {name: np.where(over, part, info[name]) for name, part in self.crowd.info().items()}
        return observation, reward, over & ~late, late, _masked(info, self._all) | final

    def render(self) -> tuple[np.ndarray, ...] | None:
        """An image of each episode, uint8 (400, 400, 3)."""
        self.crowd.check_started("render")
        return tuple(as_image(self.crowd.world, e) for e in range(self.num_envs)) if self.render_mode else None


def _one(info: dict[str, np.ndarray]) -> dict[str, Any]:
    """The plain values of a single episode's info."""
    return {name: part.tolist()[0] for name, part in info.items()}


def _masked(info: dict[str, Any], which: np.ndarray) -> dict[str, Any]:
    """The info and, as is Gymnasium's convention, under "_" and each name which episodes have the entry, (E,) bool."""
    return info | {f"_{name}": which.copy() for name in info}


register("sfmrl/Crowd-v0", entry_point="sfmrl.envs:CrowdEnv", vector_entry_point="sfmrl.envs:CrowdVectorEnv")
