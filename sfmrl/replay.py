"""An episode of a record as text frames: a map, a panel of what the robot weighs up, and a timeline of what happened.

Pure: nothing is printed, and one episode's frames share one view that shows every place that anybody visits. At
80 x 24 a column is about 0.2 m and a row 0.4 m. Below 60 x 16 the panel goes, below 20 x 8 all but the map.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.text import Text

from sfmrl.canvas import (
    ARROWS,
    BAD,
    FAINT,
    GOAL,
    NEXT_CELL,
    PERSON,
    ROBOT,
    SQUARE,
    WATCHED,
    Canvas,
    View,
    fit_view,
    fitted,
    octant,
    styled,
    tidy,
    to_ascii,
)
from sfmrl.config import Reward
from sfmrl.episodes import Record
from sfmrl.geometry import direction, length
from sfmrl.panel import panel_lines
from sfmrl.scenarios import Scenes
from sfmrl.screen import play_live
from sfmrl.story import Story, number, scene_name, tell
from sfmrl.timeline import sentence, timeline

__all__ = ["Frame", "make_frames", "play_live", "scene_picture", "strip"]

PANEL = (32, 44)  # columns of the panel, at least and at most
MEMORY = 8  # moments that a person's trail goes back
LARGE = 0.9  # rows: discs of at least this radius are drawn as rings
RING = np.stack((np.cos(np.arange(24) * np.pi / 12), np.sin(np.arange(24) * np.pi / 12)), -1)


@dataclass(frozen=True)
class Frame:
    """One moment's picture: a Rich text of at most the lines and columns asked for."""

    text: Text
    time: float  # s

    @property
    def plain(self) -> str:
        """The frame without colour, its lines without trailing spaces."""
        return "\n".join(line.rstrip() for line in self.text.plain.split("\n"))

    def __rich__(self) -> Text:
        return self.text


def make_frames(
    record: Record,
    episode: int = 0,
    *,
    policy=None,
    label: str = "",
    reward: Reward | None = None,
    discount: float | None = None,
    width: int = 80,
    height: int = 24,
    ascii_only: bool = False,
) -> list[Frame]:
    """The T + 1 frames of the episode in row `episode` of a record, the last one with its outcome.

    `policy` adds what it weighs up if it has SARL's `lookahead` and `attention`; `label` is its name in the heading.
    `reward` and `discount` are those of the panel's account (default: the policy's own).
    """
    story = tell(record, episode, policy, reward, discount)
    size = _Size.within(width, height, _places(story))
    title = " · ".join(([tidy(label)] if label else []) + [story.name])
    frames = []
    for t in range(story.last + 1):
        lines = _map(story, t, size.view, people_trails=not ascii_only).lines()
        if size.bordered:
            lines = _bordered(lines, title if size.panel else f"{story.time[t]:.2f} s · {title}", size.view)
        if size.panel:
            panel = panel_lines(story, t, len(lines), size.panel)
            lines = [line + Text(" ") + beside for line, beside in zip(lines, panel, strict=True)]
        if size.bordered:
            total = lines[0].cell_len
            lines += [timeline(story, t, total), fitted(sentence(story, t), total)]
        frames.append(Frame(_joined(lines, width, height, ascii_only), float(story.time[t])))
    return frames


def strip(frames: Sequence[Frame], count: int) -> list[Frame]:
    """`count` frames, evenly spaced, the last one and (from 2 on) the first among them; all if there are fewer."""
    if count >= len(frames):
        return list(frames)
    picked = np.linspace(len(frames) - 1, 0, max(count, 0))[::-1]
    return [frames[round(k)] for k in picked]


def scene_picture(
    scenes: Scenes, episode: int = 0, *, width: int = 80, height: int = 24, ascii_only: bool = False
) -> Text:
    """The scene in row `episode` before anybody moves: starts, the ways that people face, and where all want to go."""
    start, goal, square = scenes.start[episode], scenes.goal[episode], scenes.square[episode]
    rows = max(height - 3, 1)
    size = _Size.within(width, rows + 4, np.concatenate((start, goal)), panel=False)
    facing = np.where(square[:, None], 0.0, direction(goal - start))
    canvas = Canvas(size.view)
    for k in np.flatnonzero(~square)[1:]:
        canvas.put(goal[k], "x", FAINT)
    _draw(canvas, start, facing, goal[0], scenes.radius[episode], square)
    lines = canvas.lines()
    if size.bordered:
        lines = _bordered(lines, scene_name(scenes.environment[episode], scenes.episode[episode]), size.view)
        legend = (("@", ROBOT), (" robot  ", ""), ("★", GOAL), (" its goal  ", ""))
        legend += ((" 1→", PERSON), (" person and heading  ", ""), ("x", FAINT), (" a person's goal  ", ""))
        lines.append(styled((*legend, ("█", SQUARE), (" square", ""))))
    return _joined(lines, width, height, ascii_only)


@dataclass(frozen=True)
class _Size:
    """How a frame is laid out: its view, whether it has a border, and the columns of its panel (0: none)."""

    view: View
    bordered: bool
    panel: int

    @staticmethod
    def within(width: int, height: int, points: np.ndarray, panel: bool = True) -> "_Size":
        """The layout of a frame of `width` x `height` whose map shows all `points` (n, 2)."""
        bordered = width >= 20 and height >= 8
        rows = max(height - 4 * bordered, 1)
        if not bordered:
            return _Size(fit_view(points, rows, max(width, 1)), False, 0)
        tall = fit_view(points, rows, 1_000_000).row  # m a row if only the height counted
        span = np.ptp(points[np.isfinite(points).all(-1)], axis=0)[0] if len(points) else 0.0
        wanted = max(int(np.ceil(2 * (span + 0.3) / tall)), 2 * rows)  # columns
        columns, beside = width - 2, 0
        if panel and width >= 60 and height >= 16:
            beside = int(np.clip(width - 3 - 1.1 * wanted, *PANEL))
            columns = width - 3 - beside
        return _Size(fit_view(points, rows, min(columns, int(1.3 * wanted))), True, beside)


def _places(story: Story) -> np.ndarray:
    """Everywhere that the episode's map must show, (n, 2) m: all positions, starts and goals."""
    return np.concatenate((story.position.reshape(-1, 2), story.start, story.goal))


def _map(story: Story, t: int, view: View, people_trails: bool) -> Canvas:
    """The scene at moment `t`, with where the robot has been and, if asked for, where people have just been."""
    canvas = Canvas(view)
    people = ~story.square
    people[0] = False
    been = np.where(
        (length(story.position[:t] - story.position[t]) > story.radius)[..., None], story.position[:t], np.nan
    )
    if people_trails:
        canvas.dots(been[-MEMORY:, people].reshape(-1, 2), FAINT)
    canvas.dots(been[:, 0], ROBOT)
    marked = {int(story.attention[t].argmax()) + 1: WATCHED} if story.attention is not None else {}
    hit = story.hit if t == story.last else story.hit[:0]
    if len(hit):
        marked |= {int(row): BAD for row in (0, *hit)}
    _draw(canvas, story.position[t], story.velocity[t], story.goal[0], story.radius, story.square, marked)
    for row in hit:
        where = story.position[t, [0, row]]
        canvas.put(where.mean(0), "X", BAD)
        canvas.put(where[1], number(row), f"{BAD} reverse" if story.square[row] else BAD)
        canvas.put(where[0], "@", BAD)
    return canvas


def _draw(canvas: Canvas, position, velocity, goal, radius, square, marked: dict[int, str] | None = None) -> None:
    """Draw squares, the robot's goal, people and the robot, each over those before it; `marked` rows in own styles."""
    marked = marked or {}
    canvas.squares(position[square], radius[square], SQUARE)
    for row in np.flatnonzero(square):
        canvas.put(position[row], number(row), f"{marked.get(row, SQUARE)} reverse")
    canvas.put(goal, "★", GOAL)
    for row in np.flatnonzero(~square & (radius >= LARGE * canvas.view.row))[::-1]:
        canvas.dots(position[row] + radius[row] * RING, marked.get(row, FAINT if row else ROBOT))
    moving = np.flatnonzero(~square & (length(velocity) > 0.05))
    for row in moving[::-1]:
        way = octant(velocity[row])
        canvas.put(position[row], ARROWS[way], marked.get(row, "" if row else ROBOT), NEXT_CELL[way])
    for row in np.flatnonzero(~square)[::-1]:
        canvas.put(position[row], number(row) if row else "@", marked.get(row, PERSON if row else ROBOT))


def _bordered(lines: list[Text], title: str, view: View) -> list[Text]:
    """The map in its frame, with a title above and the length of 1 m below."""
    metre = max(round(2 / view.row), 1)
    scale = f" 1 m ├{'─' * (metre - 2)}┤ " if 2 <= metre <= view.columns - 12 else ""
    head = Text(f" {title} ", "bold")
    head.truncate(view.columns - 2, overflow="ellipsis")
    over = Text.assemble(("╭─", FAINT), head, ("─" * (view.columns - 1 - head.cell_len) + "╮", FAINT))
    under = Text("╰" + scale.rjust(view.columns - 1, "─") + "─╯", FAINT)
    return [over, *[Text.assemble(("│", FAINT), line, ("│", FAINT)) for line in lines], under]


def _joined(lines: list[Text], width: int, height: int, ascii_only: bool) -> Text:
    """Lines as one text, cut to the size."""
    text = Text("\n", no_wrap=True, overflow="crop").join(
        fitted(line, min(width, line.cell_len)) for line in lines[:height]
    )
    return to_ascii(text) if ascii_only else text
