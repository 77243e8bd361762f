"""Scenes drawn in text: one format for the built-in layouts and for maps of your own.

    ; a line that begins with a semicolon is a comment
    #############
    #.....#.....#
    #..R..#..G..#
    #.....#.....#
    #.....#..1..#
    #...........#
    #..a........#
    #############

A character is a place of 0.6 m x 0.6 m: `#` (or `█`, `■`) a square, `R` (or `@`) the robot's start, `G` (or `★`, `*`)
its goal, `1` to `9` people, `a` to `i` their goals (`a` that of `1`), `.` (or `·`, a blank) nothing. A person without a
goal is bound for the place opposite, through the middle of the drawing. The robot is as wide as a place and may not
touch a square, so a passage must be two places wide. Beyond the drawing all is free.

Episodes differ by a little noise: each start is moved by up to 0.1 m in x and in y, as far as it has room, and the goal
by as much the other way. A robot drawn beside a square starts 0.05 m off it.
"""

from dataclasses import dataclass

import numpy as np

from sfmrl.config import ConfigError

CELL = 0.6  # m, the side of a place, and of a square
JITTER = 0.1  # m: people and the robot start within so much of their places in x and in y
OFF = 0.05  # m between the robot and a square that it is drawn beside: to touch it would be a collision
PEOPLE, GOALS = "123456789", "abcdefghi"
MOST_PLACES = 60  # across, and down: farther than anybody comes within an episode
MOST_SQUARES = 200

_MEANT = str.maketrans({"█": "#", "■": "#", "@": "R", "★": "G", "*": "G", "·": ".", " ": "."})
_KNOWN = "# is a square, R the robot, G its goal, 1-9 people, a-i their goals, . nothing"


@dataclass(frozen=True)
class Drawing:
    """A scene as it is drawn: the robot (row 0), P people, S squares; in m, the middle of the drawing is (0, 0)."""

    start: np.ndarray  # (1 + P, 2)
    goal: np.ndarray  # (1 + P, 2)
    leeway: np.ndarray  # (1 + P,) by how much each may be moved in x and in y without touching anything
    squares: np.ndarray  # (S, 2) centres, in the order of reading

    @property
    def elements(self) -> int:
        """How many people and squares there are."""
        return len(self.start) - 1 + len(self.squares)


def parse(text: str, name: str = "map", whole: bool = True) -> Drawing:
    """The scene that a text draws; raises ConfigError with `name`, line and column where it draws none.

    Without `whole`, R and G may be missing: the robot then goes from (0, -4) to (0, 4), as in the environments.
    """
    lines = _lines(text)
    rows, columns = len(lines), max((len(line) for _, _, line in lines), default=0)
    if not rows:
        raise ConfigError(f"{name} is empty; draw at least R, where the robot starts, and G, where it wants to go")
    if max(rows, columns) > MOST_PLACES:
        raise ConfigError(f"{name} is {columns} places wide and {rows} high; it may be {MOST_PLACES} of either")
    squares, marks, where = _places(lines, rows, columns, name)
    if len(squares) > MOST_SQUARES:
        raise ConfigError(f"{name} has {len(squares)} squares; it may have {MOST_SQUARES}, for the robot weighs each")
    for character, what in (("R", "the robot's start"), ("G", "the robot's goal")):
        if whole and character not in marks:
            raise ConfigError(f"{name} has no {character}; draw one, {what}")
    return _drawing(squares, marks, where)


def _lines(text: str) -> list[tuple[int, int, str]]:
    """The drawing's lines: number in the text, columns before the drawing, and characters."""
    lines = [(number, line.rstrip()) for number, line in enumerate(text.split("\n"), start=1)]
    lines = [(number, line) for number, line in lines if not line.lstrip().startswith(";")]
    drawn = [k for k, (_, line) in enumerate(lines) if line]
    lines = lines[drawn[0] : drawn[-1] + 1] if drawn else []
    before = min((len(line) - len(line.lstrip(" ")) for _, line in lines if line), default=0)
    return [(number, before, line[before:]) for number, line in lines]


def _places(
    lines: list[tuple[int, int, str]], rows: int, columns: int, name: str
) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, str]]:
    """Squares (S, 2) and, by character, all else (2,), in m; and where in the text the latter are written."""
    squares, marks, where = [], {}, {}
    for row, (number, before, line) in enumerate(lines):
        for column, written in enumerate(line):
            character = written.translate(_MEANT)
            at = f"{name}, line {number}, column {before + column + 1}"
            place = CELL * np.array((column - (columns - 1) / 2, (rows - 1) / 2 - row))
            if character == "#":
                squares.append(place)
            elif character in marks:
                first = where[character].removeprefix(f"{name}, ")
                wall = "; @ is the robot, as in replays: draw walls as #" if written == "@" else ""
                raise ConfigError(f"{at}: this is a second {character}; the first is in {first}{wall}")
            elif character in f"RG{PEOPLE}{GOALS}":
                marks[character], where[character] = place, at
            elif character != ".":
                raise ConfigError(f"{at}: {character!r} means nothing on a map; {_KNOWN}")
    return np.reshape(squares, (-1, 2)), marks, where


def _drawing(squares: np.ndarray, marks: dict[str, np.ndarray], where: dict[str, str]) -> Drawing:
    """The scene of squares (S, 2) and marks (2,), held to make sense; `where` they are written is for errors."""
    start, goal = [marks.get("R", np.array((0.0, -4.0)))], [marks.get("G", np.array((0.0, 4.0)))]
    for person, letter in zip(PEOPLE, GOALS, strict=True):
        if person in marks:
            start.append(marks[person])
            goal.append(marks.get(letter, -marks[person]))
            if _apart(goal[-1], squares).min(initial=CELL) < CELL / 2:
                raise ConfigError(f"{where[person]}: opposite {person} is a square; draw {letter}, the person's goal")
            if _apart(start[0], start[-1]) < 1.1 * CELL:
                raise ConfigError(f"{where[person]}: {person} touches the robot; leave a place between them")
        elif letter in marks:
            raise ConfigError(f"{where[letter]}: {letter} is the goal of person {person}, who is not there")
    beside = squares[_apart(start[0], squares) < 1.1 * CELL]
    start[0] = start[0] + OFF / CELL * (start[0] - beside).sum(0)
    start, goal = np.array(start), np.array(goal)
    return Drawing(start, goal, _leeway(start, goal, squares), squares)


def _apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Distances between points (..., 2) that broadcast, in m."""
    return np.hypot(*np.moveaxis(one - other, -1, 0))


def _leeway(start: np.ndarray, goal: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """By how much starts (n, 2) may all be moved in x and in y, and goals the other way; only goals may then touch."""
    others = np.where(np.eye(len(start), dtype=bool), np.inf, _apart(start[:, None], start)).min(1)
    solid = _apart(np.array((start, goal))[:, :, None], squares).min((0, 2), initial=np.inf)
    return np.clip(np.minimum(solid - CELL, (others - CELL) / 2) / np.sqrt(2), 0.0, JITTER)
