"""Episodes side by side, as a Stable-Baselines3 VecEnv."""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from sfmrl.envs.environments import CrowdVectorEnv


def as_sb3(envs: CrowdVectorEnv) -> Any:
    """A vector environment as a Stable-Baselines3 VecEnv.

    Raises ImportError without Stable-Baselines3, TypeError for other environments, also in Gymnasium's wrappers.
    """
    try:
        from stable_baselines3.common.vec_env import VecEnv
    except ImportError:
        raise ImportError("as_sb3 needs Stable-Baselines3; install it with: pip install stable-baselines3") from None
    if not isinstance(envs, CrowdVectorEnv):
        taken = "gymnasium.make_vec('sfmrl.envs:sfmrl/Crowd-v0', num_envs=N)"
        raise TypeError(f"as_sb3 takes {taken}, not {type(envs).__name__}; wrap what it returns, as with VecMonitor")

    class CrowdVecEnv(VecEnv):
        """The adapter; all episodes share one simulator, so none has attributes or methods of its own."""

        def reset(self) -> dict[str, np.ndarray]:
            observation, info = envs.reset(seed=self._seeds[0], options=self._options[0])
            self.reset_infos = _rows(info)
            self._reset_seeds()
            self._reset_options()
            return observation

        def step_async(self, actions: np.ndarray) -> None:
            self._actions = actions

        def step_wait(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict]]:
            observation, reward, ended, late, info = envs.step(self._actions)
            rows, over = _rows(info), ended | late
            if over.any():
                final = _rows(info["final_info"])
                for e in np.flatnonzero(over):
                    self.reset_infos[e] = rows[e]
                    end = {"terminal_observation": info["final_obs"][e], "TimeLimit.truncated": bool(late[e])}
                    rows[e] = final[e] | end
            return observation, reward, over, rows

        def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
            return [getattr(envs, attr_name) for _ in self._get_indices(indices)]

        def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
            raise NotImplementedError(f"make the environments with another {attr_name}")

        def env_method(self, method_name: str, *words: Any, indices: Any = None, **named: Any) -> list[Any]:
            raise NotImplementedError(f"call {method_name} of the vector environment itself")

        def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
            return [False for _ in self._get_indices(indices)]

        def get_images(self) -> Sequence[np.ndarray]:
            return cast(tuple[np.ndarray, ...], envs.render())  # asked for only where there are images

        def close(self) -> None:
            envs.close()

    return CrowdVecEnv(envs.num_envs, envs.single_observation_space, envs.single_action_space)


def _rows(info: dict[str, Any]) -> list[dict[str, Any]]:
    """Each episode's info as a dictionary, without what is known of ended episodes."""
    names = [name for name in info if not name.startswith(("_", "final_"))]
    return [dict(zip(names, row, strict=True)) for row in zip(*(info[name].tolist() for name in names), strict=True)]
