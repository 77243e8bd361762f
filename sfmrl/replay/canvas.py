"""Draw on a grid of characters in metres, with braille dots and quarter blocks for what is finer than a cell.

A cell is twice as high as it is wide, as in most terminals, so circles look round. A cell holds 2 x 4 braille dots or
2 x 2 quarter blocks. All glyphs are Unicode, one column wide; `to_ascii` replaces each by one of seven bits.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from rich.cells import cell_len
from rich.text import Text

# Styles, by what they show.
ROBOT, PERSON, SQUARE, GOAL, FORCE = "bold cyan", "bold", "grey50", "bold green", "bold color(208)"
MOST_ATTENTION = "bold magenta"
DANGER = "bold red"  # a collision, or too close
DELAY = "bold yellow"  # a time-out, or a stuck robot
DIM = "dim"  # labels, and what is only background

VELOCITY_ARROWS = "→↗↑↖←↙↓↘"  # counter-clockwise from the x axis, 45 degrees apart
FORCE_ARROWS = "⇒⇗⇑⇖⇐⇙⇓⇘"
NEIGHBOURS = np.array([(0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1)])  # (row, column), likewise
QUARTERS = " ▘▝▀▖▌▞▛▗▚▐▜▄▙▟█"  # by the sum of 1 (upper left), 2 (upper right), 4 (lower left), 8 (lower right)
BRAILLE = 0x2800  # the empty braille cell; a dot's bit by its row and column:
DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])

_ASCII = str.maketrans(
    dict(zip(VELOCITY_ARROWS + FORCE_ARROWS, ">/^\\</v\\" * 2, strict=True))
    | {glyph: "#" if bin(k).count("1") > 1 else " " for k, glyph in enumerate(QUARTERS)}
    | {chr(BRAILLE + k): "." for k in range(1, 256)}
    | dict(zip("▉▊▋▍▎▏░▒▓", "###   .:+", strict=True))
    | dict(zip("─│╭╮╰╯├┤━●", "-|++++||=o", strict=True))
    | dict(zip("★·…²■", "*.~2#", strict=True))
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
        return np.floor(np.stack((row, column), -1)).astype(int)


def fit_view(points: np.ndarray, rows: int, columns: int, margin: float = 0.15) -> View:
    """The centred view that shows `points` (n, 2) and a `margin` around them, in m, at the largest possible scale.

    Points that are NaN or infinite are ignored; a row is at least 0.1 m high.
    """
    points = points[np.isfinite(points).all(-1)]
    low, high = (points.min(0) - margin, points.max(0) + margin) if len(points) else (np.zeros(2), np.zeros(2))
    span = high - low
    row = max(span[1] / rows, 2 * span[0] / columns, 0.1) * (1 + 1e-9)
    middle = (low + high) / 2
    return View(middle[0] - row * columns / 4, middle[1] + row * rows / 2, row, rows, columns)


class Canvas:
    """A grid of glyphs and their styles; coordinates are in metres, and what lies outside the view is not drawn."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.glyphs = np.full((view.rows, view.columns), " ")
        self.styles = np.full((view.rows, view.columns), "", dtype=object)

    def put(self, point: np.ndarray, glyph: str, style: str = "", step: np.ndarray | tuple = (0, 0)) -> None:
        """Draw one glyph at a point (2,), or `step` = (rows, columns) away from its cell."""
        if np.isfinite(point).all():
            self._set(*(self.view.cells(point) + step), glyph, style)

    def dots(self, points: np.ndarray, style: str = "") -> None:
        """Draw a braille dot at each point (n, 2), except in cells that hold a glyph of another kind."""
        for row, column in self.view.cells(points[np.isfinite(points).all(-1)], 4, 2):
            r, c = row // 4, column // 2
            if self._inside(r, c) and (self.glyphs[r, c] == " " or ord(self.glyphs[r, c]) & ~0xFF == BRAILLE):
                bits = ord(self.glyphs[r, c]) & 0xFF if self.glyphs[r, c] != " " else 0
                self._set(r, c, chr(BRAILLE | bits | DOTS[row % 4, column % 2]), style)

    def squares(self, centres: np.ndarray, halves: np.ndarray, style: str = "") -> None:
        """Draw solid squares about `centres` (n, 2) with half sides `halves` (n,); squares that touch join."""
        view = self.view
        x = view.left + (np.arange(2 * view.columns) + 0.5) * view.row / 4
        y = view.top - (np.arange(2 * view.rows) + 0.5) * view.row / 2
        within_x = np.abs(x - centres[:, :1]) <= halves[:, None] + 1e-9  # (n, 2 columns)
        within_y = np.abs(y - centres[:, 1:]) <= halves[:, None] + 1e-9  # (n, 2 rows)
        solid = (within_y[:, :, None] & within_x[:, None, :]).any(0)  # (2 rows, 2 columns)
        code = solid[::2, ::2] + 2 * solid[::2, 1::2] + 4 * solid[1::2, ::2] + 8 * solid[1::2, 1::2]
        for row, column in zip(*np.nonzero(code), strict=True):
            self._set(row, column, QUARTERS[code[row, column]], style)

    def lines(self) -> list[Text]:
        """The rows as texts."""
        return [styled(zip(*row, strict=True)) for row in zip(self.glyphs, self.styles, strict=True)]

    def _inside(self, row: int, column: int) -> bool:
        return 0 <= row < self.view.rows and 0 <= column < self.view.columns

    def _set(self, row: int, column: int, glyph: str, style: str) -> None:
        if self._inside(row, column):
            self.glyphs[row, column], self.styles[row, column] = glyph, style


def octant(vector: np.ndarray) -> int:
    """Index of the one of eight arrows that is nearest to a vector (2,)."""
    return int(np.round(np.arctan2(vector[1], vector[0]) / (np.pi / 4))) % 8


def styled(pieces: Iterable[tuple[str, str]]) -> Text:
    """One text from (glyphs, style) pairs; neighbours of the same style are joined."""
    text, run, last = Text(no_wrap=True), "", ""
    for glyphs, style in pieces:
        if style != last:
            text.append(run, last)
            run, last = "", style
        run += glyphs
    return text.append(run, last)


def fitted(text: Text, width: int, right: Text | None = None) -> Text:
    """`text` cut or padded to `width` columns, with `right` at its right edge if there is room."""
    if right is not None and text.cell_len + right.cell_len < width:
        text = Text.assemble(text, " " * (width - text.cell_len - right.cell_len), right)
    text = text.copy()
    text.truncate(width, overflow="crop", pad=True)
    return text


def tidy(words: str) -> str:
    """`words` with "?" for each character that a terminal does not show in one column."""
    return "".join(c if c.isprintable() and cell_len(c) == 1 else "?" for c in words)


def to_ascii(text: Text) -> Text:
    """`text` in seven bits, glyph by glyph, with its styles."""
    plain = text.plain.translate(_ASCII).encode("ascii", "replace").decode("ascii")
    return Text(plain, spans=list(text.spans), no_wrap=True)
