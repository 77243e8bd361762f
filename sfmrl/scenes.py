"""Who starts where and goes where: the paper's five environments and CrowdNav's circle crossing.

An environment puts people and squares into its episodes, by rejection sampling for all of them at once. Every episode
has a random generator of its own, made from (seed, phase, episode): episode 17 is the same whatever else is sampled
with it, and training, validation and test never share one. A square is a row of its own, a resting disc inside it;
ORCA's agents avoid its outline. Scenes that are drawn in text are environments too (`sfmrl.maps`).
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from numbers import Integral
from typing import Any

import numpy as np

from sfmrl.batch import Batch
from sfmrl.config import ConfigError, in_range, suggest
from sfmrl.geometry import vectors
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
DRAWN = "map:"  # begins the name of an environment that is a drawing, its lines joined by "/"
PHASES = ("train", "validation", "test", "imitation")
STREAMS = (*PHASES, "fit", "batches", "exploration", "sparse")  # all that draws random numbers; the index is a seed

RADIUS, V_PREF, SIDE = 0.3, 1.0, 0.6  # m, m/s, m: of every disc, of every agent, of every square
CIRCLE, NOISE = 4.0, 0.5  # m: people start on this circle, moved by at most NOISE in x and in y
GAP = 0.2  # m: between a person's disc and every start and goal
SQUARE_GAP = 0.9  # m: from a square's centre to every other centre, start and goal
SQUARE_REACH = 3.2  # m: environment 1's squares lie in this disc
ATTEMPTS = 4  # proposals drawn at a time for one place

# Squares' centres relative to the group's own, m: the barrier is open towards the robot, which comes from below.
BARRIER = np.array([[-0.6, 0.0], [0.0, 0.0], [0.6, 0.0], [-0.6, -0.6], [0.6, -0.6]])
ROW3 = np.array([[-0.6, 0.0], [0.0, 0.0], [0.6, 0.0]])
ROW2 = np.array([[-0.3, 0.0], [0.3, 0.0]])
MIDDLE = 1.5  # m: a group's centre is at most this far from the middle in x and in y


@dataclass(frozen=True)
class Scenes(Batch):
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
        if start.ndim != 3 or start.shape[1] < 1:
            raise ValueError(f"start has shape {start.shape}; it must be (episodes, agents, 2), row 0 the robot")
        if goal.shape != start.shape:
            raise ValueError(f"goal has shape {goal.shape}; it must be that of start, {start.shape}")
        shape = start.shape[:2]
        radius, v_pref = _filled("radius", self.radius, float, shape), _filled("v_pref", self.v_pref, float, shape)
        square = _filled("square", self.square, bool, shape)
        environment = _filled("environment", self.environment, str, shape[:1])
        episode = np.arange(shape[0]) if self.episode is None else _filled("episode", self.episode, int, shape[:1])
        if square[:, 0].any():
            raise ValueError("square marks row 0, which is the robot")
        absent = np.isnan(start).any(-1)
        if absent[:, 0].any():
            raise ValueError("start has no robot: row 0 must not be NaN")
        if not np.isfinite(start[~absent]).all() or not np.isfinite(goal[~absent & ~square]).all():
            raise ValueError("start and goal must be finite for everyone who has a start")
        if not np.isfinite((radius, v_pref)).all() or not (radius > 0).all() or not (v_pref >= 0).all():
            raise ValueError("radius must be above 0 m and v_pref not below 0 m/s, both finite")
        goal[square] = start[square]
        start[absent] = goal[absent] = np.nan
        checked = (start, goal, radius, v_pref, square, environment, episode)
        for item, value in zip(fields(self), checked, strict=True):
            object.__setattr__(self, item.name, value)

    def __len__(self) -> int:
        return len(self.start)

    @property
    def polygons(self) -> np.ndarray:
        """The squares' outlines (E, P, 4, 2), counter-clockwise, NaN where an episode has fewer than P."""
        rows, centre = _squares(self.start, self.square)
        half = np.take_along_axis(self.radius, rows, axis=1)
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        return centre[:, :, None] + half[..., None, None] * corners


def _filled(name: str, value: Any, kind: type, shape: tuple[int, ...]) -> np.ndarray:
    """A new array of a `shape` that `value` broadcasts to; raises ValueError, with its `name`, where it does not."""
    try:
        return np.broadcast_to(np.asarray(value, dtype=kind), shape).copy()
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be of {kind.__name__} and broadcast to shape {shape}") from None


def _squares(start: np.ndarray, square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (E, P) and centres (E, P, 2) of each episode's squares; the centres of those beyond its last are NaN."""
    most = int(square.sum(1).max(initial=0))
    rows = np.argsort(~square, axis=1, kind="stable")[:, :most]  # squares first, in the order of their rows
    centre = np.where(square[..., None], start, np.nan)
    return rows, np.take_along_axis(centre, rows[..., None], axis=1)


def generator(seed: int, stream: str, *number: int) -> np.random.Generator:
    """The generator of one of `STREAMS`, e.g. of a phase, or of one `number` (an episode) in it."""
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
    "map:R.#.G/..#.." (see `sfmrl.maps`), labelled "map"; `episodes` is their number, or a list of episode numbers.
    `people`, if given, is how many people take the place of the environment's own, all on the circle; `people_speed`
    is their preferred speed, m/s; `circle` is the radius of the circle that people start on, m (default
    `circle_of(people)`). The result has a row for the robot and one for each element, people before squares. Raises
    ConfigError on unknown names, and on numbers out of range.
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
    picked = np.searchsorted(np.cumsum(list(shares.values())), draw, side="right")
    picked = np.minimum(picked, len(shares) - 1)  # shares may add up to a little less than 1
    builder = Builder(rngs, numbers, 1 + elements_of(environment), circle)
    for k, name in enumerate(shares):
        builder.place(environment_of(name), np.flatnonzero(picked == k))
    if people is not None:
        builder = builder.with_people(people)
    speed = np.full(builder.square.shape, V_PREF)
    if people_speed is not None:
        speed[:, 1:][~builder.square[:, 1:]] = people_speed
    return Scenes(builder.start, builder.goal, RADIUS, speed, builder.square, builder.label, numbers)


def thinned(scenes: Scenes, share: float, seed: int) -> Scenes:
    """Thin a `share` of the scenes, chosen by episode: of their people and squares only none to three stay."""
    start, square = scenes.start.copy(), scenes.square.copy()
    for e, rng in enumerate(generator(seed, "sparse", number) for number in scenes.episode):
        if rng.random() < share:
            present = 1 + np.flatnonzero(~np.isnan(start[e, 1:, 0]))
            removed = rng.permutation(present)[rng.integers(4) :]
            start[e, removed], square[e, removed] = np.nan, False
    return replace(scenes, start=start, square=square)


def parse_mix(text: str) -> dict[str, float]:
    """Environments and their shares from "2", "table1" or "1:0.7,2:0.3"; raises ConfigError.

    A drawing, "map:R.#.G/..#..", cannot be mixed with others.
    """
    if text.startswith(DRAWN):
        environment_of(text)
        return {text: 1.0}
    shares: dict[str, float] = {}
    for part in MIXES.get(text, text).split(","):
        name, colon, share = part.strip().partition(":")
        environment_of(name)
        try:
            shares[name] = shares.get(name, 0.0) + (float(share) if colon else 1.0)
        except ValueError:
            raise ConfigError(f"the share of environment {name} is {share!r}; it must be a number") from None
    if not all(0 <= share <= 1 for share in shares.values()) or abs(sum(shares.values()) - 1) > 1e-9:
        raise ConfigError(f"the shares in {text!r} must be from 0 to 1 and add up to 1, as in 1:0.7,2:0.3")
    return shares


def elements_of(mix: str) -> int:
    """The most elements (people and squares) that an episode of an environment, or of a mix, can have."""
    return max(environment_of(name).elements for name in parse_mix(mix))


def label(environment: str) -> str:
    """What reports call an environment or a mix: its name, or "map" for a drawing."""
    return "map" if environment.startswith(DRAWN) else environment


def circle_of(people: int | None = None) -> float:
    """Radius of the circle that people start on, m: for more than ten people it grows, so that they stand as close."""
    return CIRCLE * max(1.0, (people or 0) / 10)


@dataclass(frozen=True)
class Environment:
    """What an episode holds besides the robot. A drawing (`sfmrl.maps.Drawing`) is one too: it has the same members.

    label: its name in reports
    place: puts people and squares into the episodes `which` (indices) of a `Builder`
    elements: the most people and squares that an episode can have
    """

    label: str
    place: Callable[["Builder", np.ndarray], None]
    elements: int = 10


@cache
def environment_of(name: str) -> Environment:
    """The environment with a name: "1" to "5", "circle", "circle5", "maps", "map-u" or a drawing, "map:R.#.G/..#..".

    Raises ConfigError on unknown names, and on drawings that cannot be read.
    """
    if name in PAPER:
        return Environment(name, PAPER[name])
    if match := re.fullmatch(r"circle(\d{1,3})?", name):
        people = int(match[1] or 10)
        return Environment(name, lambda builder, which: builder.people(which, people), people)
    from sfmrl.maps import layouts, map_environment  # here, since the core does without maps

    if environment := map_environment(name):
        return environment
    known = [*ENVIRONMENTS, *MIXES]
    near = suggest(name, [*known, *layouts()])
    raise ConfigError(f"there is no environment {name!r}; choose {', '.join(known)}{near}")


# The paper's five environments: the ten elements are rows 1 to 10, people before squares. Whatever is placed later
# keeps clear of what is there already.


def _people_and_squares(builder: "Builder", which: np.ndarray) -> None:
    people = np.array([(builder.rngs[e].random(10) < 0.6).sum() for e in which], dtype=int)
    for row in range(1, 11):
        builder.person(which[people >= row], row)
        builder.separate_square(which[people < row], row)


def _fixed_barrier(builder: "Builder", which: np.ndarray) -> None:
    builder.put(which, 6, BARRIER)
    builder.people(which, 5)


def _barrier(builder: "Builder", which: np.ndarray) -> None:
    builder.group(which, 6, BARRIER)
    builder.people(which, 5)


def _two_rows(builder: "Builder", which: np.ndarray) -> None:
    builder.group(which, 6, ROW3, turn=True)
    builder.group(which, 9, ROW2, turn=True)
    builder.people(which, 5)


def _barrier_and_two_rows(builder: "Builder", which: np.ndarray) -> None:
    builder.group(which, 1, BARRIER)
    builder.group(which, 6, ROW3, turn=True)
    builder.group(which, 9, ROW2, turn=True)


PAPER = {"1": _people_and_squares, "2": _fixed_barrier, "3": _barrier, "4": _two_rows, "5": _barrier_and_two_rows}


class Builder:
    """E episodes in the making: people and squares are placed one after the other, in many episodes at once.

    Each episode's generator proposes places, ATTEMPTS at a time, and the first that fits is taken; so an episode does
    not depend on the others. `start` and `goal` (E, N, 2), in m, are NaN in rows not yet placed; `square` (E, N) marks
    squares; `label` (E,) is the environment and `numbers` (E,) the number of each episode.
    """

    def __init__(self, rngs: list[np.random.Generator], numbers: np.ndarray, rows: int, circle: float) -> None:
        self.rngs, self.numbers, self.circle = rngs, numbers, circle
        self.points = np.full((2, len(rngs), rows, 2), np.nan)
        self.start, self.goal = self.points
        self.start[:, 0], self.goal[:, 0] = (0.0, -4.0), (0.0, 4.0)
        self.square = np.zeros((len(rngs), rows), dtype=bool)
        self.label = np.full(len(rngs), "", dtype=object)

    def place(self, environment: Environment, which: np.ndarray) -> None:
        """Fill the episodes `which` (indices) with an environment's people and squares."""
        self.label[which] = environment.label
        environment.place(self, which)

    def with_people(self, people: int) -> "Builder":
        """The same robot and squares with `people` people, all on the circle, instead of those placed so far."""
        _, centre = _squares(self.start, self.square)
        other = Builder(self.rngs, self.numbers, 1 + people + centre.shape[1], self.circle)
        other.label = self.label
        other.points[:, :, 0], other.points[:, :, 1 + people :] = self.points[:, :, 0], centre
        other.square[:, 1 + people :] = ~np.isnan(centre[..., 0])
        other.people(np.arange(len(self.rngs)), people)
        return other

    def put(self, which: np.ndarray, row: int, centres: np.ndarray) -> None:
        """Squares with these centres, (P, 2) or (n, P, 2), in rows from `row` on."""
        rows = slice(row, row + centres.shape[-2])
        self.start[which, rows] = self.goal[which, rows] = centres
        self.square[which, rows] = True

    def people(self, which: np.ndarray, count: int) -> None:
        """People in the rows from 1 to `count`."""
        for row in range(1, count + 1):
            self.person(which, row)

    def person(self, which: np.ndarray, row: int) -> None:
        """A person near the circle, who goes to the opposite point, clear of everything placed so far."""

        def propose(draws: np.ndarray) -> np.ndarray:  # (n, T, 3) -> start and goal (n, T, 2, 2)
            angle = 2 * np.pi * draws[..., 0]
            start = self.circle * np.stack((np.cos(angle), np.sin(angle)), -1) + NOISE * (2 * draws[..., 1:] - 1)
            return np.stack((start, -start), axis=2)

        place = self._first(which, 3, propose, partial(self._clear, disc_gap=2 * RADIUS + GAP), f"person {row}")
        self.start[which, row], self.goal[which, row] = place[:, 0], place[:, 1]

    def separate_square(self, which: np.ndarray, row: int) -> None:
        """A square in environment 1's disc, clear of everything placed so far."""

        def propose(draws: np.ndarray) -> np.ndarray:  # uniform in the disc: (n, T, 2) -> (n, T, 1, 2)
            angle, reach = 2 * np.pi * draws[..., 0], SQUARE_REACH * np.sqrt(draws[..., 1])
            return np.stack((reach * np.cos(angle), reach * np.sin(angle)), -1)[:, :, None, :]

        place = self._first(which, 2, propose, partial(self._clear, disc_gap=SQUARE_GAP), f"square {row}")
        self.put(which, row, place)

    def group(self, which: np.ndarray, row: int, shape: np.ndarray, *, turn: bool = False) -> None:
        """Touching squares at `shape` (P, 2), m, about a random centre in the middle, overlapping no other square.

        With `turn`, half of the groups are turned by 90 degrees.
        """

        def propose(draws: np.ndarray) -> np.ndarray:  # (n, T, 3) -> (n, T, P, 2)
            turned = (draws[..., 2] < 0.5)[..., None, None] & turn
            centre = MIDDLE * (2 * draws[..., :2] - 1)
            return centre[:, :, None, :] + np.where(turned, shape[:, ::-1], shape)

        def fits(places: np.ndarray, episodes: np.ndarray) -> np.ndarray:
            there = np.where(self.square[episodes, :, None], self.start[episodes], np.inf)
            apart = np.abs(places[:, :, :, None, :] - there[:, None, None]).max(-1)  # (n, T, P, N)
            return (apart >= SIDE).all((2, 3))

        self.put(which, row, self._first(which, 3, propose, fits, "a row of squares"))

    def _clear(self, places: np.ndarray, episodes: np.ndarray, disc_gap: float) -> np.ndarray:
        """Which proposals (n, T, P, 2) keep `disc_gap` m from all discs and SQUARE_GAP from all squares: (n, T)."""
        taken = np.flatnonzero(~np.isnan(self.start[episodes, :, 0]).all(0))  # the R rows in use in any episode
        there = self.points[:, episodes[:, None], taken][:, :, None, None]  # starts and goals (2, n, 1, 1, R, 2)
        least = np.where(self.square[episodes[:, None], taken], SQUARE_GAP, disc_gap)[:, None, None]  # (n, 1, 1, R)
        x, y = places[..., None, 0] - there[..., 0], places[..., None, 1] - there[..., 1]  # (2, n, T, P, R)
        return ~(x * x + y * y < least * least).any((0, 3, 4))  # no row is near where NaN says that it is absent

    def _first(self, which: np.ndarray, draws: int, propose: Callable, fits: Callable, what: str) -> np.ndarray:
        """The first proposal that fits, for each of the n episodes `which`: (n, P, 2).

        `propose` makes P places of `draws` uniform numbers; `fits` says which proposals an episode has room for.
        """
        found, pending = None, np.arange(len(which))
        for _ in range(100):
            episodes = which[pending]
            numbers = [self.rngs[e].random((ATTEMPTS, draws)) for e in episodes]
            places = propose(np.reshape(numbers, (len(episodes), ATTEMPTS, draws)))  # (n, T, P, 2)
            good = fits(places, episodes)  # (n, T)
            if found is None:
                found = places[:, 0].copy()
            found[pending] = places[np.arange(len(episodes)), good.argmax(1)]  # the first; overwritten if none is good
            pending = pending[~good.any(1)]
            if not len(pending):
                return found
        raise ConfigError(f"there is no room for {what} on this circle; fewer people or a larger circle would fit")
