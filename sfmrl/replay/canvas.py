"""Draw on a grid of characters in metres, with braille dots and quarter blocks for details finer than a cell.

A cell is twice as high as it is wide, as in most terminals, so circles look round. A cell holds 2 x 4 braille dots or
2 x 2 quarter blocks. All glyphs are Unicode, one column wide; `to_ascii` replaces each by a 7-bit character.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from rich.cells import cell_len
from rich.text import Text


class Style:
    """Rich styles, by what they show."""

    ROBOT, PERSON, SQUARE, GOAL, FORCE = "bold cyan", "bold", "grey50", "bold green", "bold color(208)"
    MOST_ATTENTION = "bold magenta"
    DANGER = "bold red"  # a collision, or too close
    DELAY = "bold yellow"  # a time-out, or a stuck robot
    DIM = "dim"  # labels and background


VELOCITY_ARROWS = "→↗↑↖←↙↓↘"  # counter-clockwise from the x axis, 45 degrees apart
FORCE_ARROWS = "⇒⇗⇑⇖⇐⇙⇓⇘"
NEIGHBOURS = np.array([(0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1)])  # (row, column), likewise
QUARTERS = " ▘▝▀▖▌▞▛▗▚▐▜▄▙▟█"  # by the sum of 1 (upper left), 2 (upper right), 4 (lower left), 8 (lower right)
BRAILLE = 0x2800  # the empty braille cell; a dot's bit by its row and column:
DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
MARGIN = 0.15  # m around all points of a view

_ASCII = str.maketrans(
    dict(zip(VELOCITY_ARROWS + FORCE_ARROWS, ">/^\\</v\\" * 2, strict=True))
    | {glyph: "#" if k.bit_count() > 1 else " " for k, glyph in enumerate(QUARTERS)}
    | {chr(BRAILLE + k): "." for k in range(1, 256)}
    | dict(zip("▉▊▋▍▎▏░▒▓─│╭╮╰╯├┤━●★·…²■", "###   .:+-|++++||=o*.~2#", strict=True))
)


@dataclass(frozen=True)
class View:
    """The part of the plane that `rows` x `columns` cells show: its upper left corner and the height of a row, in m."""

    left: float
    top: float
    row: float
    rows: int
    columns: int

    def cells(self, points: np.ndarray, down: int = 1, across: int = 1) -> np.ndarray:
        """Row and column of points (..., 2) in m when each cell is cut into `down` x `across`: (..., 2) integers."""
        row = (self.top - points[..., 1]) * (down / self.row)
        column = (points[..., 0] - self.left) * (2 * across / self.row)
        outside = -9.0  # for NaN: not in the view, nor is a neighbour
        return np.floor(np.nan_to_num(np.stack((row, column), -1), nan=outside)).astype(int)


def row_height(points: np.ndarray, rows: float = np.inf, columns: float = np.inf) -> float:
    """The least height of a row, at least 0.1 m, with which `rows` x `columns` cells show `points` (n, 2) in m."""
    width, height = span(points) + 2 * MARGIN
    return max(height / rows, 2 * width / columns, 0.1) * (1 + 1e-9)


def span(points: np.ndarray) -> np.ndarray:
    """Width and height (2,) of what points (n, 2) cover; NaN is ignored."""
    return np.nanmax(points, axis=0) - np.nanmin(points, axis=0)


def fit_view(points: np.ndarray, rows: int, columns: int) -> View:
    """The centred view that shows `points` (n, 2) in m at the largest possible scale; NaN is ignored."""
    row = row_height(points, rows, columns)
    x, y = (np.nanmax(points, axis=0) + np.nanmin(points, axis=0)) / 2
    return View(x - row * columns / 4, y + row * rows / 2, row, rows, columns)


class Canvas:
    """A grid of glyphs and their styles; coordinates are in m, and nothing is drawn outside the view or at NaN."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.glyphs = np.full((view.rows, view.columns), " ")
        self.styles = np.full((view.rows, view.columns), "", dtype=object)

    def put(self, point: np.ndarray, glyph: str, style: str = "", step: np.ndarray | tuple = (0, 0)) -> None:
        """Draw one glyph at a point (2,), or `step` = (rows, columns) away from its cell."""
        cell = tuple(self.view.cells(point) + step)
        if self._inside(*cell):
            self.glyphs[cell], self.styles[cell] = glyph, style

    def dots(self, points: np.ndarray, style: str = "") -> None:
        """Draw a braille dot at each point (n, 2), except in cells that hold a glyph of another kind."""
        for row, column in self.view.cells(points, 4, 2):
            cell = row // 4, column // 2
            if self._inside(*cell):
                code = BRAILLE if self.glyphs[cell] == " " else ord(self.glyphs[cell])
                if code & ~0xFF == BRAILLE:
                    self.glyphs[cell], self.styles[cell] = chr(code | DOTS[row % 4, column % 2]), style

    def squares(self, centres: np.ndarray, halves: np.ndarray, style: str = "") -> None:
        """Draw solid squares about `centres` (n, 2) with half sides `halves` (n,); squares that touch join."""
        view = self.view
        x = view.left + (np.arange(2 * view.columns) + 0.5) * view.row / 4
        y = view.top - (np.arange(2 * view.rows) + 0.5) * view.row / 2
        within_x = np.abs(x - centres[:, :1]) <= halves[:, None] + 1e-9  # (n, 2 columns)
        within_y = np.abs(y - centres[:, 1:]) <= halves[:, None] + 1e-9  # (n, 2 rows)
        solid = (within_y[:, :, None] & within_x[:, None, :]).any(0)  # (2 rows, 2 columns)
        code = solid[::2, ::2] + 2 * solid[::2, 1::2] + 4 * solid[1::2, ::2] + 8 * solid[1::2, 1::2]
        self.glyphs[code > 0] = np.array(list(QUARTERS))[code[code > 0]]
        self.styles[code > 0] = style

    def lines(self) -> list[Text]:
        """The rows as texts."""
        return [styled(zip(*row, strict=True)) for row in zip(self.glyphs, self.styles, strict=True)]

    def _inside(self, row: int, column: int) -> bool:
        return 0 <= row < self.view.rows and 0 <= column < self.view.columns


def octant(vector: np.ndarray) -> int:
    """Index of the nearest of eight arrows to a vector (2,)."""
    return int(np.round(np.arctan2(vector[1], vector[0]) / (np.pi / 4))) % 8


def styled(pieces: Iterable[tuple[str, str]]) -> Text:
    """One text from (glyphs, style) pairs; neighbours of the same style are joined, which is faster to print."""
    runs = groupby(pieces, key=lambda piece: piece[1])
    return Text.assemble(*(("".join(glyphs for glyphs, _ in run), style) for style, run in runs), no_wrap=True)


def fitted(text: Text, width: int, right: Text | None = None) -> Text:
    """`text` cut or padded to `width` columns, with `right` at its right edge if there is room."""
    if right is not None and text.cell_len + right.cell_len < width:
        text = Text.assemble(text, " " * (width - text.cell_len - right.cell_len), right)
    text = text.copy()
    text.truncate(width, overflow="crop", pad=True)
    return text


def first_fitting(wordings: Sequence[str], width: int) -> str:
    """The first of the wordings that fits into `width` columns, or the last one if none does."""
    return next((words for words in wordings if cell_len(words) <= width), wordings[-1])


def shortened(words: str, gap: str = " · ") -> list[str]:
    """`words`, then `words` without its last part, its last two parts, and so on; `gap` separates the parts."""
    parts = words.split(gap)
    return [gap.join(parts[:count]) for count in range(len(parts), 0, -1)]


def to_ascii(text: Text) -> Text:
    """`text` in 7-bit characters, glyph by glyph, with its styles."""
    plain = text.plain.translate(_ASCII).encode("ascii", "replace").decode("ascii")
    return Text(plain, spans=list(text.spans), no_wrap=True)
