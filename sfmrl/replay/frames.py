"""Put frames together: the plane, its panel or a few facts, and the timeline, in any size, for one policy or two.

All frames of an episode share one view, which shows every position and goal. A frame below 60 x 16 has no panel, below
20 x 8 it is the plane alone. Two policies in the same episode stand side by side, at the same time and scale: with both
panels from 161 columns on, with facts below the planes from 61 on, else one above the other.
"""

from dataclasses import dataclass

import numpy as np
from rich.cells import cell_len
from rich.text import Text

from sfmrl.geometry import direction
from sfmrl.replay.canvas import MARGIN, Canvas, Style, View, fit_view, fitted, row_height, shortened, span, to_ascii
from sfmrl.replay.panel import facts_lines, panel_lines
from sfmrl.replay.plane import bordered, draw_moment, draw_scene
from sfmrl.replay.story import Story, scene_name
from sfmrl.replay.timeline import sentence, timeline
from sfmrl.scenes import Scenes

SIDE_BY_SIDE_COLUMNS = 61  # least columns for two policies side by side; else one stands above the other
TWO_PANELS_COLUMNS = 161  # least columns for two policies side by side, each with a panel
STACKED_LINES = 16  # least lines for two policies one above the other
PANEL_COLUMNS = (32, 44)  # least and most columns of a panel beside the plane
PANEL_LINES = 9  # least lines below a plane for a panel; fewer lines show a few facts


@dataclass(frozen=True)
class Frame:
    """One moment's picture, `time` s after the start."""

    text: Text
    time: float

    @property
    def plain(self) -> str:
        """The frame without colour; lines have no trailing spaces."""
        return "\n".join(line.rstrip() for line in self.text.plain.split("\n"))


@dataclass(frozen=True)
class Replay:
    """One episode as played by one policy or by two, to be drawn at any moment and in any size.

    `labels` are the policies' names. If one of two ends before the other, it stays as it ended.
    """

    stories: tuple[Story, ...]
    labels: tuple[str, ...]
    ascii_only: bool = False

    @property
    def last(self) -> int:
        """The last moment."""
        return max(story.last for story in self.stories)

    @property
    def time_step(self) -> float:
        """Seconds from one moment to the next."""
        return float(self.stories[0].time[1])

    @property
    def title(self) -> str:
        """Policies, environment and episode in a line."""
        words = _titles(" and ".join(filter(None, self.labels)), self.stories[0])[0]
        return to_ascii(Text(words)).plain if self.ascii_only else words

    def frame(self, t: int, width: int = 80, height: int = 24) -> Frame:
        """The picture at moment `t`, of at most `width` columns and `height` lines."""
        points = np.concatenate(
            [part.reshape(-1, 2) for story in self.stories for part in (story.position, story.goal)]
        )
        facts = 2 if all(story.attention is None for story in self.stories) else 3  # lines, at least
        if len(self.stories) == 1:
            lines = self._draw(0, t, _lay_out(width, height, points), width)
        elif width < SIDE_BY_SIDE_COLUMNS:
            lines = self._draw(0, t, _lay_out_wide(width, -(-height // 2), points, facts), width)
            lines += self._draw(1, t, _lay_out_wide(width, height - len(lines), points, facts), width)
        else:
            half, panels = (width - 1) // 2, width >= TWO_PANELS_COLUMNS
            layout = _lay_out(half, height, points) if panels else _lay_out_wide(half, height, points, facts)
            both = (self._draw(k, t, layout, half) for k in (0, 1))
            lines = [Text.assemble(fitted(a, half), " ", fitted(b, half)) for a, b in zip(*both, strict=True)]
        return Frame(_joined(lines[:height], self.ascii_only), min(t, self.last) * self.time_step)

    def frames(
        self, width: int = 80, height: int = 24, count: int | None = None, at: float | None = None
    ) -> list[Frame]:
        """All frames, or `count` evenly spaced ones, or the one nearest to the time `at` in s."""
        moments = range(self.last + 1) if count is None else evenly_spaced(self.last, count)
        if at is not None:
            moments = [round(min(at / self.time_step, self.last))]
        return [self.frame(t, width, height) for t in moments]

    def _draw(self, k: int, t: int, layout: "_Layout", width: int) -> list[Text]:
        """Story `k` at moment `t`, or at its end: the plane, the numbers, and the timeline in at most `width`."""
        story = self.stories[k]
        t = min(t, story.last)
        lines = draw_moment(story, t, layout.view, people_trails=not self.ascii_only).lines()
        if not layout.bordered:
            return lines
        titles = _titles(self.labels[k], story)
        if not (layout.beside or layout.below):  # neither a panel nor facts show the time
            titles = [*(f"{story.time[t]:.2f} s · {words}" for words in titles), titles[-1]]
        lines = bordered(lines, titles, layout.view)
        if layout.beside:
            panel = panel_lines(story, t, len(lines), layout.beside)
            lines = [Text.assemble(line, " ", beside) for line, beside in zip(lines, panel, strict=True)]
        columns, words = lines[0].cell_len, sentence(story, t, width)
        numbers = panel_lines if layout.below >= PANEL_LINES else facts_lines
        lines += numbers(story, t, layout.below, columns)
        return [*lines, timeline(story, t, columns), fitted(words, max(columns, min(words.cell_len, width)))]


def evenly_spaced(last: int, count: int) -> list[int]:
    """`count` of the moments 0 to `last`, evenly spaced, with `last` and (if `count` > 1) 0; all if there are fewer."""
    return [round(t) for t in np.linspace(last, 0, min(count, last + 1))[::-1]]


@dataclass(frozen=True)
class _Layout:
    """The view of the plane, whether it has a border, columns of a panel beside it, lines of numbers below it."""

    view: View
    bordered: bool = True
    beside: int = 0
    below: int = 0


def _lay_out(width: int, height: int, points: np.ndarray, panel: bool = True) -> _Layout:
    """The layout of `width` x `height` characters whose plane shows all `points` (n, 2) m.

    In an environment's usual scene at 80 x 24, a column is about 0.2 m wide and a row 0.4 m high.
    """
    if width < 20 or height < 8:
        return _Layout(fit_view(points, max(height, 1), max(width, 1)), bordered=False)
    rows = height - 4  # border, timeline and sentence
    wanted = 2 * (span(points)[0] + 2 * MARGIN) / row_height(points, rows)
    wanted = max(int(np.ceil(wanted)), 2 * rows)  # columns
    columns, beside = width - 2, 0
    if panel and width >= 60 and height >= 16:
        beside = int(np.clip(width - 3 - 1.1 * wanted, *PANEL_COLUMNS))
        columns = width - 3 - beside
    return _Layout(fit_view(points, rows, min(columns, int(1.3 * wanted))), beside=beside)


def _lay_out_wide(width: int, height: int, points: np.ndarray, facts: int) -> _Layout:
    """The layout with the plane in full width, and below it at least `facts` lines of numbers if the plane has room."""
    if width < 20 or height < 8:
        return _lay_out(width, height, points)
    needed = span(points)[1] / row_height(points, columns=width - 2)  # rows of the plane
    most = max(height - 12, 0)
    below = int(np.clip(height - 5 - needed, min(facts, most), most))
    return _Layout(fit_view(points, height - below - 4, width - 2), below=below)


def _titles(label: str, story: Story) -> list[str]:
    """Wordings of a title, from the longest to the shortest."""
    label = "".join(c if c.isprintable() and cell_len(c) == 1 else "?" for c in label)
    return shortened(f"{label} · {story.name}" if label else story.name)


def _joined(lines: list[Text], ascii_only: bool) -> Text:
    text = Text("\n", no_wrap=True, overflow="crop").join(lines)
    return to_ascii(text) if ascii_only else text


def scene_picture(
    scenes: Scenes, episode: int = 0, *, width: int = 80, height: int = 24, ascii_only: bool = False
) -> Text:
    """The scene in row `episode` before the first step: starts, goals, and headings from start to goal."""
    start, goal, square = scenes.start[episode], scenes.goal[episode], scenes.square[episode]
    # A line of legend takes the place of the two below a replay's plane.
    layout = _lay_out(width, max(height - 3, 1) + 4, np.concatenate((start, goal)), panel=False)
    heading = np.where(square[:, None], 0.0, direction(goal - start))
    canvas = Canvas(layout.view)
    for person in np.flatnonzero(~square)[1:]:
        canvas.put(goal[person], "x", Style.DIM)
    draw_scene(canvas, start, heading, goal[0], scenes.radius[episode], square, marked={}, push=np.zeros(2))
    lines = canvas.lines()
    if layout.bordered:
        titles = shortened(scene_name(scenes.environment[episode], scenes.episode[episode]))
        lines = [*bordered(lines, titles, layout.view), _scene_legend(width)]
    return _joined(lines[:height], ascii_only)


def _scene_legend(width: int) -> Text:
    """The glyphs of a scene's picture, with as many words as fit into `width` columns."""
    glyphs = (("@", Style.ROBOT), ("★", Style.GOAL), (" 1→", Style.PERSON), ("x", Style.DIM), ("█", Style.SQUARE))
    words = ("robot", "its goal", "person and heading", "a person's goal", "square")
    fewer = ("robot", "goal", "person", "", "square")
    legends = []
    for names in (words, *(fewer[:count] for count in range(len(fewer), 0, -1))):
        entries = (Text.assemble(glyph, f" {name}") for glyph, name in zip(glyphs, names, strict=False) if name)
        legends.append(Text("  ").join(entries))
    return next(legend for legend in legends if legend.cell_len <= width)
