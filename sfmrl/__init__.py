"""Robot navigation among people: ORCA, the Social Force Model and SARL in NumPy; the network is defined in torch.

Names are imported when they are first used, so that `import sfmrl` is fast and torch is loaded only if it is needed.
"""

from importlib import import_module
from typing import Any

__version__ = "0.3.0"

_HOME = {
    "config": ("Config", "ConfigError", "Reinforcement", "Imitation", "Planner", "Reward", "Simulation"),
    "variants": ("make_config",),
    "sfm": ("SocialForce", "goal_force", "repulsive_forces", "resultant", "sfm_velocities"),
    "orca": ("orca_velocities",),
    "network": ("ValueNetwork",),
    "fast": ("FastNetwork",),
    "runs.weights": ("load_weights", "save_weights"),
    "runs.crowdnav": ("export_weights",),
    "scenes": ("Scenes", "sample_scenes"),
    "maps": ("read_map", "load_map", "draw_map"),
    "rewards": (
        *("RUNNING", "SUCCESS", "COLLISION", "TIMEOUT", "Transition"),
        *("crowd_terms", "sfm_terms", "sfm_discount_terms", "reward_terms"),
    ),
    "states": ("robot_states", "column_names"),
    "world": ("World", "reset", "crowd_velocities", "transition", "drive", "advance"),
    "actions": ("ACTIONS", "robot_actions"),
    "lookahead": ("SarlPolicy",),
    "recovery": ("RecoveringPolicy", "Geodesics", "plan", "solvable"),
    "policies": ("load_policy",),
    "episodes": ("Record", "play"),
    "evaluation": ("evaluate", "evaluation_record", "metrics", "wilson"),
    "study.social": ("social_metrics", "social_values"),
}
_WHERE = {name: module for module, names in _HOME.items() for name in names}
__all__ = sorted([*_WHERE, "__version__"])


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'sfmrl' has no attribute {name!r}")
    return getattr(import_module(f"sfmrl.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return __all__
