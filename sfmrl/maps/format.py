"""Read a map: text -> `Drawing`, with errors that name line and column. `sfmrl.maps` describes the format."""

from dataclasses import dataclass

import numpy as np

from sfmrl.config import ConfigError
from sfmrl.placement import RADIUS, Builder

CELL = 0.6  # m, the side of a place, and of a square
JITTER = 0.1  # m: people and the robot start at most this far from their places in x and in y
OFF = 0.05  # m between the robot and a square that it is drawn beside: to touch it would be a collision
PEOPLE, GOALS = "123456789", "abcdefghi"
MOST_PLACES = 60  # across, and down: farther than any agent comes within an episode
MOST_SQUARES = 200

_MEANT = str.maketrans({"█": "#", "■": "#", "@": "R", "★": "G", "*": "G", "·": ".", " ": "."})
_KNOWN = "# is a square, R the robot, G its goal, 1-9 people, a-i their goals, . nothing"


@dataclass(frozen=True)
class Drawing:
    """A scene as it is drawn, an environment for `sample_scenes`: the robot (row 0), P people, S squares.

    start, goal (1 + P, 2): m; (0, 0) is the middle of the drawing
    leeway (1 + P,): m, how far each may be moved in x and in y without touching anything
    squares (S, 2): their centres in reading order, m
    label: the environment's name in reports
    """

    start: np.ndarray
    goal: np.ndarray
    leeway: np.ndarray
    squares: np.ndarray
    label: str = "map"

    @property
    def elements(self) -> int:
        """Number of people and squares."""
        return len(self.start) - 1 + len(self.squares)

    def place(self, builder: Builder, which: np.ndarray) -> None:
        """Put the scene into the episodes `which`; starts are moved within their leeway, goals by as much back."""
        agents = len(self.start)
        for row in (*range(1, agents), 0):  # in this order each episode draws its noise
            leeway = self.leeway[row]
            moved: np.ndarray | float = 0.0
            if row:
                builder.attributes(which, row)
                builder.radius[which, row] = RADIUS  # the leeway is that of this radius
            if leeway:
                moved = np.reshape([builder.rngs[e].uniform(-leeway, leeway, 2) for e in which], (-1, 2))
            builder.start[which, row], builder.goal[which, row] = self.start[row] + moved, self.goal[row] - moved
        builder.put(which, agents, self.squares)


def parse(text: str, name: str = "map", whole: bool = True) -> Drawing:
    """The scene that a text draws; raises ConfigError with `name`, line and column if it draws none.

    Without `whole`, R and G may be missing: the robot then goes from (0, -4) to (0, 4), as in the environments.
    """
    lines, indent = _drawn_lines(text, name)
    rows, columns = len(lines), max(len(line) for _, line in lines) - indent
    if max(rows, columns) > MOST_PLACES:
        raise ConfigError(
            f"{name} is {columns} places wide and {rows} high; it may be at most {MOST_PLACES} by {MOST_PLACES}"
        )

    squares: list[np.ndarray] = []  # centres
    marks: dict[str, np.ndarray] = {}  # places of all else by character
    where: dict[str, str] = {}  # and where it is written
    for row, (number, line) in enumerate(lines):
        for column, written in enumerate(line[indent:]):
            character = written.translate(_MEANT)
            at = f"line {number}, column {indent + column + 1}"
            place = CELL * np.array((column - (columns - 1) / 2, (rows - 1) / 2 - row))
            if character == "#":
                squares.append(place)
            elif character in marks:
                wall = "; @ is the robot, as in replays: draw walls as #" if written == "@" else ""
                raise ConfigError(
                    f"{name}, {at}: this is a second {character}; the first is in {where[character]}{wall}"
                )
            elif character in f"RG{PEOPLE}{GOALS}":
                marks[character], where[character] = place, at
            elif character != ".":
                raise ConfigError(f"{name}, {at}: {character!r} means nothing on a map; {_KNOWN}")
    if len(squares) > MOST_SQUARES:
        raise ConfigError(f"{name} has {len(squares)} squares; it may have at most {MOST_SQUARES}")
    for character, what in (("R", "the robot's start"), ("G", "the robot's goal")):
        if whole and character not in marks:
            raise ConfigError(f"{name} has no {character}; draw one, {what}")
    return _drawing(np.reshape(squares, (-1, 2)), marks, {mark: f"{name}, {at}" for mark, at in where.items()})


def _drawn_lines(text: str, name: str) -> tuple[list[tuple[int, str]], int]:
    """The drawing's lines with their numbers in the text, without comments and blank lines around it; its indentation.

    Raises ConfigError if there are none.
    """
    lines = [(number, line.rstrip()) for number, line in enumerate(text.split("\n"), start=1)]
    lines = [(number, line) for number, line in lines if not line.lstrip().startswith(";")]
    drawn = [k for k, (_, line) in enumerate(lines) if line]
    if not drawn:
        raise ConfigError(f"{name} is empty; draw at least R, where the robot starts, and G, where it wants to go")
    lines = lines[drawn[0] : drawn[-1] + 1]
    return lines, min(len(line) - len(line.lstrip(" ")) for _, line in lines if line)


def _drawing(squares: np.ndarray, marks: dict[str, np.ndarray], where: dict[str, str]) -> Drawing:
    """The scene of squares (S, 2) and marks (2,), checked; `where` has their lines and columns, for errors."""
    start, goal = [marks.get("R", np.array((0.0, -4.0)))], [marks.get("G", np.array((0.0, 4.0)))]
    for person, letter in zip(PEOPLE, GOALS, strict=True):
        if person in marks:
            start.append(marks[person])
            goal.append(marks.get(letter, -marks[person]))
            if _apart(goal[-1], squares).min(initial=CELL) < CELL / 2:
                raise ConfigError(f"{where[person]}: the place opposite {person} is a square; draw {letter}, its goal")
            if _apart(start[0], start[-1]) < 1.1 * CELL:
                raise ConfigError(f"{where[person]}: {person} touches the robot; leave a place between them")
        elif letter in marks:
            raise ConfigError(f"{where[letter]}: {letter} is the goal of {person}, who is missing; draw {person}")
    beside = squares[_apart(start[0], squares) < 1.1 * CELL]
    start[0] = start[0] + OFF / CELL * (start[0] - beside).sum(0)
    if _room(start[0], squares).min(initial=OFF) < OFF / 2:  # those on opposite sides leave it where it was
        raise ConfigError(f"{where['R']}: R would touch the squares on both sides; a passage must be two places wide")
    starts, goals = np.array(start), np.array(goal)
    return Drawing(starts, goals, _leeway(starts, goals, squares), squares)


def _leeway(start: np.ndarray, goal: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """How far each start (n, 2) may be moved in x and in y, and its goal the other way, so that nothing touches, (n,).

    All may be moved at once; only goals may then touch each other.
    """
    others = np.where(np.eye(len(start), dtype=bool), np.inf, _apart(start[:, None], start)).min(1)
    room = _room(np.array((start, goal))[:, :, None], squares).min((0, 2), initial=np.inf)
    return np.clip(np.minimum(room, (others - CELL) / 2) / np.sqrt(2), 0.0, JITTER)


def _room(point: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Gaps from agents at points (..., 2) to the outlines of squares (..., 2) that broadcast, in m; least -`RADIUS`."""
    return np.hypot(*np.maximum(np.abs(np.moveaxis(point - square, -1, 0)) - CELL / 2, 0.0)) - RADIUS


def _apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Distances between points (..., 2) that broadcast, in m; `geometry.length` would round some of them otherwise."""
    return np.hypot(*np.moveaxis(one - other, -1, 0))
