"""Every knob of sfmrl, once: its default, its unit, where it comes from, and what `--help` says of it.

Frozen dataclasses, checked when they are made. The plain defaults are the paper's ("Effects of a Social Force Model
reward in Robot Navigation based on Deep Reinforcement Learning", Gil and Sanfeliu) or, where it says "CrowdNav",
those of CrowdNav/SARL (Chen et al., 2019); `PRESETS` and `VARIANTS` are overrides as data.
"""

import difflib
import json
import math
from collections.abc import Mapping
from dataclasses import Field, asdict, dataclass, field, fields, is_dataclass, replace
from numbers import Integral, Real
from typing import Any


class ConfigError(ValueError):
    """A setting that cannot be used; its text is one line that names the setting and the remedy."""


class Untrusted(str):
    """Text that was read from a file: no code that it names is run (see `own_code.py`)."""


def knob(default: Any, help: str, low: float | None = None, high: float | None = None, choices: tuple = ()) -> Any:
    """A dataclass field with its help text, and the range (both ends included) or choices of its values.

    Every number has both ends, so that any value it may take gives finite numbers and work that can be done.
    """
    return field(default=default, metadata={"help": help, "range": (low, high), "choices": choices})


def in_range(name: str, value: Any, low: float, high: float, whole: bool = True) -> int | float:
    """`value` as a number from `low` to `high`; raises ConfigError, with the setting's `name`, where it is none."""
    if isinstance(value, bool) or not isinstance(value, Integral if whole else Real) or value != value:
        raise ConfigError(f"{name} is {value!r}; it takes a {'whole ' if whole else ''}number")
    if not low <= value <= high:
        bound, end = ("at least", low) if value < low else ("at most", high)
        raise ConfigError(f"{name} is {value}; it must be {bound} {end if whole else f'{end:g}'}")
    return int(value) if whole else float(value)


def checked(item: Field, value: Any) -> Any:
    """A field's value, held to the field's type, range and choices; raises ConfigError."""
    default, meta = item.default, item.metadata
    name = item.name.replace("_", "-")
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ConfigError(f"{name} is {value!r}; it takes true or false")
    elif isinstance(default, (int, float)):
        return in_range(name, value, *meta["range"], whole=isinstance(default, int))
    elif isinstance(default, str) and not isinstance(value, str):
        raise ConfigError(f"{name} is {value!r}; it takes text")
    elif is_dataclass(item.default_factory) and not isinstance(value, item.default_factory):
        raise ConfigError(f"{name} is {value!r}; it takes a {item.default_factory.__name__}")
    if meta.get("choices") and value not in meta["choices"]:
        raise ConfigError(f"{name} is {value!r}; choose {', '.join(meta['choices'])}{suggest(value, meta['choices'])}")
    return value


PAY = (-1e6, 1e6)  # range of rewards
EPISODES = 100_000  # at once: what is recorded of all has to fit into memory
STEPS = 100_000  # of an episode
SEED = 2**63 - 1
REACH = 10.0  # m, of `careful`: no environment of the paper is as large


def counted(number: int, noun: str) -> str:
    """Write a number with its noun in singular or plural: "1 episode", "2 episodes"."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def suggest(word: Any, known: Any) -> str:
    """The end of an error message: "; did you mean ...?" where a known word is close, else nothing."""
    close = difflib.get_close_matches(str(word), [str(item) for item in known], n=1)
    return f"; did you mean {close[0]}?" if close else ""


class _Checked:
    def __post_init__(self) -> None:
        for item in fields(self):
            object.__setattr__(self, item.name, checked(item, getattr(self, item.name)))


@dataclass(frozen=True)
class SocialForce(_Checked):
    """Parameters of equations 1 and 2; the defaults are the paper's, for the robot's state."""

    a: float = knob(1.0, "strength of the repulsion, m/s^2 (paper: a_z = 1)", 0, 1000)
    b: float = knob(1.0, "range of the repulsion, m (paper: b_z = 1)", 0.01, 1000)
    d: float = knob(0.0, "distance at which the repulsion is a, m (paper: d_z = 0)", -3, 3)
    k: float = knob(2.0, "rate at which the goal force corrects the velocity, 1/s", 0, 1000)


@dataclass(frozen=True)
class Simulation(_Checked):
    """How the crowd moves and when an episode ends; CrowdNav's values."""

    time_step: float = knob(0.25, "length of a step, s", 1e-3, 10)
    time_limit: float = knob(25.0, "an episode is timed out 1 s before this time, s (CrowdNav)", 1, 3600)
    crowd: str = knob("orca", "what drives the humans", choices=("orca", "sfm"))
    squares: str = knob(
        "solid",
        "gaps to squares are those to their outline (solid), or to the disc inside (disc; paper: d_t = d_i - r - r_i)",
        choices=("solid", "disc"),
    )
    robot_visible: bool = knob(True, "the humans see the robot (paper: they do)")
    safety_space: float = knob(0.0, "added to every radius when ORCA drives the robot, m", 0, 10)
    clearance: float = knob(0.01, "added to every radius inside ORCA, m (CrowdNav)", 0, 10)
    neighbor_distance: float = knob(10.0, "ORCA: agents farther away are ignored, m (CrowdNav)", 0, 1e6)
    max_neighbors: int = knob(10, "ORCA: number of nearest agents considered (CrowdNav)", 0, 1000)
    time_horizon: float = knob(5.0, "ORCA: how far ahead agents are avoided, s (CrowdNav)", 1e-3, 1000)
    obstacle_time_horizon: float = knob(5.0, "ORCA: how far ahead polygons are avoided, s (CrowdNav)", 1e-3, 1000)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.longest > STEPS:
            raise ConfigError(
                f"time-limit {self.time_limit:g} and time-step {self.time_step:g} make an episode of {self.longest} "
                f"steps; it may have {STEPS}, so choose a longer time-step or a shorter time-limit"
            )

    @property
    def longest(self) -> int:
        """Steps of the longest episode: as in CrowdNav, the first from 1 s before the time limit on is the last."""
        return math.ceil((self.time_limit - 1.0) / self.time_step - 1e-9) + 1


@dataclass(frozen=True)
class Reward(_Checked):
    """Numbers of the rewards: CrowdNav's, and the paper's second formula."""

    reward: str = knob("crowd", "crowd (CrowdNav), sfm, sfm-discount (paper), or your own: file.py:function")
    success: float = knob(1.0, "reward for reaching the goal (CrowdNav)", *PAY)
    collision: float = knob(-0.25, "reward for a collision (CrowdNav)", *PAY)
    discomfort_distance: float = knob(0.2, "closer than this is too close, m (CrowdNav)", 0, 1000)
    discomfort_slope: float = knob(
        0.125, "crowd: penalty per metre too close, in 0.25 s (CrowdNav: 0.5 a second)", *PAY
    )
    discomfort_amplitude: float = knob(-0.03, "sfm: reward at zero separation (the paper's A)", *PAY)
    discomfort_decay: float = knob(10.0, "sfm: how fast it fades with separation, 1/m (the paper's B)", 0, 1e6)
    k: float = knob(0.001, "sfm: weight of moving at the preferred velocity (the paper's k)", *PAY)
    distance_weight: float = knob(0.0001, "sfm: penalty per metre from the goal", *PAY)
    discount_start: float = knob(10.0, "sfm-discount: arriving later than this costs, s", 0, 3600)
    discount_rate: float = knob(0.02, "sfm-discount: cost per second late", *PAY)


@dataclass(frozen=True)
class Planner(_Checked):
    """Recovery at play, and the grid on which ways around squares are measured."""

    recover: bool = knob(False, "at play, lead a robot that is stuck around squares, look farther for traps (ours)")
    stall_time: float = knob(2.0, "recover: time without progress after which the robot is stuck, s", 0, 3600)
    stall_distance: float = knob(0.25, "recover: progress is a path to the goal shorter by this, m", 0, 1000)
    resolution: float = knob(0.1, "paths around squares: side of the grid's cells, m", 0.02, 10)
    inflation: float = knob(
        0.1, "paths around squares: nearer to a square than this, a path counts as longer, m", 0, 10
    )


@dataclass(frozen=True)
class Imitation(_Checked):
    """Learning from ORCA's demonstrations; the paper's numbers."""

    episodes: int = knob(3000, "demonstrations by ORCA", 1, EPISODES)
    epochs: int = knob(50, "passes over the demonstrations", 1, 10_000)
    batch_size: int = knob(100, "states in a batch", 1, 100_000)
    learning_rate: float = knob(0.01, "learning rate", 0, 1000)
    refit: bool = knob(True, "rl: fit the demonstrations again if its reward differs from that of il (paper)")
    environment: str = knob("1", "environments of the demonstrations")


@dataclass(frozen=True)
class Reinforcement(_Checked):
    """Deep V-learning; the paper's numbers, CrowdNav's where it is silent."""

    episodes: int = knob(10_000, "training episodes", 1, 10_000_000)
    parallel: int = knob(1, "episodes played side by side, while the last ones are learnt from; for speed", 1, 10_000)
    batches: int = knob(100, "batches of learning an episode (CrowdNav)", 0, 10_000)
    batch_size: int = knob(100, "states in a batch", 1, 100_000)
    learning_rate: float = knob(0.001, "learning rate", 0, 1000)
    epsilon_start: float = knob(0.5, "share of random actions at the start (CrowdNav)", 0, 1)
    epsilon_end: float = knob(0.1, "share of random actions in the end (CrowdNav)", 0, 1)
    epsilon_episodes: int = knob(4000, "episodes from the first share to the last (CrowdNav)", 1, 10_000_000)
    targets: str = knob(
        "td",
        "learn td, the reward plus the target's next value, or returns, all that followed up to the next random action "
        "(Watkins, 1989); td drops time-outs, as CrowdNav",
        choices=("td", "returns"),
    )
    retry: bool = knob(False, "play up to half of each round in scenes where the robot failed at its last try (ours)")
    target_interval: int = knob(50, "episodes between updates of the target network (CrowdNav)", 1, 10_000_000)
    memory: int = knob(100_000, "states kept to learn from (CrowdNav)", 1, 10_000_000)
    average: int = knob(
        0, "number of batches over which the tested weights are averaged (Polyak, 1992); 0: off", 0, 10_000_000
    )
    environment: str = knob("table1", "environments to train in, and their shares")
    test_environment: str = knob(
        "table1",
        "environments of validation and test, unless --environment is given alone (paper: table 1's mix in all rows)",
    )
    validation_interval: int = knob(1000, "episodes between validations", 1, 10_000_000)
    validation_episodes: int = knob(100, "episodes of a validation", 1, EPISODES)
    test_episodes: int = knob(500, "episodes of the final test", 1, EPISODES)
    test_best: bool = knob(False, "test the weights of the best validation as well as the last")


@dataclass(frozen=True)
class Config(_Checked):
    """Everything that decides a training's numbers."""

    seed: int = knob(0, "seed of everything random", 0, SEED)
    preset: str = knob("quick", "schedule: minutes, or as published (hours)", choices=("quick", "paper"))
    forces: bool = knob(False, "social forces in the state: 17 columns instead of 13")
    discount: float = knob(0.9, "discount per second at 1 m/s (CrowdNav's gamma)", 0, 1)
    value_prior: bool = knob(False, "write the value as 0.9^(goal distance - 0.3) (0.8 + network) (ours)")
    careful: bool = knob(
        False,
        "look ahead with care: a collision ends it, traps are avoided, what is over 10 m away is left out, and the way "
        "is straight where nothing is left (ours)",
    )
    optimizer: str = knob(
        "sgd",
        "sgd: momentum 0.9, constant learning rate; adam (Kingma and Ba, 2015): the rate falls to 0 in a straight line",
        choices=("sgd", "adam"),
    )
    mirror: bool = knob(False, "mirror half of each batch left to right, which changes no state's value (ours)")
    sparse: float = knob(0.0, "share of the training episodes that keep at most three people and squares (ours)", 0, 1)
    simulation: Simulation = field(default_factory=Simulation)
    reward: Reward = field(default_factory=Reward)
    planner: Planner = field(default_factory=Planner)
    imitation: Imitation = field(default_factory=Imitation)
    reinforcement: Reinforcement = field(default_factory=Reinforcement)

    @property
    def reach(self) -> float:
        """How far away what the network sees may be, m."""
        return REACH if self.careful else math.inf

    def to_json(self) -> str:
        """The whole config as indented JSON."""
        return json.dumps(asdict(self), indent=2)

    @staticmethod
    def from_json(text: str | bytes) -> "Config":
        """The config that `to_json` wrote; raises ConfigError on unknown keys and bad values.

        Its reward's name is `Untrusted`: one that names Python code is not run, unless `own_code.trusted` says so.
        """
        try:
            changes = json_object(text)
        except ValueError as error:
            raise ConfigError(str(error)) from None
        if set(RETIRED) & set(changes):
            raise ConfigError("it was made by version 0.1 or 0.2 of sfmrl; install that version to play it")
        config = override(Config(), changes)
        return override(config, {"reward": {"reward": Untrusted(config.reward.reward)}})


# Settings that only files of earlier versions have; their networks were trained among squares that are discs.
RETIRED = ("shaping", "precision", "collision_ends", "avoid_traps")


def override(config: Any, changes: Mapping[str, Any]) -> Any:
    """A copy of a config dataclass with `changes`, which may nest as the config does; unknown keys are errors."""
    if not isinstance(changes, Mapping):
        raise ConfigError(f"{type(config).__name__.lower()} is {changes!r}; it takes settings by name")
    values = {}
    known = [item.name for item in fields(config)]
    for name, value in changes.items():
        if name not in known:
            raise ConfigError(f"there is no setting {name!r} in {type(config).__name__.lower()}{suggest(name, known)}")
        old = getattr(config, name)
        values[name] = override(old, value) if is_dataclass(old) else value
    return replace(config, **values)


def json_object(text: str | bytes) -> dict[str, Any]:
    """The object that a JSON text holds; raises ValueError where it holds none."""
    try:
        content = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        raise ValueError("it is not JSON") from None
    if not isinstance(content, dict):
        raise ValueError("it is not a JSON object")
    return content


# The crowd's own social forces, for `--crowd sfm`: Helbing and Molnar's 2.1 m^2/s^2 over 0.3 m, from surface to
# surface, and a relaxation time of 0.5 s. The paper's (1, 1, 0) describes the robot's surroundings, from centre to
# centre; as a crowd model it would let people walk through each other.
CROWD_FORCE = SocialForce(a=7.0, b=0.3, d=0.0, k=2.0)

# What `help(sfmrl.Reward)` and the like show: every knob with its help text.
for _settings in (SocialForce, Simulation, Reward, Planner, Imitation, Reinforcement, Config):
    _lines = [f"    {item.name}: {item.metadata.get('help', 'its section')}" for item in fields(_settings)]
    _settings.__doc__ = "\n".join((f"{_settings.__doc__}\n", *_lines))
