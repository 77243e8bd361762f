"""An episode of a record as text frames: the plane, a panel of what the robot weighs up, a timeline of what happened.

Pure: nothing is printed, and one episode's frames share one view that shows every place that anybody visits. Two
policies in the same episode stand side by side, in step and in one scale: each with its panel from 161 columns on, with
its facts below the plane from 61 on, and one above the other where there are fewer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from rich.text import Text

from sfmrl.geometry import direction
from sfmrl.replay.canvas import FAINT, GOAL, PERSON, ROBOT, SQUARE, Canvas, fitted, styled, tidy, to_ascii
from sfmrl.replay.layout import Side, Size, joined
from sfmrl.replay.plane import bordered, draw
from sfmrl.replay.story import Story, scene_name
from sfmrl.scenes import Scenes

BESIDE = 61  # columns from which two policies stand side by side, else one above the other
WHOLE = 161  # ... and from which each has its panel
STACKED = 16  # lines that two, one above the other, must have
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
            Side(story, min(t, story.last), _titled(label, story), places, trails=not self.ascii_only)
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
            lines = [Text.assemble(fitted(a, half), " ", fitted(b, half)) for a, b in zip(left, right, strict=True)]
        return Frame(joined(lines, width, height, self.ascii_only), max(side.time for side in sides))

    def frames(
        self, width: int = 80, height: int = 24, count: int | None = None, at: float | None = None
    ) -> list[Frame]:
        """All frames, `count` of them as `strip` chooses, or the one `at` so many seconds, the last one at most."""
        moments = range(self.last + 1)
        if at is not None:
            moments = [round(min(at / self.time_step, self.last))]
        elif count is not None:
            moments = strip(moments, count)
        return [self.frame(t, width, height) for t in moments]


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
    size = Size.within(width, rows + 4, np.concatenate((start, goal)), panel=False)
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
    return joined(lines, width, height, ascii_only)


def _places(story: Story) -> np.ndarray:
    """Everywhere that the episode's plane must show, (n, 2) m: all positions, starts and goals."""
    return np.concatenate((story.position.reshape(-1, 2), story.start, story.goal))


def _titled(label: str, story: Story) -> str:
    return " · ".join(([tidy(label)] if label else []) + [story.name])
