"""Draw the scene from above: positions, trails and velocities of the robot and people, and the force on the robot.

Velocities are single arrows, the resultant of the repulsive forces is a double one. If the scale is large enough to
draw discs as rings, the length of an arrow shows the magnitude; otherwise an arrow is one glyph beside its disc. A
unicycle robot has an arrow along its heading even where it stands.
"""

from collections.abc import Sequence

import numpy as np
from rich.text import Text

from sfmrl.geometry import direction, length, unit_at
from sfmrl.replay.canvas import FORCE_ARROWS, NEIGHBOURS, VELOCITY_ARROWS, Canvas, Style, View, first_fitting, octant
from sfmrl.replay.story import Story, glyph_of
from sfmrl.sfm import resultant

TRAIL_MOMENTS = 8  # length of a person's trail
TRAIL_POINTS = 4  # points per step of the robot's trail
RING_ROWS = 0.9  # rows: discs of at least this radius are drawn as rings
UNIT_RING = unit_at(np.arange(48) * np.pi / 24)
ARROW_METRES = 0.5  # m, length of an arrow for 1 m/s or 1 m/s^2
STANDING = 0.3  # m/s, for which a unicycle robot has an arrow if it is slower
ARROW_RANGE = (0.05, 2.0)  # m/s or m/s^2: no arrow for less, no longer arrow for more


def draw_moment(story: Story, t: int, view: View, people_trails: bool) -> Canvas:
    """The scene at moment `t` with the robot's trail and, if `people_trails`, those of people."""
    canvas, position = Canvas(view), story.position
    if people_trails:
        people = np.flatnonzero(~story.square)[1:]
        trail = position[max(t - TRAIL_MOMENTS, 0) : t, people]
        outside = length(trail - position[t, people]) > story.radius[people]  # of the person's own disc
        canvas.dots(trail[outside], Style.DIM)
    share = np.arange(TRAIL_POINTS)[:, None, None] / TRAIL_POINTS
    trail = (1 - share) * position[:t, 0] + share * position[1 : t + 1, 0]  # (TRAIL_POINTS, t, 2)
    canvas.dots(trail[length(trail - position[t, 0]) > story.radius[0]], Style.ROBOT)
    attention = np.zeros(0) if story.attention is None else story.attention[t]
    marked = {1 + attention.argmax(): Style.MOST_ATTENTION} if attention.any() else {}
    hit = story.hit if t == story.last else ()
    if len(hit):
        marked |= dict.fromkeys((0, *hit), Style.DANGER)
    push, velocity = resultant(story.force[t]), story.velocity[t].copy()
    if story.heading is not None:
        velocity[0] = max(length(velocity[0]), STANDING) * unit_at(story.heading[t])
    draw_scene(canvas, position[t], velocity, story.goal[0], story.radius, story.square, marked, push)
    for row in hit:
        canvas.put(position[t, [0, row]].mean(0), "X", Style.DANGER)
        canvas.put(position[t, row], glyph_of(row), f"{Style.DANGER} reverse" if story.square[row] else Style.DANGER)
        canvas.put(position[t, 0], "@", Style.DANGER)
    return canvas


def draw_scene(canvas: Canvas, position, velocity, goal, radius, square, marked: dict, push: np.ndarray) -> None:
    """Draw squares, the robot's goal, people and the robot; the later ones cover the earlier ones.

    `position` and `velocity` (N, 2) in m and m/s, `goal` (2,) the robot's, `radius` (N,) in m, `square` (N,) bool;
    `marked` has styles for some of the rows, `push` (2,) is the force on the robot in m/s^2.
    """
    canvas.squares(position[square], radius[square], Style.SQUARE)
    for row in np.flatnonzero(square):
        canvas.put(position[row], glyph_of(row), f"{marked.get(row, Style.SQUARE)} reverse")
    canvas.put(goal, "★", Style.GOAL)
    discs = np.flatnonzero(~square)[::-1]  # the robot last, above all
    for row in discs[radius[discs] >= RING_ROWS * canvas.view.row]:
        canvas.dots(position[row] + radius[row] * UNIT_RING, marked.get(row, Style.DIM if row else Style.ROBOT))
    # Where both arrows of the robot would share a cell, the force takes the next one.
    same_cell = octant(push) == octant(velocity[0]) and length(velocity[0]) > ARROW_RANGE[0]
    _draw_arrow(canvas, position[0], push, radius[0], FORCE_ARROWS, Style.FORCE, 2 if same_cell else 1)
    for row in discs:
        style = marked.get(row, "" if row else Style.ROBOT)
        _draw_arrow(canvas, position[row], velocity[row], radius[row], VELOCITY_ARROWS, style)
    for row in discs:
        style = marked.get(row, Style.PERSON if row else Style.ROBOT)
        canvas.put(position[row], glyph_of(row) if row else "@", style)


def _draw_arrow(canvas: Canvas, place, vector, radius: float, glyphs: str, style: str, cells: int = 1) -> None:
    """Draw an arrow from the edge of a disc at `place`; its head alone, `cells` away, if the disc is not a ring."""
    size = min(float(length(vector)), ARROW_RANGE[1])
    if not size > ARROW_RANGE[0]:  # NaN, too
        return
    head = glyphs[octant(vector)]
    if radius < RING_ROWS * canvas.view.row:
        canvas.put(place, head, style, cells * NEIGHBOURS[octant(vector)])
        return
    along = radius + ARROW_METRES * size * np.linspace(0.0, 1.0, 16)[:, None]
    points = place + along * direction(vector)
    canvas.dots(points, style)
    canvas.put(points[-1], head, style)


def bordered(lines: list[Text], titles: Sequence[str], view: View) -> list[Text]:
    """The lines of a plane in a border, with the first of the `titles` that fits and the length of 1 m."""
    metre = max(round(2 / view.row), 1)  # columns
    scale = f" 1 m ├{'─' * (metre - 2)}┤ " if 2 <= metre <= view.columns - 12 else ""
    head = Text(f" {first_fitting(titles, view.columns - 4)} ", "bold")
    head.truncate(view.columns - 2, overflow="ellipsis")
    upper = Text.assemble(("╭─", Style.DIM), head, ("─" * (view.columns - 1 - head.cell_len) + "╮", Style.DIM))
    lower = Text.assemble(("╰" + scale.rjust(view.columns - 1, "─") + "─╯", Style.DIM))
    return [upper, *[Text.assemble(("│", Style.DIM), line, ("│", Style.DIM)) for line in lines], lower]
