"""The simulator as Gymnasium environments, for agents of other libraries; importing this registers them.

    env = gymnasium.make("sfmrl.envs:sfmrl/Crowd-v0", environment="table1", reward="sfm")
    envs = gymnasium.make_vec("sfmrl.envs:sfmrl/Crowd-v0", num_envs=64, vectorization_mode="vector_entry_point")
    venv = sfmrl.envs.as_sb3(envs)  # a Stable-Baselines3 VecEnv

The files:

    crowd.py        what agents observe and do, and episodes side by side
    pictures.py     a moment as text or as an image
    environments.py Gymnasium's interfaces: one episode, or many
    sb3.py          many episodes for Stable-Baselines3
"""

from sfmrl.envs.crowd import observe, robot_velocity
from sfmrl.envs.environments import CrowdEnv, CrowdVectorEnv
from sfmrl.envs.sb3 import as_sb3

__all__ = ["CrowdEnv", "CrowdVectorEnv", "as_sb3", "observe", "robot_velocity"]
