"""The plane from above, as one picture: where everybody is and has been, where they go, and what pushes the robot.

Where discs are large enough to be drawn as rings, an arrow's length tells how fast or how strong; elsewhere it takes
one cell. Velocities have single arrows, the resultant of the repulsive forces a double one.
"""

import numpy as np
from rich.text import Text

from sfmrl.geometry import direction, length
from sfmrl.replay.canvas import (
    ARROWS,
    BAD,
    FAINT,
    GOAL,
    NEXT_CELL,
    PERSON,
    PUSH,
    PUSHES,
    ROBOT,
    SQUARE,
    WATCHED,
    Canvas,
    View,
    octant,
)
from sfmrl.replay.story import Story, number
from sfmrl.sfm import resultant

MEMORY = 8  # moments that a person's trail goes back
FINE = 4  # points of the robot's trail a step
LARGE = 0.9  # rows: discs of at least this radius are drawn as rings
RING = np.stack((np.cos(np.arange(48) * np.pi / 24), np.sin(np.arange(48) * np.pi / 24)), -1)
REACH = 0.5  # m that an arrow is long for 1 m/s or 1 m/s^2
STRONG = 2.0  # m/s or m/s^2: no arrow is longer than that of these


def moment(story: Story, t: int, view: View, people_trails: bool) -> Canvas:
    """The scene at moment `t`, with where the robot has been and, if asked for, where people have just been."""
    canvas = Canvas(view)
    people = ~story.square
    people[0] = False
    if people_trails:
        been = story.position[max(t - MEMORY, 0) : t, people]
        away = length(been - story.position[t, people]) > story.radius[people]
        canvas.dots(been[away], FAINT)
    share = np.arange(FINE)[:, None, None] / FINE
    way = (1 - share) * story.position[:t, 0] + share * story.position[1 : t + 1, 0]  # (FINE, t, 2)
    canvas.dots(way[length(way - story.position[t, 0]) > story.radius[0]], ROBOT)
    marked = {int(story.attention[t].argmax()) + 1: WATCHED} if story.attention is not None else {}
    hit = story.hit if t == story.last else story.hit[:0]
    if len(hit):
        marked |= {int(row): BAD for row in (0, *hit)}
    push = resultant(story.force[t])
    draw(canvas, story.position[t], story.velocity[t], story.goal[0], story.radius, story.square, marked, push)
    for row in hit:
        where = story.position[t, [0, row]]
        canvas.put(where.mean(0), "X", BAD)
        canvas.put(where[1], number(row), f"{BAD} reverse" if story.square[row] else BAD)
        canvas.put(where[0], "@", BAD)
    return canvas


def draw(canvas: Canvas, position, velocity, goal, radius, square, marked=None, push=(0.0, 0.0)) -> None:
    """Draw squares, the robot's goal, people and the robot, each over those before it.

    `position` and `velocity` (N, 2) in m and m/s, `radius` (N,) in m, `square` (N,) bool; `marked` gives rows their own
    style, `push` (2,) is the force on the robot in m/s^2.
    """
    marked = marked or {}
    canvas.squares(position[square], radius[square], SQUARE)
    for row in np.flatnonzero(square):
        canvas.put(position[row], number(row), f"{marked.get(row, SQUARE)} reverse")
    canvas.put(goal, "★", GOAL)
    for row in np.flatnonzero(~square & (radius >= LARGE * canvas.view.row))[::-1]:
        canvas.dots(position[row] + radius[row] * RING, marked.get(row, FAINT if row else ROBOT))
    same = octant(push) == octant(velocity[0]) and length(velocity[0]) > 0.05
    _arrow(canvas, position[0], np.asarray(push), radius[0], PUSHES, PUSH, 2 if same else 1)
    for row in np.flatnonzero(~square)[::-1]:
        _arrow(canvas, position[row], velocity[row], radius[row], ARROWS, marked.get(row, "" if row else ROBOT))
    for row in np.flatnonzero(~square)[::-1]:
        canvas.put(position[row], number(row) if row else "@", marked.get(row, PERSON if row else ROBOT))


def _arrow(canvas: Canvas, place, way, radius: float, glyphs: str, style: str, cells: int = 1) -> None:
    """An arrow along `way` from the edge of a disc at `place`, or `cells` away where discs are too small for rings."""
    size = min(length(way), STRONG)
    if not size > 0.05:  # NaN, too
        return
    if radius < LARGE * canvas.view.row:
        canvas.put(place, glyphs[octant(way)], style, cells * NEXT_CELL[octant(way)])
        return
    along = radius + REACH * size * np.linspace(0.0, 1.0, 16)[:, None]
    points = place + along * direction(way)
    canvas.dots(points, style)
    canvas.put(points[-1], glyphs[octant(way)], style)


def bordered(lines: list[Text], title: str, view: View) -> list[Text]:
    """The plane in its frame, with a title above and the length of 1 m below."""
    metre = max(round(2 / view.row), 1)
    scale = f" 1 m ├{'─' * (metre - 2)}┤ " if 2 <= metre <= view.columns - 12 else ""
    head = Text(f" {title} ", "bold")
    head.truncate(view.columns - 2, overflow="ellipsis")
    over = Text.assemble(("╭─", FAINT), head, ("─" * (view.columns - 1 - head.cell_len) + "╮", FAINT))
    under = Text.assemble(("╰" + scale.rjust(view.columns - 1, "─") + "─╯", FAINT))
    return [over, *[Text.assemble(("│", FAINT), line, ("│", FAINT)) for line in lines], under]
