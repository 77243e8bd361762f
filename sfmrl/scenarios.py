"""Who starts where and wants to go where: the paper's five environments and CrowdNav's circle crossing.

Every episode has a generator of its own, made from (seed, phase, episode), so episode 17 is the same whatever else is
sampled with it, and training, validation and test never share one. The rejection sampling itself runs over all
episodes at once. A square stands in the arrays as a resting row of its own (the disc inside it); ORCA's agents see
its outline as a polygon.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from sfmrl.config import MIXES, ConfigError, suggest
from sfmrl.geometry import length

ENVIRONMENTS = {
    "1": "people on a circle (0.6) and separate squares (0.4), ten in all",
    "2": "a concave barrier in the middle, five people",
    "3": "a concave barrier somewhere in the middle, five people",
    "4": "a row of three squares and a row of two, five people",
    "5": "a concave barrier, a row of three and a row of two, nobody",
    "circle": "people on a circle, no squares (CrowdNav)",
}
PHASES = ("train", "validation", "test", "imitation")

RADIUS, V_PREF, SIDE = 0.3, 1.0, 0.6  # m, m/s, m: every disc, every preferred speed, every square
CIRCLE, NOISE = 4.0, 0.5  # m: people start on this circle, moved by up to so much in x and in y
GAP = 0.2  # m: between a person's disc and every start and goal
SQUARE_GAP = 0.9  # m: from a square's centre to every other centre, start and goal
SQUARE_REACH = 3.2  # m: environment 1's squares lie in this disc
ATTEMPTS = 16  # proposals drawn at a time for one place

# Squares' centres relative to the group's own, m: the barrier is open towards the robot, which comes from below.
BARRIER = np.array([[-0.6, 0.0], [0.0, 0.0], [0.6, 0.0], [-0.6, -0.6], [0.6, -0.6]])
ROW3 = np.array([[-0.6, 0.0], [0.0, 0.0], [0.6, 0.0]])
ROW2 = np.array([[-0.3, 0.0], [0.3, 0.0]])
MIDDLE = 1.5  # m: a group's centre is at most so far from the middle in x and in y


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
        start, goal = np.array(self.start, dtype=float), np.array(self.goal, dtype=float)
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
            except ValueError:
                raise ValueError(f"{name} has shape {np.shape(value)}; it must broadcast to {shape}") from None
        if made["square"][:, 0].any():
            raise ValueError("square marks row 0, which is the robot")
        absent = np.isnan(start).any(-1)
        if absent[:, 0].any():
            raise ValueError("start has no robot: row 0 must not be NaN")
        if not np.isfinite(start[~absent]).all() or not np.isfinite(goal[~absent & ~made["square"]]).all():
            raise ValueError("start and goal must be finite for everyone who has a start")
        if not (made["radius"] > 0).all() or not (made["v_pref"] >= 0).all():
            raise ValueError("radius must be above 0 m and v_pref not below 0 m/s")
        goal[made["square"]] = start[made["square"]]
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
    """Environments and their shares from "2", "table1" or "1:0.7,2:0.3"; raises ConfigError."""
    shares: dict[str, float] = {}
    for part in MIXES.get(text, text).split(","):
        name, colon, share = part.strip().partition(":")
        if name not in ENVIRONMENTS:
            known = [*ENVIRONMENTS, *MIXES]
            raise ConfigError(f"there is no environment {name!r}; choose {', '.join(known)}{suggest(name, known)}")
        try:
            shares[name] = shares.get(name, 0.0) + (float(share) if colon else 1.0)
        except ValueError:
            raise ConfigError(f"the share of environment {name} is {share!r}; it must be a number") from None
    if not all(0 <= share <= 1 for share in shares.values()) or abs(sum(shares.values()) - 1) > 1e-9:
        raise ConfigError(f"the shares in {text!r} must be from 0 to 1 and add up to 1, as in 1:0.7,2:0.3")
    return shares


def episode_generator(seed: int, phase: str, episode: int) -> np.random.Generator:
    """The random numbers of one episode of one phase."""
    return np.random.default_rng([seed, PHASES.index(phase), episode])


def sample_scenes(
    environment: str,
    episodes: int | Sequence[int],
    seed: int = 0,
    *,
    phase: str = "test",
    humans: int = 10,
    circle: float = CIRCLE,
) -> Scenes:
    """Sample episodes of an environment, or of a mix of them, each from its own seed.

    `environment` is one of `ENVIRONMENTS`, a mix such as "1:0.7,2:0.3", or "table1", "table2"; `episodes` is how many,
    or the numbers of those wanted; `humans` and `circle` (radius, m) are for environment "circle" alone. The result
    has 11 rows an episode, people before squares. Raises ConfigError on names it does not know.
    """
    shares = parse_mix(environment)
    numbers = np.arange(episodes) if isinstance(episodes, (int, np.integer)) else np.asarray(episodes, dtype=int)
    if (numbers < 0).any():
        raise ConfigError("episodes are counted from 0")
    if phase not in PHASES:
        raise ConfigError(f"there is no phase {phase!r}; choose {', '.join(PHASES)}{suggest(phase, PHASES)}")
    rngs = [episode_generator(seed, phase, number) for number in numbers]
    # One draw decides the environment, also where there is but one: episode 17 of environment 2 is then the same
    # scene as episode 17 of a mix that puts it there.
    draw = np.array([rng.random() for rng in rngs])
    names = np.array(list(shares), dtype="<U6")
    picked = names[np.minimum(np.searchsorted(np.cumsum(list(shares.values())), draw, side="right"), len(names) - 1)]
    rows = max(humans + 1 if name == "circle" else 11 for name in shares)
    builder = _Builder(rngs, rows)
    for name in shares:
        builder.build(name, np.flatnonzero(picked == name), humans, circle)
    return Scenes(builder.start, builder.goal, square=builder.square, environment=picked, episode=numbers)


class _Builder:
    """Scenes in the making: places are proposed and accepted for many episodes at once, in each one's own draws."""

    def __init__(self, rngs: list[np.random.Generator], rows: int) -> None:
        self.rngs = rngs
        self.start = np.full((len(rngs), rows, 2), np.nan)
        self.goal = np.full((len(rngs), rows, 2), np.nan)
        self.start[:, 0], self.goal[:, 0] = (0.0, -4.0), (0.0, 4.0)
        self.square = np.zeros((len(rngs), rows), dtype=bool)

    def build(self, environment: str, which: np.ndarray, humans: int, circle: float) -> None:
        """Fill the episodes `which` (indices) with one environment's people and squares."""
        if environment == "circle":
            for row in range(1, humans + 1):
                self._person(which, row, circle)
        elif environment == "1":
            people = np.array([(self.rngs[e].random(10) < 0.6).sum() for e in which], dtype=int)
            for row in range(1, 11):
                self._person(which[people >= row], row, CIRCLE)
            for row in range(1, 11):
                self._square(which[people < row], row)
        elif environment == "5":
            self._group(which, 1, BARRIER, turn=False)
            self._group(which, 6, ROW3, turn=True)
            self._group(which, 9, ROW2, turn=True)
        else:
            if environment == "2":
                self._put(which, 6, np.broadcast_to(BARRIER, (len(which), 5, 2)))
            elif environment == "3":
                self._group(which, 6, BARRIER, turn=False)
            else:
                self._group(which, 6, ROW3, turn=True)
                self._group(which, 9, ROW2, turn=True)
            for row in range(1, 6):
                self._person(which, row, CIRCLE)

    def _person(self, which: np.ndarray, row: int, circle: float) -> None:
        """A person near the circle, bound for the opposite point, clear of all that is there."""

        def propose(draws: np.ndarray) -> np.ndarray:  # (n, T, 3) -> start and goal (n, T, 2, 2)
            angle = 2 * np.pi * draws[..., 0]
            start = circle * np.stack((np.cos(angle), np.sin(angle)), -1) + NOISE * (2 * draws[..., 1:] - 1)
            return np.stack((start, -start), axis=2)

        def fits(places: np.ndarray, episodes: np.ndarray) -> np.ndarray:
            least = np.where(self.square[episodes], SQUARE_GAP, 2 * RADIUS + GAP)
            return self._clear(places, episodes, least)

        place = self._first(which, 3, propose, fits, f"person {row}")
        self.start[which, row], self.goal[which, row] = place[:, 0], place[:, 1]

    def _square(self, which: np.ndarray, row: int) -> None:
        """A separate square in environment 1's disc."""

        def propose(draws: np.ndarray) -> np.ndarray:  # uniform in the disc: (n, T, 2) -> (n, T, 1, 2)
            angle, reach = 2 * np.pi * draws[..., 0], SQUARE_REACH * np.sqrt(draws[..., 1])
            return np.stack((reach * np.cos(angle), reach * np.sin(angle)), -1)[:, :, None, :]

        def fits(places: np.ndarray, episodes: np.ndarray) -> np.ndarray:
            return self._clear(places, episodes, np.full((len(episodes), self.start.shape[1]), SQUARE_GAP))

        self._put(which, row, self._first(which, 2, propose, fits, f"square {row}"))

    def _group(self, which: np.ndarray, row: int, shape: np.ndarray, *, turn: bool) -> None:
        """Touching squares about a random centre in the middle, turned by 0 or 90 degrees, overlapping no other."""

        def propose(draws: np.ndarray) -> np.ndarray:  # (n, T, 3) -> (n, T, P, 2)
            turned = (draws[..., 2] < 0.5)[..., None, None] & turn
            centre = MIDDLE * (2 * draws[..., :2] - 1)
            return centre[:, :, None, :] + np.where(turned, shape[:, ::-1], shape)

        def fits(places: np.ndarray, episodes: np.ndarray) -> np.ndarray:
            there = np.where(self.square[episodes, :, None], self.start[episodes], np.inf)
            apart = np.abs(places[:, :, :, None, :] - there[:, None, None]).max(-1)  # (n, T, P, N)
            return (apart >= SIDE).all((2, 3))

        self._put(which, row, self._first(which, 3, propose, fits, "a row of squares"))

    def _put(self, which: np.ndarray, row: int, centres: np.ndarray) -> None:
        rows = slice(row, row + centres.shape[1])
        self.start[which, rows] = self.goal[which, rows] = centres
        self.square[which, rows] = True

    def _clear(self, places: np.ndarray, episodes: np.ndarray, least: np.ndarray) -> np.ndarray:
        """Which proposals (n, T, P, 2) keep `least` (n, N) m from every start and goal there: (n, T)."""
        fits = np.ones(places.shape[:2], dtype=bool)
        for there in (self.start[episodes], self.goal[episodes]):
            apart = length(places[:, :, :, None, :] - there[:, None, None])  # (n, T, P, N); NaN: nobody there
            fits &= ~(apart < least[:, None, None]).any((2, 3))
        return fits

    def _first(self, which: np.ndarray, draws: int, propose: Callable, fits: Callable, what: str) -> np.ndarray:
        """The first proposal that fits, for each of the episodes `which`: (n, P, 2)."""
        found = None
        pending = np.arange(len(which))
        for _ in range(100):
            episodes = which[pending]
            numbers = [self.rngs[e].random((ATTEMPTS, draws)) for e in episodes]
            places = propose(np.array(numbers).reshape(len(episodes), ATTEMPTS, draws))
            good = fits(places, episodes)
            if found is None:
                found = places[:, 0].copy()
            found[pending] = places[np.arange(len(episodes)), good.argmax(1)]
            pending = pending[~good.any(1)]
            if not len(pending):
                return found
        raise ConfigError(f"there is no room for {what} on this circle; fewer people or a larger circle would fit")
