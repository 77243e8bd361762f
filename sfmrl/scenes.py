"""Scenes (starts and goals of all agents), and how they are sampled from environments.

Each episode has its own random generator, made from (seed, phase, episode). So episode 17 is the same whatever else is
sampled with it, and training, validation and test never share one. Drawings are environments too (`sfmrl.maps`).
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cache
from numbers import Integral
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from sfmrl.batch import Batch
from sfmrl.config import ConfigError, counted, in_range, suggest
from sfmrl.geometry import vectors
from sfmrl.placement import CIRCLE, PAPER, RADIUS, V_PREF, Builder, squares_of
from sfmrl.variants import MIXES

ENVIRONMENTS = {
    "1": "people on a circle (0.6) and separate squares (0.4), ten in all",
    "2": "a concave barrier in the middle, five people",
    "3": "a concave barrier somewhere in the middle, five people",
    "4": "a row of three squares and a row of two, five people",
    "5": "a concave barrier, a row of three and a row of two, no people",
    "maps": "twenty layouts that no training samples, in turn; map-u, map-room ... are single ones",
    "circle": "ten people on a circle, no squares (CrowdNav); circle5 has five",
    "square": "ten people who cross a square of 10 m, no squares in it (CrowdNav); square5 has five",
}
DRAWN = "map:"  # begins the name of an environment that is a drawing, its lines joined by "/"
PHASES = ("train", "validation", "test", "imitation")
STREAMS = (*PHASES, "fit", "batches", "exploration")  # all random numbers but a new network's; the index is a seed


@dataclass(frozen=True, repr=False)
class Scenes(Batch):
    """Starts and goals of E episodes of N rows each: row 0 the robot, then people and squares.

    `start` and `goal` (E, N, 2) in m; `radius` in m and `v_pref` in m/s, (E, N) or anything that broadcasts to it.
    `square` (E, N) marks squares, of side 2 radius. A row with NaN start is absent. `environment` (E,) and `episode`
    (E,) are labels for reports. `v_pref` is everybody's highest speed and, unless `preferred_speed` in m/s, (E, N) or
    broadcast to it, is given, also the preferred one. Raises ValueError on bad shapes and values.
    """

    start: np.ndarray
    goal: np.ndarray
    radius: np.ndarray = cast(Any, RADIUS)
    v_pref: np.ndarray = cast(Any, V_PREF)
    square: np.ndarray = cast(Any, False)
    environment: np.ndarray = cast(Any, "own")
    episode: np.ndarray = cast(Any, None)
    preferred_speed: np.ndarray | None = None

    if TYPE_CHECKING:  # what it takes, before __post_init__ makes arrays of it

        def __init__(
            self, start: ArrayLike, goal: ArrayLike, radius: ArrayLike = RADIUS, v_pref: ArrayLike = V_PREF,
            square: ArrayLike = False, environment: ArrayLike = "own", episode: ArrayLike | None = None,
            preferred_speed: ArrayLike | None = None,
        ) -> None: ...  # fmt: skip

    def __post_init__(self) -> None:
        start, goal = vectors("start", self.start).copy(), vectors("goal", self.goal).copy()
        if start.ndim != 3 or start.shape[1] < 1:
            raise ValueError(f"start has shape {start.shape}; it must be (episodes, agents, 2), row 0 the robot")
        if goal.shape != start.shape:
            raise ValueError(f"goal has shape {goal.shape}; it must be that of start, {start.shape}")
        shape = start.shape[:2]
        radius, v_pref = _filled("radius", self.radius, float, shape), _filled("v_pref", self.v_pref, float, shape)
        square = _filled("square", self.square, bool, shape)
        environment = _filled("environment", self.environment, str, shape[:1])
        episode = _filled("episode", np.arange(shape[0]) if self.episode is None else self.episode, int, shape[:1])
        own = self.preferred_speed is not None
        speed = _filled("preferred_speed", self.preferred_speed, float, shape) if own else v_pref
        absent = np.isnan(start).any(-1)
        if square[:, 0].any():
            raise ValueError("square marks row 0, which is the robot")
        if absent[:, 0].any():
            raise ValueError("start has no robot: row 0 must not be NaN")
        if not np.isfinite(start[~absent]).all() or not np.isfinite(goal[~absent & ~square]).all():
            raise ValueError("start and goal must be finite for everyone who has a start")
        if not np.isfinite((radius, v_pref, speed)).all() or (radius <= 0).any() or ((v_pref < 0) | (speed < 0)).any():
            raise ValueError("radius must be above 0 m, v_pref and preferred_speed at least 0 m/s, and all finite")
        goal[square] = start[square]
        start[absent] = goal[absent] = np.nan
        checked = (start, goal, radius, v_pref, square, environment, episode, speed if own else None)
        for item, value in zip(fields(self), checked, strict=True):
            if isinstance(value, np.ndarray):
                value.flags.writeable = False  # a world begins with these arrays
            object.__setattr__(self, item.name, value)

    def __repr__(self) -> str:
        return f"Scenes({counted(len(self), 'episode')} of environment {', '.join(np.unique(self.environment))})"

    def _repr_html_(self) -> str:
        from sfmrl.replay.picture import scenes_html

        return scenes_html(self)

    @property
    def polygons(self) -> np.ndarray:
        """The squares' outlines (E, P, 4, 2), counter-clockwise, NaN if an episode has fewer than P."""
        rows, centre = squares_of(self.start, self.square)
        half = np.take_along_axis(self.radius, rows, axis=1)
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        return centre[:, :, None] + half[..., None, None] * corners


def _filled(name: str, value: Any, kind: type, shape: tuple[int, ...]) -> np.ndarray:
    """A new array of a `shape` to which `value` broadcasts; raises ValueError, with its `name`, if it does not."""
    try:
        return np.broadcast_to(np.asarray(value, dtype=kind), shape).copy()
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be of {kind.__name__} and broadcast to shape {shape}") from None


def generator(seed: int, stream: str, *number: int) -> np.random.Generator:
    """The random generator of a stream in `STREAMS`, such as a phase, or of the episode `number` in that stream."""
    return np.random.default_rng([seed, STREAMS.index(stream), *number])


def sample_scenes(
    environment: str | int,
    episodes: int | Sequence[int],
    seed: int = 0,
    *,
    phase: str = "test",
    circle: float | None = None,
    people: int | None = None,
    people_speed: float | None = None,
    random_attributes: bool = False,
) -> Scenes:
    """Sample episodes of an environment, or of a mix of them, each from its own seed.

    `environment` is one of `ENVIRONMENTS`, a mix ("1:0.7,2:0.3", "table1", "table2"), or a drawing "map:R.#.G/..#.."
    (see `sfmrl.maps`); `episodes` is their number, or a list of their numbers. `people` is the number of people on the
    circle that replace the environment's own, `people_speed` their preferred speed, m/s, and `circle` the radius of the
    circle, m (default `circle_of(people)`). With `random_attributes`, people have a radius from 0.3 to 0.5 m (on maps
    0.3 m) and a v_pref from 0.5 to 1.5 m/s, which only limits their speed: as in CrowdNav, they prefer 1 m/s. The
    circle grows if it has no room for them. Row 0 is the robot, then come people, then squares. Raises ConfigError on
    unknown names, and on numbers out of range.
    """
    shares, numbers = parse_mix(environment), _numbers(episodes)
    if phase not in PHASES:
        raise ConfigError(f"there is no phase {phase!r}; choose {', '.join(PHASES)}{suggest(phase, PHASES)}")
    in_range("seed", seed, 0, np.inf)
    in_range("people", people or 0, 0, np.inf)
    circle = in_range("circle", circle_of(people) if circle is None else circle, RADIUS, 1e6, whole=False)
    if random_attributes and people_speed is not None:
        raise ConfigError(
            "a speed for all humans (--human-speed) and --random-attributes exclude each other; leave out one"
        )

    rngs = [generator(seed, phase, number) for number in numbers]
    environments = [environment_of(name) for name in shares]
    builder = Builder(rngs, numbers, 1 + max(e.elements for e in environments), circle, random_attributes)
    builder.mix(environments, list(shares.values()))
    if people is not None:
        builder = builder.with_people(people)
    if people_speed is not None:
        speed = in_range("people_speed", people_speed, 0, 1e6, whole=False)
        builder.v_pref[:, 1:] = np.where(builder.square[:, 1:], V_PREF, speed)
    places = builder.start, builder.goal, builder.radius, builder.v_pref, builder.square
    return Scenes(*places, builder.label, numbers, V_PREF if random_attributes else None)


def _numbers(episodes: int | Sequence[int]) -> np.ndarray:
    """The numbers (E,) of episodes that are given by their count or their numbers; raises ConfigError."""
    numbers = np.asarray(episodes if np.size(episodes) else 0)  # an empty list would be one of floats
    if not np.issubdtype(numbers.dtype, np.integer) or numbers.ndim > 1 or (numbers < 0).any():
        raise ConfigError(f"episodes is {episodes!r}; it takes their count, or a list of their numbers, counted from 0")
    return np.arange(numbers.item()) if numbers.ndim == 0 else numbers


def parse_mix(environment: str | int) -> dict[str, float]:
    """Environments and their shares from "2", "table1" or "1:0.7,2:0.3"; raises ConfigError.

    A drawing, "map:R.#.G/..#..", cannot be mixed with others.
    """
    if not isinstance(environment, (str, Integral)):
        raise ConfigError(f"environment is {environment!r}; it takes a name or a mix, such as 2 or 1:0.7,2:0.3")
    text = str(environment)
    if text.startswith(DRAWN):
        environment_of(text)
        return {text: 1.0}
    shares: dict[str, float] = {}
    for part in MIXES.get(text, text).split(","):
        name, colon, share = part.strip().partition(":")
        if name in MIXES:
            raise ConfigError(f"{name} is a mix itself and cannot be mixed; write shares, as in {MIXES['table1']}")
        environment_of(name)
        try:
            shares[name] = shares.get(name, 0.0) + (float(share) if colon else 1.0)
        except ValueError:
            raise ConfigError(f"the share of environment {name} is {share!r}; it must be a number") from None
    if not all(0 <= share <= 1 for share in shares.values()) or abs(sum(shares.values()) - 1) > 1e-9:
        raise ConfigError(f"the shares in {text!r} must be from 0 to 1 and add up to 1, as in 1:0.7,2:0.3")
    return shares


def elements_of(mix: str | int) -> int:
    """The largest number of elements (people and squares) in an episode of an environment or a mix."""
    return max(environment_of(name).elements for name in parse_mix(mix))


def label(environment: str) -> str:
    """The name of an environment or a mix in reports: "map" for a drawing."""
    return "map" if environment.startswith(DRAWN) else environment


def circle_of(people: int | None = None) -> float:
    """Radius of the circle that people start on, m: from ten people on proportional to their number."""
    return CIRCLE * max(1.0, (people or 0) / 10)


@dataclass(frozen=True)
class Environment:
    """The people and squares of an environment; a drawing (`sfmrl.maps.Drawing`) has the same members.

    label: its name in reports
    place: puts people and squares into the episodes `which` (indices) of a `Builder`
    elements: the largest number of people and squares in an episode
    """

    label: str
    place: Callable[[Builder, np.ndarray], None]
    elements: int = 10


@cache
def environment_of(name: str) -> Environment:
    """The environment with a name: "1" to "5", "circle", "square5", "maps", "map-u" or a drawing, "map:R.#.G/..#..".

    Raises ConfigError on unknown names, and on drawings that cannot be read.
    """
    if name in PAPER:
        return Environment(name, PAPER[name])
    if match := re.fullmatch(r"(circle|square)(\d{1,3})?", name):
        people, crossing = int(match[2] or 10), match[1] == "square"
        return Environment(name, lambda builder, which: builder.people(which, people, crossing), people)
    from sfmrl.maps import layouts, map_environment  # here, since the core does without maps

    if environment := map_environment(name):
        return cast(Environment, environment)  # or a drawing, with the same members
    known, near = [*ENVIRONMENTS, *MIXES], suggest(name, [*ENVIRONMENTS, *MIXES, *layouts()])
    raise ConfigError(f"there is no environment {name!r}; choose {', '.join(known)}{near}")
