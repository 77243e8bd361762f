"""Robustness: a policy's metrics while one thing about the episodes is varied, e.g. the number of people.

`--sweep humans=0:20:5` is a setting and its values. What is not varied stays as it is, and the episodes' numbers and
seed are the same at every value, so neighbouring rows differ in the setting alone.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sfmrl.config import ConfigError, Simulation, suggest
from sfmrl.placement import CIRCLE
from sfmrl.scenarios import STREAMS, Scenes, sample_scenes

MOST = 200  # values of a sweep
MOST_PEOPLE = 1000


@dataclass(frozen=True)
class Sweep:
    """A setting's name and its values."""

    setting: str
    values: tuple[float | str, ...]


Sample = Callable[..., Scenes]  # sample_scenes, but for what a value decides: its `people` and `circle`


def humans(value: float, simulation: Simulation, sample: Sample) -> tuple[Scenes, Simulation]:
    """So many people, all on the circle, among the environment's own squares.

    From ten people on the circle is made larger, since their starts and goals would have no room on it.
    """
    if value != int(value) or value < 0:
        raise ConfigError(f"--sweep humans has the value {value:g}; people come in whole numbers")
    if value > MOST_PEOPLE:
        raise ConfigError(f"--sweep humans has the value {value:g}; it must be at most {MOST_PEOPLE}")
    return sample(people=int(value), circle=max(CIRCLE, 2.0 + 0.2 * value)), simulation


def v_pref(value: float, simulation: Simulation, sample: Sample) -> tuple[Scenes, Simulation]:
    """The people's preferred speed, m/s; the robot keeps its own."""
    if value < 0:
        raise ConfigError(f"--sweep v_pref has the value {value:g}; a speed is not below 0")
    scenes = sample()
    speed = np.where(scenes.square, scenes.v_pref, value)
    speed[:, 0] = scenes.v_pref[:, 0]
    return replace(scenes, v_pref=speed), simulation


def radius_noise(value: float, simulation: Simulation, sample: Sample) -> tuple[Scenes, Simulation]:
    """People's radii drawn uniformly from 0.3 m less to 0.3 m plus so many metres."""
    scenes = sample()
    if not 0 <= value < scenes.radius.min():
        raise ConfigError(f"--sweep radius_noise has the value {value:g}; it is from 0 to below 0.3 m")
    rngs = [np.random.default_rng([int(number), len(STREAMS)]) for number in scenes.episode]  # a stream of its own
    draws = np.array([rng.uniform(-1, 1, scenes.radius.shape[1]) for rng in rngs])
    noise = np.where(scenes.square, 0.0, value * draws)
    noise[:, 0] = 0.0
    return replace(scenes, radius=scenes.radius + noise), simulation


def crowd(value: str, simulation: Simulation, sample: Sample) -> tuple[Scenes, Simulation]:
    """What drives the people, orca or sfm."""
    return sample(), replace(simulation, crowd=value)


def robot_visible(value: str, simulation: Simulation, sample: Sample) -> tuple[Scenes, Simulation]:
    """Whether the people see the robot, true or false."""
    if value not in ("true", "false"):
        raise ConfigError(f"--sweep robot_visible has the value {value!r}; choose true, false")
    return sample(), replace(simulation, robot_visible=value == "true")


NUMBERS = {"humans": humans, "v_pref": v_pref, "radius_noise": radius_noise}
WORDS = {"crowd": crowd, "robot_visible": robot_visible}
SETTINGS = NUMBERS | WORDS


def parse_sweep(text: str) -> Sweep:
    """A sweep from "humans=0:20:5" (first, last and step), "humans=0,5,20" or "crowd=orca,sfm"; raises ConfigError."""
    sweep = _parse(text)
    for value in sweep.values:  # a bad one is better found now than after hours
        swept(sweep, value, Simulation(), partial(sample_scenes, "2", 1))
    return sweep


def _parse(text: str) -> Sweep:
    setting, equals, values = text.partition("=")
    setting = setting.strip().replace("-", "_")
    if setting not in SETTINGS:
        raise ConfigError(f"--sweep cannot vary {setting!r}; choose {', '.join(SETTINGS)}{suggest(setting, SETTINGS)}")
    example = f"{setting}=" + {"humans": "0:20:5", "v_pref": "0.5:1.5:0.25"}.get(setting, "...")
    if not equals or not values.strip():
        raise ConfigError(f"--sweep {text} names no values; write {example}")
    if setting in WORDS:
        return Sweep(setting, tuple(word.strip() for word in values.split(",")))
    try:
        numbers = [float(word) for word in values.split(":" if ":" in values else ",")]
        if not np.isfinite(numbers).all() or (":" in values and len(numbers) != 3):
            raise ValueError
    except ValueError:
        raise ConfigError(f"--sweep {text}: the values are first:last:step or a list, as in {example}") from None
    if ":" not in values:
        return Sweep(setting, tuple(numbers))
    first, last, step = numbers
    if not step > 0 or not 0 <= (last - first) / step < MOST:
        raise ConfigError(f"--sweep {text}: the step must lead from the first to the last value within {MOST} steps")
    count = int((last - first) / step + 1e-9) + 1
    return Sweep(setting, tuple(round(first + k * step, 9) for k in range(count)))


def swept(sweep: Sweep, value: float | str, simulation: Simulation, sample: Sample) -> tuple[Scenes, Simulation]:
    """What `sample` returns at one value of a sweep, and how the crowd moves there; raises ConfigError."""
    return SETTINGS[sweep.setting](value, simulation, sample)
