"""The environments of the paper and of CrowdNav: people and squares at random places, by rejection sampling.

The random generator of each episode proposes places, and the first one that fits is taken. Many episodes are
sampled at once, independently of each other.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from sfmrl.config import ConfigError
from sfmrl.geometry import unit_at

RADIUS, SIDE = 0.3, 0.6  # m: of every agent, of every square
V_PREF = 1.0  # m/s, of every agent
SPEEDS, RADII = (0.5, 1.5), (0.3, 0.5)  # m/s and m: ranges of people's random attributes (CrowdNav)
CIRCLE, NOISE = 4.0, 0.5  # m: people start on this circle, moved by at most NOISE (times v_pref) in x and in y
HALF = 5.0  # m: people who cross a square start and end at most this far from (0, 0) in x and in y
GAP = 0.2  # m: from a person to every start and goal of another, between their discs
PERSON_GAP = 2 * RADIUS + GAP  # m: the same between centres
SQUARE_GAP = 0.9  # m: from a square's centre to every other centre, start and goal
SQUARE_REACH = 3.2  # m: separate squares lie in this disc
MIDDLE = 1.5  # m: the centre of a group of squares is at most this far from (0, 0) in x and in y
ATTEMPTS, ROUNDS = 4, 100  # proposals for a place at a time, and how many times
PATIENCE, GROWTH = 25, 1.02  # rounds after which the circle grows, and its factor in each further round
REMEDY = "on this circle; fewer people or a larger circle would fit"


class Builder:
    """Scenes being built, E episodes of N rows; methods place people and squares in the episodes `which` (indices).

    `start`, `goal` (E, N, 2) m are NaN in empty rows, `square` (E, N) marks squares; `rngs`, `numbers` and `label` are
    the random generator, number and environment of each episode. People start on a circle of radius `circle` m. With
    `random_attributes`, each person's `radius` in m and `v_pref` in m/s, (E, N), are drawn before its place. If the
    circle has no room for such wide people, it grows by the factors `growth` (E,).
    """

    def __init__(
        self, rngs: list[np.random.Generator], numbers: np.ndarray, rows: int, circle: float, random_attributes: bool
    ) -> None:
        self.rngs, self.numbers, self.circle, self.random_attributes = rngs, numbers, circle, random_attributes
        self.points = np.full((2, len(rngs), rows, 2), np.nan)
        self.start, self.goal = self.points  # views: what is written to one shows in the other
        self.start[:, 0], self.goal[:, 0] = (0.0, -4.0), (0.0, 4.0)
        self.square = np.zeros((len(rngs), rows), dtype=bool)
        self.radius, self.v_pref = np.full(self.square.shape, RADIUS), np.full(self.square.shape, V_PREF)
        self.growth = np.ones(len(rngs))
        self.label = np.full(len(rngs), "", dtype=object)

    def mix(self, environments: list[Any], shares: list[float]) -> None:
        """One of these environments in each episode, each in its share of them."""
        # The first draw chooses, even if there is only one to choose: so a mix has the scenes of its environments.
        draw = np.array([rng.random() for rng in self.rngs])
        picked = np.searchsorted(np.cumsum(shares), draw, side="right")
        picked = np.minimum(picked, len(shares) - 1)  # shares may add up to a little less than 1
        for k, environment in enumerate(environments):
            self.place(environment, np.flatnonzero(picked == k))

    def place(self, environment: Any, which: np.ndarray) -> None:
        """The label, people and squares of an `Environment` (see `scenes.py`)."""
        self.label[which] = environment.label
        environment.place(self, which)

    def with_people(self, people: int) -> "Builder":
        """The same robot and squares with `people` people, all on the circle, instead of those placed so far."""
        _, centre = squares_of(self.start, self.square)
        rows = 1 + people + centre.shape[1]
        other = Builder(self.rngs, self.numbers, rows, self.circle, self.random_attributes)
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

    def people(self, which: np.ndarray, count: int, crossing: bool = False) -> None:
        """People in rows 1 to `count`, on the circle or `crossing` a square."""
        place = self.crossing_person if crossing else self.person
        for row in range(1, count + 1):
            place(which, row)

    def person(self, which: np.ndarray, row: int) -> None:
        """A person near the circle whose goal is the opposite point, clear of everything placed so far."""
        self.attributes(which, row)

        def propose(draws: np.ndarray, episodes: np.ndarray) -> np.ndarray:  # (n, T, 3) -> start and goal (n, T, 2, 2)
            angle = 2 * np.pi * draws[..., 0]
            circle, noise = self.circle * self.growth[episodes], NOISE * self.v_pref[episodes, row]
            start = circle[:, None, None] * unit_at(angle)
            start += noise[:, None, None] * (2 * draws[..., 1:] - 1)
            return np.stack((start, -start), axis=2)

        places = self._first(which, 3, propose, partial(self._clear, row=row), f"person {row} {REMEDY}")
        self.start[which, row], self.goal[which, row] = places[:, 0], places[:, 1]

    def crossing_person(self, which: np.ndarray, row: int) -> None:
        """A person who crosses a square from its left half to its right, or back; clear of all starts, and all goals.

        As in CrowdNav, a start may be near the goals of others, and a goal near their starts.
        """
        self.attributes(which, row)
        side = np.ones(len(self.rngs))
        side[which] = [1.0 if self.rngs[e].random() < 0.5 else -1.0 for e in which]
        for end, sign in ((0, 1.0), (1, -1.0)):  # the start, then the goal

            def propose(draws: np.ndarray, episodes: np.ndarray, sign: float = sign) -> np.ndarray:  # -> (n, T, 1, 2)
                x, y = sign * side[episodes, None] * draws[..., 0], 2 * draws[..., 1] - 1
                return HALF * np.stack((x, y), -1)[:, :, None]

            fits = partial(self._clear, row=row, ends=slice(end, end + 1))
            what = f"person {row} in this square; fewer people would fit"
            self.points[end, which, row] = self._first(which, 2, propose, fits, what)[:, 0]

    def attributes(self, which: np.ndarray, row: int) -> None:
        """Draw a person's v_pref and radius, if they are random."""
        if self.random_attributes:
            draws = np.reshape([self.rngs[e].random(2) for e in which], (-1, 2))
            low, high = np.transpose((SPEEDS, RADII))
            self.v_pref[which, row], self.radius[which, row] = (low + (high - low) * draws).T

    def separate_square(self, which: np.ndarray, row: int) -> None:
        """A square in the disc of radius SQUARE_REACH, clear of everything placed so far."""

        def propose(draws: np.ndarray, _: np.ndarray) -> np.ndarray:  # uniform in the disc: (n, T, 2) -> (n, T, 1, 2)
            angle, reach = 2 * np.pi * draws[..., 0], SQUARE_REACH * np.sqrt(draws[..., 1])
            return (reach[..., None] * unit_at(angle))[:, :, None, :]

        fits = partial(self._clear, row=row, gap=SQUARE_GAP)
        self.put(which, row, self._first(which, 2, propose, fits, f"square {row} {REMEDY}"))

    def group(self, which: np.ndarray, row: int, shape: np.ndarray, *, turn: bool = False) -> None:
        """Touching squares at `shape` (P, 2) m about a random centre in the middle, overlapping no other square.

        With `turn`, half of the groups are turned by 90 degrees.
        """

        def propose(draws: np.ndarray, _: np.ndarray) -> np.ndarray:  # (n, T, 3) -> (n, T, P, 2)
            turned = (draws[..., 2] < 0.5)[..., None, None] & turn
            centre = MIDDLE * (2 * draws[..., :2] - 1)
            return centre[:, :, None, :] + np.where(turned, shape[:, ::-1], shape)

        def fits(places: np.ndarray, episodes: np.ndarray) -> np.ndarray:
            others = np.where(self.square[episodes, :, None], self.start[episodes], np.inf)
            apart = np.abs(places[:, :, :, None, :] - others[:, None, None]).max(-1)  # (n, T, P, N)
            return (apart >= SIDE).all((2, 3))

        self.put(which, row, self._first(which, 3, propose, fits, f"a row of squares {REMEDY}"))

    def _clear(
        self, places: np.ndarray, episodes: np.ndarray, row: int, gap: float = PERSON_GAP, ends: slice = slice(None)
    ) -> np.ndarray:
        """Which proposals (n, T, P, 2) for a row are `gap` m from all agents, SQUARE_GAP from all squares, (n, T).

        These distances are between centres, and grow with radii above RADIUS. `ends` is the part of `points` to clear.
        """
        in_use = np.flatnonzero(~np.isnan(self.start[episodes, :, 0]).all(0))  # R rows, in any of the episodes
        taken = episodes[:, None], in_use
        others = self.points[ends][:, *taken][:, :, None, None]  # starts, goals (2, n, 1, 1, R, 2)
        wider = (self.radius[taken] - RADIUS) + (self.radius[episodes, row, None] - RADIUS)
        least = (np.where(self.square[taken], SQUARE_GAP, gap) + wider)[:, None, None]  # (n, 1, 1, R)
        x, y = places[..., None, 0] - others[..., 0], places[..., None, 1] - others[..., 1]  # (2, n, T, P, R)
        return ~(x * x + y * y < least * least).any((0, 3, 4))  # False for NaN: absent rows are never near

    def _first(
        self, which: np.ndarray, draws: int, propose: Callable, fits: Callable, what: str, rounds: int = ROUNDS
    ) -> np.ndarray:
        """The first proposal that fits, in each of the n episodes `which`: P places made of `draws` numbers, (n, P, 2).

        Raises ConfigError if there is no room for `what`, which ends with the remedy.
        """
        if not rounds:
            raise ConfigError(f"there is no room for {what}")
        numbers = [self.rngs[e].random((ATTEMPTS, draws)) for e in which]
        places = propose(np.reshape(numbers, (len(which), ATTEMPTS, draws)), which)  # (n, T, P, 2)
        good = fits(places, which)  # (n, T)
        first = places[np.arange(len(which)), good.argmax(1)]
        again = ~good.any(1)
        if self.random_attributes and rounds <= ROUNDS - PATIENCE:
            self.growth[which[again]] *= GROWTH
        if again.any():
            first[again] = self._first(which[again], draws, propose, fits, what, rounds - 1)
        return first


def squares_of(start: np.ndarray, square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (E, P) and centres (E, P, 2) of each episode's squares, in their order; NaN centres after its last."""
    most = int(square.sum(1).max(initial=0))
    rows = np.argsort(~square, axis=1, kind="stable")[:, :most]  # squares first
    centre = np.where(square[..., None], start, np.nan)
    return rows, np.take_along_axis(centre, rows[..., None], axis=1)


# The paper's environments have ten elements in rows 1 to 10, people before squares. Centres of squares, m, are relative
# to their group's; the barrier is open towards the robot, which comes from below. Where the paper's text is silent
# (shapes, distances, places), this is our reading: see tutorials/15-paper.md.
BARRIER = np.array([[-0.6, 0.0], [0.0, 0.0], [0.6, 0.0], [-0.6, -0.6], [0.6, -0.6]])
ROW3, ROW2 = BARRIER[:3], np.array([[-0.3, 0.0], [0.3, 0.0]])


def _people_and_squares(builder: Builder, which: np.ndarray) -> None:
    people = np.array([(builder.rngs[e].random(10) < 0.6).sum() for e in which], dtype=int)
    for row in range(1, 11):
        builder.person(which[people >= row], row)
        builder.separate_square(which[people < row], row)


def _fixed_barrier(builder: Builder, which: np.ndarray) -> None:
    builder.put(which, 6, BARRIER)
    builder.people(which, 5)


def _barrier(builder: Builder, which: np.ndarray) -> None:
    builder.group(which, 6, BARRIER)
    builder.people(which, 5)


def _two_rows(builder: Builder, which: np.ndarray) -> None:
    builder.group(which, 6, ROW3, turn=True)
    builder.group(which, 9, ROW2, turn=True)
    builder.people(which, 5)


def _barrier_and_two_rows(builder: Builder, which: np.ndarray) -> None:
    builder.group(which, 1, BARRIER)
    builder.group(which, 6, ROW3, turn=True)
    builder.group(which, 9, ROW2, turn=True)


PAPER = {"1": _people_and_squares, "2": _fixed_barrier, "3": _barrier, "4": _two_rows, "5": _barrier_and_two_rows}
