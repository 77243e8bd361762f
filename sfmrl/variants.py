"""The paper's variants and the presets, as data: what each changes in `Config()`, SARL with solid squares."""

from typing import Any

from sfmrl.config import Config, ConfigError, override, suggest

# The mixes of the paper's two tables (shares add up to 1). Testing table 2 on its training mix is our reading.
MIXES = {"table1": "1:0.7,2:0.3", "table2": "2:0.25,3:0.25,4:0.25,5:0.25"}

PRESETS: dict[str, dict[str, Any]] = {
    "paper": {"preset": "paper", "simulation": {"squares": "disc"}},
    "quick": {
        "preset": "quick",
        "value_prior": True,
        "optimizer": "adam",
        "careful": True,
        "mirror": True,
        "planner": {"recover": True},
        "imitation": {"episodes": 1000, "epochs": 6, "batch_size": 200, "learning_rate": 2e-3, "refit": False},
        "reinforcement": {
            "episodes": 1000,
            "parallel": 32,
            "batches": 6,
            "batch_size": 200,
            "learning_rate": 5e-4,
            "epsilon_start": 0.2,
            "epsilon_end": 0.05,
            "epsilon_episodes": 500,
            "targets": "returns",
        },
    },
}

# The seven rows of the paper's table 1.
VARIANTS: dict[str, dict[str, Any]] = {
    "sarl": {},
    "sarl-sfm": {"reward": {"reward": "sfm-discount"}},
    "sarl-sfm2": {"reward": {"reward": "sfm"}},
    "sarl-sfm3": {"reward": {"reward": "sfm"}, "reinforcement": {"environment": "1"}},
    "sarl-sfm4": {"reward": {"reward": "sfm", "k": 0.003}},
    "sarl-sfm5": {"forces": True},
    "sarl-sfm6": {"forces": True, "reward": {"reward": "sfm"}},
}


def make_config(preset: str = "quick", variant: str = "sarl", **changes: Any) -> Config:
    """The config of a preset and a variant with further `changes`; raises ConfigError on unknown names."""
    for kind, name, table in (("preset", preset, PRESETS), ("variant", variant, VARIANTS)):
        if name not in table:
            raise ConfigError(f"there is no {kind} {name!r}; choose {', '.join(table)}{suggest(name, table)}")
    named = override(override(Config(), PRESETS[preset]), VARIANTS[variant])
    return override(named, changes)
