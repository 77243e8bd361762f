"""How a picture is put together: the plane of one story, its panel or facts, and the timeline, in columns and lines.

Below 60 x 16 the panel goes, below 20 x 8 all but the plane. At 80 x 24 a column is about 0.2 m and a row 0.4 m.
"""

from dataclasses import dataclass

import numpy as np
from rich.text import Text

from sfmrl.replay.canvas import View, fit_view, fitted, to_ascii
from sfmrl.replay.panel import facts_lines, panel_lines
from sfmrl.replay.plane import bordered, moment
from sfmrl.replay.story import Story
from sfmrl.replay.timeline import sentence, timeline

PANEL = (32, 44)  # columns of the panel, at least and at most
PANELLED = 9  # lines of facts below a plane from which they are a panel


@dataclass(frozen=True)
class Size:
    """How a frame is laid out: its view, whether it has a border, and the columns of its panel (0: none)."""

    view: View
    bordered: bool
    panel: int

    @staticmethod
    def within(width: int, height: int, points: np.ndarray, panel: bool = True) -> "Size":
        """The layout of a frame of `width` x `height` whose plane shows all `points` (n, 2)."""
        bordered = width >= 20 and height >= 8
        rows = max(height - 4 * bordered, 1)
        if not bordered:
            return Size(fit_view(points, rows, max(width, 1)), False, 0)
        tall = fit_view(points, rows, 1_000_000).row  # m a row if only the height counted
        span = np.ptp(points[np.isfinite(points).all(-1)], axis=0)[0] if len(points) else 0.0
        wanted = max(int(np.ceil(2 * (span + 0.3) / tall)), 2 * rows)  # columns
        columns, beside = width - 2, 0
        if panel and width >= 60 and height >= 16:
            beside = int(np.clip(width - 3 - 1.1 * wanted, *PANEL))
            columns = width - 3 - beside
        return Size(fit_view(points, rows, min(columns, int(1.3 * wanted))), True, beside)


@dataclass(frozen=True)
class Side:
    """One story at moment `t`, to be drawn on a plane that shows all `places` (n, 2) m."""

    story: Story
    t: int
    title: str
    places: np.ndarray
    trails: bool  # of people

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return float(self.story.time[self.t])

    @property
    def _timed_title(self) -> str:
        return f"{self.time:.2f} s · {self.title}"

    def with_panel(self, width: int, height: int) -> list[Text]:
        """The plane with the panel beside it, and the timeline below."""
        size = Size.within(width, height, self.places)
        lines = self._plane(size.view)
        if not size.bordered:
            return lines
        lines = bordered(lines, self.title if size.panel else self._timed_title, size.view)
        if size.panel:
            panel = panel_lines(self.story, self.t, len(lines), size.panel)
            lines = [Text.assemble(line, " ", beside) for line, beside in zip(lines, panel, strict=True)]
        return lines + self._times(lines[0].cell_len, width)

    def above_facts(self, width: int, height: int, facts: int) -> list[Text]:
        """The plane as wide as it can be, facts below it in the lines that it leaves, and the timeline.

        There are at least so many lines of `facts` where there are enough for the plane.
        """
        span = np.ptp(self.places[np.isfinite(self.places).all(-1)], axis=0)[1]
        needed = span / fit_view(self.places, 1_000_000, max(width - 2, 1)).row  # rows of the plane
        most = max(height - 12, 0)
        below = int(np.clip(height - 5 - needed, min(facts, most), most))
        size = Size.within(width, height - below, self.places, panel=False)
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


def joined(lines: list[Text], width: int, height: int, ascii_only: bool) -> Text:
    """Lines as one text, cut to the size."""
    text = Text("\n", no_wrap=True, overflow="crop").join(
        fitted(line, min(width, line.cell_len)) for line in lines[:height]
    )
    return to_ascii(text) if ascii_only else text
