"""Where people and squares may stand: places proposed and accepted for many episodes at once.

Rejection sampling by the rules of CrowdNav and of the paper's environments, each episode from its own generator, in
blocks of proposals: the first that fits is taken, and who shares the batch makes no difference.
"""

from collections.abc import Callable

import numpy as np

from sfmrl.config import ConfigError
from sfmrl.maps.format import Drawing
from sfmrl.maps.layouts import drawing_of

RADIUS, V_PREF, SIDE = 0.3, 1.0, 0.6  # m, m/s, m: every disc, every preferred speed, every square
CIRCLE, NOISE = 4.0, 0.5  # m: people start on this circle, moved by up to so much in x and in y
GAP = 0.2  # m: between a person's disc and every start and goal
SQUARE_GAP = 0.9  # m: from a square's centre to every other centre, start and goal
SQUARE_REACH = 3.2  # m: environment 1's squares lie in this disc
ATTEMPTS = 4  # proposals drawn at a time for one place

# Squares' centres relative to the group's own, m: the barrier is open towards the robot, which comes from below.
BARRIER = np.array([[-0.6, 0.0], [0.0, 0.0], [0.6, 0.0], [-0.6, -0.6], [0.6, -0.6]])
ROW3 = np.array([[-0.6, 0.0], [0.0, 0.0], [0.6, 0.0]])
ROW2 = np.array([[-0.3, 0.0], [0.3, 0.0]])
MIDDLE = 1.5  # m: a group's centre is at most so far from the middle in x and in y


def people_on_circle(environment: str) -> int:
    """How many people "circle" (ten) or "circle5" (five) has."""
    return int(environment.removeprefix("circle") or 10)


def circle_of(people: int | None = None) -> float:
    """Radius of the circle that people start on, m: from eleven people on it grows, so that they stand as close."""
    return CIRCLE * max(1.0, (people or 0) / 10)


class Builder:
    """Scenes in the making: places are proposed and accepted for many episodes at once, in each one's own draws."""

    def __init__(self, rngs: list[np.random.Generator], rows: int, circle: float) -> None:
        self.rngs, self.circle = rngs, circle
        self.points = np.full((2, len(rngs), rows, 2), np.nan)
        self.start, self.goal = self.points
        self.start[:, 0], self.goal[:, 0] = (0.0, -4.0), (0.0, 4.0)
        self.square = np.zeros((len(rngs), rows), dtype=bool)

    def build(self, environment: str, which: np.ndarray) -> None:
        """Fill the episodes `which` (indices) with one environment's people and squares."""
        if environment.startswith("circle"):
            for row in range(1, people_on_circle(environment) + 1):
                self._person(which, row)
        elif drawing := drawing_of(environment):
            self._draw(which, drawing)
        elif environment == "1":
            people = np.array([(self.rngs[e].random(10) < 0.6).sum() for e in which], dtype=int)
            for row in range(1, 11):
                self._person(which[people >= row], row)
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
                self._person(which, row)

    def among(self, people: int) -> "Builder":
        """The same squares with this number of `people`, all on the circle."""
        squares = int(self.square.sum(1).max(initial=0))
        other = Builder(self.rngs, 1 + people + squares, self.circle)
        episode, row = np.nonzero(self.square)
        slot = 1 + people + (np.cumsum(self.square, axis=1) - 1)[episode, row]
        other.start[:, 0], other.goal[:, 0] = self.start[:, 0], self.goal[:, 0]
        other.start[episode, slot] = other.goal[episode, slot] = self.start[episode, row]
        other.square[episode, slot] = True
        for person in range(1, people + 1):
            other._person(np.arange(len(self.rngs)), person)
        return other

    def _draw(self, which: np.ndarray, drawing: Drawing) -> None:
        """A drawn scene; those with leeway start up to so much from their places, and end as much the other way."""
        count = len(drawing.start)
        for row in (*range(1, count), 0):
            if leeway := drawing.leeway[row]:
                moved = np.array([self.rngs[e].uniform(-leeway, leeway, 2) for e in which]).reshape(-1, 2)
            else:
                moved = 0.0
            self.start[which, row], self.goal[which, row] = drawing.start[row] + moved, drawing.goal[row] - moved
        self._put(which, count, np.broadcast_to(drawing.squares, (len(which), *drawing.squares.shape)))

    def _person(self, which: np.ndarray, row: int) -> None:
        """A person near the circle, bound for the opposite point, clear of all that is there."""

        def propose(draws: np.ndarray) -> np.ndarray:  # (n, T, 3) -> start and goal (n, T, 2, 2)
            angle = 2 * np.pi * draws[..., 0]
            start = self.circle * np.stack((np.cos(angle), np.sin(angle)), -1) + NOISE * (2 * draws[..., 1:] - 1)
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
        taken = np.flatnonzero(~np.isnan(self.start[episodes, :, 0]).all(0))  # rows that anybody has yet
        there = self.points[:, episodes[:, None], taken][:, :, None, None]
        x = places[..., None, 0] - there[..., 0]  # (2, n, T, P, rows), from starts and from goals; NaN: nobody there
        y = places[..., None, 1] - there[..., 1]
        x *= x
        y *= y
        x += y
        return ~(x < (least * least)[:, None, None, taken]).any((0, 3, 4))

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
