"""An episode of a record as text frames: the plane, a panel of what the robot weighs up, a timeline of what happened.

Pure: nothing is printed, and one episode's frames share one view that shows every place that anybody visits. At
80 x 24 a column is about 0.2 m and a row 0.4 m. Below 60 x 16 the panel goes, below 20 x 8 all but the plane. Two
policies in the same episode stand side by side, in step and in one scale: each with its panel from 161 columns on, with
its facts below the plane from 61 on, and one above the other where there are fewer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from rich.text import Text

from sfmrl.canvas import FAINT, GOAL, PERSON, ROBOT, SQUARE, Canvas, View, fit_view, fitted, styled, tidy, to_ascii
from sfmrl.config import Reward
from sfmrl.episodes import Record
from sfmrl.geometry import direction
from sfmrl.panel import facts_lines, panel_lines
from sfmrl.plane import bordered, draw, moment
from sfmrl.scenarios import Scenes
from sfmrl.story import Story, scene_name, tell
from sfmrl.timeline import sentence, timeline

PANEL = (32, 44)  # columns of the panel, at least and at most
BESIDE = 61  # columns from which two policies stand side by side, else one above the other
WHOLE = 161  # ... and from which each has its panel
STACKED = 16  # lines that two, one above the other, must have
PANELLED = 9  # lines of facts below a plane from which they are a panel
Item = TypeVar("Item")


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


@dataclass(frozen=True)
class Replay:
    """One episode as one policy has played it, or two, to be drawn at any moment and in any size.

    Where one of two has ended before the other, it stays as it ended. `labels` are the policies' names.
    """

    stories: tuple[Story, ...]
    labels: tuple[str, ...]
    ascii_only: bool = False

    @property
    def last(self) -> int:
        """The last moment; the first is 0."""
        return max(story.last for story in self.stories)

    @property
    def time_step(self) -> float:
        """Seconds from one moment to the next."""
        return float(self.stories[0].time[1])

    @property
    def title(self) -> str:
        """Who plays what, in a line."""
        words = _titled(" and ".join(filter(None, self.labels)), self.stories[0])
        return to_ascii(Text(words)).plain if self.ascii_only else words

    def frame(self, t: int, width: int = 80, height: int = 24) -> Frame:
        """The picture at moment `t`, of at most `width` columns and `height` lines."""
        places = np.concatenate([_places(story) for story in self.stories])
        sides = [
            _Side(story, min(t, story.last), _titled(label, story), places, trails=not self.ascii_only)
            for story, label in zip(self.stories, self.labels, strict=True)
        ]
        facts = 2 if all(story.attention is None for story in self.stories) else 3
        if len(sides) == 1:
            lines = sides[0].with_panel(width, height)
        elif width < BESIDE:
            lines = sides[0].above_facts(width, -(-height // 2), facts)
            lines += sides[1].above_facts(width, height - len(lines), facts)
        else:
            half = (width - 1) // 2
            left, right = (
                side.with_panel(half, height) if width >= WHOLE else side.above_facts(half, height, facts)
                for side in sides
            )
            lines = [fitted(a, half) + Text(" ") + b for a, b in zip(left, right, strict=True)]
        return Frame(_joined(lines, width, height, self.ascii_only), max(side.time for side in sides))

    def frames(self, width: int = 80, height: int = 24, count: int | None = None) -> list[Frame]:
        """All frames, or `count` of them as `strip` chooses."""
        moments = range(self.last + 1)
        return [self.frame(t, width, height) for t in (moments if count is None else strip(moments, count))]


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
    return Replay((tell(record, episode, policy, reward, discount),), (label,), ascii_only).frames(width, height)


def strip(frames: Sequence[Item], count: int) -> list[Item]:
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
    draw(canvas, start, facing, goal[0], scenes.radius[episode], square)
    lines = canvas.lines()
    if size.bordered:
        lines = bordered(lines, scene_name(scenes.environment[episode], scenes.episode[episode]), size.view)
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
        """The layout of a frame of `width` x `height` whose plane shows all `points` (n, 2)."""
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
    """Everywhere that the episode's plane must show, (n, 2) m: all positions, starts and goals."""
    return np.concatenate((story.position.reshape(-1, 2), story.start, story.goal))


def _titled(label: str, story: Story) -> str:
    return " · ".join(([tidy(label)] if label else []) + [story.name])


@dataclass(frozen=True)
class _Side:
    """One story at moment `t`, to be drawn on a plane that shows all `places` (n, 2) m."""

    story: Story
    t: int
    title: str
    places: np.ndarray
    trails: bool  # of people

    @property
    def time(self) -> float:
        return float(self.story.time[self.t])

    @property
    def _timed_title(self) -> str:
        return f"{self.time:.2f} s · {self.title}"

    def with_panel(self, width: int, height: int) -> list[Text]:
        """The plane with the panel beside it, and the timeline below."""
        size = _Size.within(width, height, self.places)
        lines = self._plane(size.view)
        if not size.bordered:
            return lines
        lines = bordered(lines, self.title if size.panel else self._timed_title, size.view)
        if size.panel:
            panel = panel_lines(self.story, self.t, len(lines), size.panel)
            lines = [line + Text(" ") + beside for line, beside in zip(lines, panel, strict=True)]
        return lines + self._times(lines[0].cell_len, width)

    def above_facts(self, width: int, height: int, facts: int) -> list[Text]:
        """The plane as wide as it can be, facts below it in the lines that it leaves, and the timeline.

        There are at least so many lines of `facts` where there are enough for the plane.
        """
        span = np.ptp(self.places[np.isfinite(self.places).all(-1)], axis=0)[1]
        needed = span / fit_view(self.places, 1_000_000, width - 2).row  # rows of the plane
        most = max(height - 12, 0)
        below = int(np.clip(height - 5 - needed, min(facts, most), most))
        size = _Size.within(width, height - below, self.places, panel=False)
        if not size.bordered:
            return self._plane(size.view)
        view = fit_view(self.places, size.view.rows, width - 2)
        lines = bordered(self._plane(view), self.title if below else self._timed_title, view)
        told = panel_lines if below >= PANELLED else facts_lines
        return lines + told(self.story, self.t, below, width) + self._times(width, width)

    def _plane(self, view: View) -> list[Text]:
        return moment(self.story, self.t, view, self.trails).lines()

    def _times(self, columns: int, width: int) -> list[Text]:
        """When it happened, in as many columns as the rest has, and what, in up to `width`."""
        words = sentence(self.story, self.t, width)
        return [timeline(self.story, self.t, columns), fitted(words, max(columns, min(words.cell_len, width)))]


def _joined(lines: list[Text], width: int, height: int, ascii_only: bool) -> Text:
    """Lines as one text, cut to the size."""
    text = Text("\n", no_wrap=True, overflow="crop").join(
        fitted(line, min(width, line.cell_len)) for line in lines[:height]
    )
    return to_ascii(text) if ascii_only else text
