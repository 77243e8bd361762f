"""Every setting of sfmrl with its default, unit, source and help text; its option is generated from them.

The defaults are the paper's ("Effects of a Social Force Model reward in Robot Navigation based on Deep Reinforcement
Learning", Gil and Sanfeliu) or, where it names none, those of CrowdNav/SARL (Chen et al., 2019), on which it is built;
those marked "ours", and the planner, are sfmrl's own.
"""

import difflib
import json
import math
import os
import re
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, Field, asdict, dataclass, field, fields, is_dataclass, replace
from numbers import Integral, Real
from typing import Any, cast

ANY_REWARD = (-1e6, 1e6)
WINDOWS = os.name == "nt"
MOST_EPISODES = 100_000  # in one record, which must fit into memory
MOST_STEPS = 100_000  # of an episode
LARGEST_SEED = 2**32 - 1


class ConfigError(ValueError):
    """A setting that cannot be used; its text is one line that names the setting and the remedy."""


class Untrusted(str):
    """Text read from a file: code that it names is not run (see `own_code`)."""


def knob(default: Any, help: str, low: float | None = None, high: float | None = None, choices: tuple = ()) -> Any:
    """A dataclass field with its help text, and the range of its numbers (both ends included) or its choices."""
    return field(default=default, metadata={"help": help, "range": (low, high), "choices": choices})


def checked(item: Field, value: Any) -> Any:
    """The value of a field; raises ConfigError if its type, range or choices do not allow it."""
    kind: Any = item.default_factory if item.default is MISSING else type(item.default)
    name, choices = item.name.replace("_", "-"), item.metadata.get("choices")
    if kind in (int, float):
        return in_range(name, value, item.metadata["range"][0], item.metadata["range"][1], whole=kind is int)
    if not isinstance(value, kind):
        right = {bool: "true or false", str: "text"}.get(kind, f"a {kind.__name__}")
        raise ConfigError(f"{name} is {value!r}; it takes {right}")
    if choices and value not in choices:
        raise ConfigError(f"{name} is {value!r}; choose {', '.join(choices)}{suggest(value, choices)}")
    return value


def in_range(name: str, value: Any, low: float, high: float, whole: bool = True) -> int | float:
    """`value` as an int (or float, if not `whole`); raises ConfigError unless it is a number from `low` to `high`."""
    if isinstance(value, bool) or not isinstance(value, cast(Any, Integral if whole else Real)) or value != value:
        raise ConfigError(f"{name} is {value!r}; it takes a {'whole ' if whole else ''}number")
    if not low <= value <= high:
        bound, end = ("at least", low) if value < low else ("at most", high)
        raise ConfigError(f"{name} is {value}; it must be {bound} {end if whole else f'{end:g}'}")
    return int(value) if whole else float(value)


def counted(number: int, noun: str) -> str:
    """A number with its noun in singular or plural: "1 episode", "2 episodes"."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def suggest(word: Any, known: Iterable[str]) -> str:
    """The end of an error message: "; did you mean ...?" if a known word is close, else nothing."""
    close = difflib.get_close_matches(str(word), list(known), n=1)
    return f"; did you mean {close[0]}?" if close else ""


class Settings:
    """Base of the config's dataclasses: checks their values, and lists the help texts in their docstring."""

    def __init_subclass__(cls) -> None:
        knobs = {name: item.metadata for name, item in vars(cls).items() if isinstance(item, Field)}
        lines = [f"    {name}: {metadata.get('help', 'its section')}" for name, metadata in knobs.items()]
        cls.__doc__ = "\n".join((f"{cls.__doc__}\n", *lines))

    def __post_init__(self) -> None:
        for item in fields(cast(Any, self)):  # every subclass is a dataclass
            object.__setattr__(self, item.name, checked(item, getattr(self, item.name)))


@dataclass(frozen=True)
class Simulation(Settings):
    """Who the humans are, how they move, and when an episode ends."""

    time_step: float = knob(0.25, "length of a step, s", 1e-3, 1)
    time_limit: float = knob(
        25.0, "time limit, s; the last step is the first to begin 1 s or less before it (CrowdNav)", 1, 3600
    )
    crowd: str = knob("orca", "what drives the humans", choices=("orca", "sfm"))
    kinematics: str = knob(
        "holonomic",
        "the robot moves in any direction at once, or turns by at most pi rad/s and drives ahead (CrowdNav)",
        choices=("holonomic", "unicycle"),
    )
    squares: str = knob(
        "solid",
        "measure gaps to a square's outline (ours) or to the disc inside it (paper)",
        choices=("solid", "disc"),
    )
    robot_visible: bool = knob(True, "the humans see the robot (as in the paper)")
    random_attributes: bool = knob(
        False, "random radii (0.3-0.5 m) and highest speeds (0.5-1.5 m/s) of humans (CrowdNav)"
    )
    safety_space: float = knob(0.0, "added to every radius when ORCA drives the robot, m", 0, 10)
    clearance: float = knob(0.01, "added to every radius inside ORCA, m (CrowdNav)", 0, 10)
    neighbor_distance: float = knob(10.0, "ORCA: ignore agents farther away than this, m (CrowdNav)", 0, 1e6)
    max_neighbors: int = knob(10, "ORCA: number of nearest agents considered (CrowdNav)", 0, 1000)
    time_horizon: float = knob(5.0, "ORCA: time horizon for agents, s (CrowdNav)", 1e-3, 1000)
    obstacle_time_horizon: float = knob(5.0, "ORCA: time horizon for polygons, s (CrowdNav)", 1e-3, 1000)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.longest > MOST_STEPS:
            raise ConfigError(
                f"time-limit {self.time_limit:g} and time-step {self.time_step:g} make an episode of {self.longest} "
                f"steps; it may have {MOST_STEPS}, so choose a longer time-step or a shorter time-limit"
            )

    @property
    def longest(self) -> int:
        """Steps of the longest episode: the first that begins 1 s or less before the limit is the last (CrowdNav)."""
        return math.ceil((self.time_limit - 1.0) / self.time_step - 1e-9) + 1


@dataclass(frozen=True)
class Reward(Settings):
    """Numbers of the rewards: CrowdNav's, and those of the paper's Social Force Model reward."""

    reward: str = knob("crowd", "crowd (CrowdNav), sfm, sfm-discount (paper), or your own: file.py:function")
    success: float = knob(1.0, "reward for reaching the goal (CrowdNav)", *ANY_REWARD)
    collision: float = knob(-0.25, "reward for a collision (CrowdNav)", *ANY_REWARD)
    discomfort_distance: float = knob(0.2, "gap below which the robot is too close, m (CrowdNav)", 0, 1000)
    discomfort_slope: float = knob(0.125, "crowd: penalty per metre too close, per 0.25 s (CrowdNav)", *ANY_REWARD)
    discomfort_amplitude: float = knob(-0.03, "sfm: discomfort at gap 0, per 0.25 s (the paper's A)", *ANY_REWARD)
    discomfort_decay: float = knob(10.0, "sfm: how fast discomfort fades with the gap, 1/m (the paper's B)", 0, 1e6)
    k: float = knob(0.001, "sfm: weight of moving at the preferred velocity, per 0.25 s (the paper's k)", *ANY_REWARD)
    distance_weight: float = knob(0.0001, "sfm: penalty per metre from the goal, per 0.25 s", *ANY_REWARD)
    discount_start: float = knob(10.0, "sfm-discount: arrivals later than this cost reward, s", 0, 3600)
    discount_rate: float = knob(0.02, "sfm-discount: cost of each second after --discount-start", *ANY_REWARD)


@dataclass(frozen=True)
class Planner(Settings):
    """Recovery, and the grid on which paths around squares are measured."""

    recover: bool = knob(False, "in tests and replays, lead a stuck robot around squares and look farther ahead (ours)")
    stall_time: float = knob(2.0, "recover: time without progress after which the robot is stuck, s", 0, 3600)
    stall_distance: float = knob(0.25, "recover: least shortening of the path that counts as progress, m", 0, 1000)
    resolution: float = knob(0.1, "paths around squares: side of the grid's cells, m", 0.02, 0.4)
    inflation: float = knob(0.1, "paths around squares: cells nearer to a square than this cost more, m", 0, 10)


@dataclass(frozen=True)
class Imitation(Settings):
    """Learning from ORCA's demonstrations; the paper's numbers."""

    episodes: int = knob(3000, "demonstrations by ORCA", 1, MOST_EPISODES)
    epochs: int = knob(50, "passes over the demonstrations", 1, 10_000)
    batch_size: int = knob(100, "states in a batch", 1, 100_000)
    learning_rate: float = knob(0.01, "learning rate", 0, 1000)
    refit: bool = knob(True, "in rl, fit the demonstrations again if the reward or the discount differs (CrowdNav)")
    environment: str = knob("1", "environment of the demonstrations, or a mix such as 1:0.7,2:0.3")


@dataclass(frozen=True)
class Reinforcement(Settings):
    """Deep V-learning; the paper's numbers, CrowdNav's where it gives none."""

    episodes: int = knob(10_000, "training episodes", 1, 10_000_000)
    parallel: int = knob(
        1, "episodes played side by side; with 2 or more, while the network learns from earlier ones", 1, 10_000
    )
    batches: int = knob(100, "gradient steps per episode, each on one batch (CrowdNav)", 0, 10_000)
    batch_size: int = knob(100, "states in a batch", 1, 100_000)
    learning_rate: float = knob(0.001, "learning rate", 0, 1000)
    epsilon_start: float = knob(0.5, "share of random actions at the start (CrowdNav)", 0, 1)
    epsilon_end: float = knob(0.1, "share of random actions from --epsilon-episodes on (CrowdNav)", 0, 1)
    epsilon_episodes: int = knob(4000, "episodes in which the share of random actions falls (CrowdNav)", 1, 10_000_000)
    targets: str = knob(
        "td",
        "value to learn: td, the reward plus the target network's next value, without time-outs (CrowdNav); or "
        "returns, the rewards up to the next random action plus the target network's value there (Watkins, 1989)",
        choices=("td", "returns"),
    )
    target_interval: int = knob(50, "episodes between updates of the target network (CrowdNav)", 1, 10_000_000)
    memory: int = knob(100_000, "size of the replay memory, states (CrowdNav)", 1, 10_000_000)
    environment: str = knob("table1", "environment to train in, or a mix such as 1:0.7,2:0.3")
    test_environment: str = knob("table1", "environment of validation and test; follows --environment unless given")
    validation_interval: int = knob(1000, "episodes between validations", 1, 10_000_000)
    validation_episodes: int = knob(100, "episodes of a validation", 1, MOST_EPISODES)
    test_episodes: int = knob(500, "episodes of the final test", 1, MOST_EPISODES)


@dataclass(frozen=True)
class Config(Settings):
    """All settings that decide the numbers of a training."""

    seed: int = knob(0, "seed of the training; all seeds share validation and test episodes", 0, LARGEST_SEED)
    preset: str = knob("quick", "settings: sfmrl's own (minutes), or as published (hours)", choices=("quick", "paper"))
    forces: bool = knob(False, "social forces in the state: 17 columns instead of 13")
    discount: float = knob(0.9, "discount per second at 1 m/s (gamma; paper, CrowdNav)", 0, 1)
    value_prior: bool = knob(False, "compute the value as 0.9^(goal distance - 0.3) (0.8 + network) (ours)")
    careful: bool = knob(
        False,
        "careful lookahead: add no value after a collision, avoid traps, ignore elements over 10 m away, and go "
        "straight if there are no others (ours)",
    )
    optimizer: str = knob("sgd", "sgd with momentum 0.9, or adam with a rate that falls to 0", choices=("sgd", "adam"))
    mirror: bool = knob(False, "mirror every other state of a batch left to right; this changes no value (ours)")
    simulation: Simulation = field(default_factory=Simulation)
    reward: Reward = field(default_factory=Reward)
    planner: Planner = field(default_factory=Planner)
    imitation: Imitation = field(default_factory=Imitation)
    reinforcement: Reinforcement = field(default_factory=Reinforcement)

    @property
    def reach(self) -> float:
        """Distance up to which elements are in the state, m; 10 m covers each of the paper's environments."""
        return 10.0 if self.careful else math.inf

    def to_json(self) -> str:
        """The whole config as indented JSON."""
        return json.dumps(asdict(self), indent=2)

    @staticmethod
    def from_json(text: str | bytes, source: object = "this config") -> "Config":
        """The config that `to_json` wrote, its reward `Untrusted`; raises ConfigError, naming `source`, on all else."""
        try:
            changes = json_object(text)
            if RETIRED & set(changes):
                raise ConfigError("it was made by a version of sfmrl before 0.3.0; install that version to play it")
            config = override(Config(), changes)
        except ValueError as error:
            raise ConfigError(f"{source} cannot be used: {error}") from None
        return override(config, {"reward": {"reward": Untrusted(config.reward.reward)}})


# Settings of versions before 0.3.0. Most of their networks were trained with squares as discs, and play worse now.
RETIRED = {"shaping", "precision", "collision_ends", "avoid_traps", "sparse"}


def override(config: Any, changes: Mapping[str, Any]) -> Any:
    """A copy of a config dataclass with `changes`, nested like the config; raises ConfigError on unknown keys.

    A part of the config may also be given as its dataclass, such as a `Reward`.
    """
    section, known = type(config).__name__.lower(), [item.name for item in fields(config)]
    if not isinstance(changes, Mapping):
        raise ConfigError(f"{section} is {changes!r}; it takes settings by name")
    values = {}
    for name, value in changes.items():
        if name not in known:
            parts = {part: getattr(config, part) for part in known if is_dataclass(getattr(config, part))}
            inner = [part for part, settings in parts.items() if name in asdict(settings)]
            hint = f"; give it as {' or '.join(f'{part}={{{name!r}: ...}}' for part in inner)}" if inner else ""
            hint = hint or suggest(name, known)
            raise ConfigError(f"there is no setting {name!r} in {section}{hint}")
        old = getattr(config, name)
        values[name] = override(old, value) if is_dataclass(old) and not isinstance(value, type(old)) else value
    return replace(config, **values)


def as_typed(words: Iterable[str]) -> str:
    """Words as one command line for a shell; on Windows in double quotes, which cmd and PowerShell both take."""
    if not WINDOWS:
        return shlex.join(words)
    plain = re.compile(r"[\w+=:./\\-]+")
    return " ".join(word if plain.fullmatch(word) else '"' + word.rstrip("\\") + '"' for word in words)


def json_object(text: str | bytes) -> dict[str, Any]:
    """The object that a JSON text holds; raises ValueError if it holds none."""
    try:
        content = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        raise ValueError("it is not JSON") from None
    if not isinstance(content, dict):
        raise ValueError("it is not a JSON object")
    return content
