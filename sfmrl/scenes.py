"""Who starts where and wants to go where: the paper's five environments and CrowdNav's circle crossing.

Every episode has a generator of its own, made from (seed, phase, episode), so episode 17 is the same whatever else is
sampled with it, and training, validation and test never share one. The rejection sampling itself runs over all
episodes at once. A square stands in the arrays as a resting row of its own (the disc inside it); ORCA's agents see
its outline as a polygon.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from numbers import Integral

import numpy as np

from sfmrl.config import ConfigError, in_range, suggest
from sfmrl.geometry import vectors
from sfmrl.maps.layouts import DRAWN, LAYOUTS, MAPS, drawing_of
from sfmrl.placement import RADIUS, V_PREF, Builder, circle_of, people_on_circle
from sfmrl.variants import MIXES

ENVIRONMENTS = {
    "1": "people on a circle (0.6) and separate squares (0.4), ten in all",
    "2": "a concave barrier in the middle, five people",
    "3": "a concave barrier somewhere in the middle, five people",
    "4": "a row of three squares and a row of two, five people",
    "5": "a concave barrier, a row of three and a row of two, nobody",
    "maps": "twenty layouts that no training samples, in turn; map-u, map-room ... are single ones",
    "circle": "ten people on a circle, no squares (CrowdNav); circle5 has five",
}
MAP_NAMES = [f"map-{name}" for name in LAYOUTS]
PHASES = ("train", "validation", "test", "imitation")
STREAMS = (*PHASES, "fit", "batches", "exploration", "sparse")  # everything that draws random numbers


@dataclass(frozen=True)
class Scenes:
    """Episodes yet to be played: E of them, N rows each, row 0 the robot.

    `start` and `goal` (E, N, 2) in m; `radius` in m and `v_pref` in m/s, (E, N) or anything that broadcasts to it.
    `square` (E, N) marks rows that are obstacles: squares of side 2 radius, with a resting disc inside. A row with NaN
    start is absent. `environment` (E,) and `episode` (E,) are labels for reports. Raises ValueError on bad shapes.
    """

    start: np.ndarray
    goal: np.ndarray
    radius: np.ndarray | float = RADIUS
    v_pref: np.ndarray | float = V_PREF
    square: np.ndarray | bool = False
    environment: np.ndarray | str = "own"
    episode: np.ndarray | None = None

    def __post_init__(self) -> None:
        start, goal = vectors("start", self.start).copy(), vectors("goal", self.goal).copy()
        if start.ndim != 3 or start.shape[-1] != 2 or start.shape[1] < 1:
            raise ValueError(f"start has shape {start.shape}; it must be (episodes, agents, 2), row 0 the robot")
        if goal.shape != start.shape:
            raise ValueError(f"goal has shape {goal.shape}; it must be that of start, {start.shape}")
        episodes, rows = start.shape[:2]
        made = {"start": start, "goal": goal}
        for name, shape, kind in (
            ("radius", (episodes, rows), float),
            ("v_pref", (episodes, rows), float),
            ("square", (episodes, rows), bool),
            ("environment", (episodes,), str),
            ("episode", (episodes,), int),
        ):
            value = np.arange(episodes) if getattr(self, name) is None else getattr(self, name)
            try:
                made[name] = np.broadcast_to(np.asarray(value, dtype=kind), shape).copy()
            except (TypeError, ValueError):
                raise ValueError(f"{name} must be of {kind.__name__} and broadcast to shape {shape}") from None
        if made["square"][:, 0].any():
            raise ValueError("square marks row 0, which is the robot")
        absent = np.isnan(start).any(-1)
        if absent[:, 0].any():
            raise ValueError("start has no robot: row 0 must not be NaN")
        if not np.isfinite(start[~absent]).all() or not np.isfinite(goal[~absent & ~made["square"]]).all():
            raise ValueError("start and goal must be finite for everyone who has a start")
        sizes = np.stack((made["radius"], made["v_pref"]))
        if not np.isfinite(sizes).all() or not (sizes[0] > 0).all() or not (sizes[1] >= 0).all():
            raise ValueError("radius must be above 0 m and v_pref not below 0 m/s, both finite")
        goal[made["square"]] = start[made["square"]]
        start[absent] = goal[absent] = np.nan
        for name, value in made.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.start)

    def take(self, rows: np.ndarray | slice) -> "Scenes":
        """The scenes of some episodes: an index array, a mask or a slice."""
        return Scenes(*(getattr(self, item.name)[rows] for item in fields(self)))

    @property
    def polygons(self) -> np.ndarray:
        """The squares' outlines (E, P, 4, 2), counter-clockwise, NaN where an episode has fewer than P."""
        most = int(self.square.sum(1).max(initial=0))
        order = np.argsort(~self.square, axis=1, kind="stable")[:, :most]
        centre = np.where(self.square[..., None], self.start, np.nan)[np.arange(len(self))[:, None], order]
        half = np.take_along_axis(self.radius, order, axis=1)[..., None, None]
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        return centre[:, :, None, :] + half * corners


def parse_mix(text: str) -> dict[str, float]:
    """Environments and their shares from "2", "table1" or "1:0.7,2:0.3"; raises ConfigError.

    A drawing, "map:R.#.G/..#..", is an environment that shares with no other.
    """
    if text.startswith(DRAWN):
        drawing_of(text)
        return {text: 1.0}
    shares: dict[str, float] = {}
    for part in MIXES.get(text, text).split(","):
        name, colon, share = part.strip().partition(":")
        if name not in ENVIRONMENTS and name not in MAP_NAMES and not re.fullmatch(r"circle\d{1,3}", name):
            known = [*ENVIRONMENTS, *MIXES]
            near = suggest(name, [*known, *MAP_NAMES])
            raise ConfigError(f"there is no environment {name!r}; choose {', '.join(known)}{near}")
        try:
            shares[name] = shares.get(name, 0.0) + (float(share) if colon else 1.0)
        except ValueError:
            raise ConfigError(f"the share of environment {name} is {share!r}; it must be a number") from None
    if not all(0 <= share <= 1 for share in shares.values()) or abs(sum(shares.values()) - 1) > 1e-9:
        raise ConfigError(f"the shares in {text!r} must be from 0 to 1 and add up to 1, as in 1:0.7,2:0.3")
    return shares


def elements_of(environment: str) -> int:
    """The most elements (people and squares) that an episode of an environment, or of a mix, can have."""
    return max(_elements(name) for name in parse_mix(environment))


def _elements(name: str) -> int:
    if name.startswith("circle"):
        return people_on_circle(name)
    if name == "maps":
        return max(LAYOUTS[layout].elements for layout in MAPS)
    drawing = drawing_of(name)
    return drawing.elements if drawing else 10


def generator(seed: int, stream: str, *number: int) -> np.random.Generator:
    """The random numbers of one stream, e.g. a phase's scenes, or of one `number` (an episode) in it."""
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
) -> Scenes:
    """Sample episodes of an environment, or of a mix of them, each from its own seed.

    `environment` is one of `ENVIRONMENTS`, a mix such as "1:0.7,2:0.3", or "table1", "table2", or a drawing
    "map:R.#.G/..#.." (see `maps.format`), labelled "map"; `episodes` is how many, or the numbers of those wanted. With
    `people`, that many, all on the circle, take the place of the environment's own; `people_speed` is their preferred
    speed, m/s; `circle` is the radius of the circle that people start on, m (default `circle_of(people)`). The result
    has a row for the robot and one for each element, people before squares. Raises ConfigError on names it does not
    know, and on numbers out of range.
    """
    in_range("seed", seed, 0, np.inf)
    if people is not None:
        in_range("people", people, 0, np.inf)
    if people_speed is not None:
        in_range("people_speed", people_speed, 0, 1e6, whole=False)
    circle = in_range("circle", circle_of(people) if circle is None else circle, RADIUS, 1e6, whole=False)
    environment = str(environment) if isinstance(environment, Integral) else environment
    if not isinstance(environment, str):
        raise ConfigError(f"environment is {environment!r}; it takes a name or a mix, as 2, table1 or 1:0.7,2:0.3")
    shares = parse_mix(environment)
    numbers = np.asarray(episodes)
    if not np.issubdtype(numbers.dtype, np.integer) or numbers.ndim > 1 or (numbers < 0).any():
        raise ConfigError(f"episodes is {episodes!r}; it takes how many, or their numbers, counted from 0")
    numbers = np.arange(numbers) if numbers.ndim == 0 else numbers
    if phase not in PHASES:
        raise ConfigError(f"there is no phase {phase!r}; choose {', '.join(PHASES)}{suggest(phase, PHASES)}")
    rngs = [generator(seed, phase, number) for number in numbers]
    # One draw decides the environment, also where there is but one: episode 17 of environment 2 is then the same
    # scene as episode 17 of a mix that puts it there.
    draw = np.array([rng.random() for rng in rngs])
    names = np.array(list(shares))
    picked = names[np.minimum(np.searchsorted(np.cumsum(list(shares.values())), draw, side="right"), len(names) - 1)]
    in_turn = np.array([f"map-{MAPS[number % len(MAPS)]}" for number in numbers], dtype=str)
    picked = np.where(picked == "maps", in_turn, picked)
    builder = Builder(rngs, 1 + elements_of(environment), circle)
    for name in np.unique(picked):
        builder.build(str(name), np.flatnonzero(picked == name))
    if people is not None:
        builder = builder.among(people)
    speed = np.full(builder.square.shape, V_PREF)
    if people_speed is not None:
        speed[:, 1:][~builder.square[:, 1:]] = people_speed
    labels = [label(name) for name in picked]
    return Scenes(builder.start, builder.goal, RADIUS, speed, builder.square, labels, numbers)


def thinned(scenes: Scenes, share: float, seed: int) -> Scenes:
    """The scenes, of which a `share` keep only none to three of their people and squares; drawn by episode."""
    start, square = scenes.start.copy(), scenes.square.copy()
    for e, rng in enumerate(generator(seed, "sparse", number) for number in scenes.episode):
        if rng.random() < share:
            there = 1 + np.flatnonzero(~np.isnan(start[e, 1:, 0]))
            gone = rng.permutation(there)[rng.integers(4) :]
            start[e, gone], square[e, gone] = np.nan, False
    return replace(scenes, start=start, square=square)


def label(environment: str) -> str:
    """What an environment is called in reports: its name, or "map" where that is a drawing."""
    return "map" if environment.startswith(DRAWN) else environment
