"""The paper's environments: people and squares at random places, by rejection sampling in many episodes at once.

The random generator of each episode proposes places, and the first one that fits is taken; so no episode depends on
the others.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from sfmrl.config import ConfigError

RADIUS, SIDE = 0.3, 0.6  # m: of every agent, of every square
CIRCLE, NOISE = 4.0, 0.5  # m: people start on this circle, moved by at most NOISE in x and in y
GAP = 0.2  # m: from a person to every start and goal of another
SQUARE_GAP = 0.9  # m: from a square's centre to every other centre, start and goal
SQUARE_REACH = 3.2  # m: separate squares lie in this disc
MIDDLE = 1.5  # m: the centre of a group of squares is at most this far from (0, 0) in x and in y
ATTEMPTS, ROUNDS = 4, 100  # proposals for a place at a time, and how many times


class Builder:
    """Scenes in the making, E episodes of N rows; methods place people and squares in the episodes `which` (indices).

    `start`, `goal` (E, N, 2) m are NaN in empty rows, `square` (E, N) marks squares; `rngs`, `numbers` and `label` are
    the random generator, number and environment of each episode. People start on a circle of radius `circle` m.
    """

    def __init__(self, rngs: list[np.random.Generator], numbers: np.ndarray, rows: int, circle: float) -> None:
        self.rngs, self.numbers, self.circle = rngs, numbers, circle
        self.points = np.full((2, len(rngs), rows, 2), np.nan)
        self.start, self.goal = self.points  # views: what is written to one shows in the other
        self.start[:, 0], self.goal[:, 0] = (0.0, -4.0), (0.0, 4.0)
        self.square = np.zeros((len(rngs), rows), dtype=bool)
        self.label = np.full(len(rngs), "", dtype=object)

    def place(self, environment: Any, which: np.ndarray) -> None:
        """The label, people and squares of an `Environment` (see `scenes.py`)."""
        self.label[which] = environment.label
        environment.place(self, which)

    def with_people(self, people: int) -> "Builder":
        """The same robot and squares with `people` people, all on the circle, instead of those placed so far."""
        _, centre = squares_of(self.start, self.square)
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
        """People in rows 1 to `count`."""
        for row in range(1, count + 1):
            self.person(which, row)

    def person(self, which: np.ndarray, row: int) -> None:
        """A person near the circle whose goal is the opposite point, clear of everything placed so far."""

        def propose(draws: np.ndarray) -> np.ndarray:  # (n, T, 3) -> start and goal (n, T, 2, 2)
            angle = 2 * np.pi * draws[..., 0]
            start = self.circle * np.stack((np.cos(angle), np.sin(angle)), -1) + NOISE * (2 * draws[..., 1:] - 1)
            return np.stack((start, -start), axis=2)

        places = self._first(which, 3, propose, partial(self._clear, gap=2 * RADIUS + GAP), f"person {row}")
        self.start[which, row], self.goal[which, row] = places[:, 0], places[:, 1]

    def separate_square(self, which: np.ndarray, row: int) -> None:
        """A square in the disc of radius SQUARE_REACH, clear of everything placed so far."""

        def propose(draws: np.ndarray) -> np.ndarray:  # uniform in the disc: (n, T, 2) -> (n, T, 1, 2)
            angle, reach = 2 * np.pi * draws[..., 0], SQUARE_REACH * np.sqrt(draws[..., 1])
            return np.stack((reach * np.cos(angle), reach * np.sin(angle)), -1)[:, :, None, :]

        self.put(which, row, self._first(which, 2, propose, partial(self._clear, gap=SQUARE_GAP), f"square {row}"))

    def group(self, which: np.ndarray, row: int, shape: np.ndarray, *, turn: bool = False) -> None:
        """Touching squares at `shape` (P, 2) m about a random centre in the middle, overlapping no other square.

        With `turn`, half of the groups are turned by 90 degrees.
        """

        def propose(draws: np.ndarray) -> np.ndarray:  # (n, T, 3) -> (n, T, P, 2)
            turned = (draws[..., 2] < 0.5)[..., None, None] & turn
            centre = MIDDLE * (2 * draws[..., :2] - 1)
            return centre[:, :, None, :] + np.where(turned, shape[:, ::-1], shape)

        def fits(places: np.ndarray, episodes: np.ndarray) -> np.ndarray:
            others = np.where(self.square[episodes, :, None], self.start[episodes], np.inf)
            apart = np.abs(places[:, :, :, None, :] - others[:, None, None]).max(-1)  # (n, T, P, N)
            return (apart >= SIDE).all((2, 3))

        self.put(which, row, self._first(which, 3, propose, fits, "a row of squares"))

    def _clear(self, places: np.ndarray, episodes: np.ndarray, gap: float) -> np.ndarray:
        """Which proposals (n, T, P, 2) are `gap` m from all agents, SQUARE_GAP from all squares (centres), (n, T)."""
        taken = np.flatnonzero(~np.isnan(self.start[episodes, :, 0]).all(0))  # the R rows in use in any episode
        others = self.points[:, episodes[:, None], taken][:, :, None, None]  # starts and goals (2, n, 1, 1, R, 2)
        least = np.where(self.square[episodes[:, None], taken], SQUARE_GAP, gap)[:, None, None]  # (n, 1, 1, R)
        x, y = places[..., None, 0] - others[..., 0], places[..., None, 1] - others[..., 1]  # (2, n, T, P, R)
        return ~(x * x + y * y < least * least).any((0, 3, 4))  # False for NaN: absent rows are never near

    def _first(
        self, which: np.ndarray, draws: int, propose: Callable, fits: Callable, what: str, rounds: int = ROUNDS
    ) -> np.ndarray:
        """The first proposal that fits, in each of the n episodes `which`: P places made of `draws` numbers, (n, P, 2).

        Raises ConfigError if there is no room for `what`.
        """
        if not rounds:
            raise ConfigError(f"there is no room for {what} on this circle; fewer people or a larger circle would fit")
        numbers = [self.rngs[e].random((ATTEMPTS, draws)) for e in which]
        places = propose(np.reshape(numbers, (len(which), ATTEMPTS, draws)))  # (n, T, P, 2)
        good = fits(places, which)  # (n, T)
        first = places[np.arange(len(which)), good.argmax(1)]
        again = ~good.any(1)
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
# to their group's; the barrier is open towards the robot, which comes from below.
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
