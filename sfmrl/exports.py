"""A replay as a file: SVG, an asciinema recording (asciicast v2), plain text. Pure: frames in, a file's text out.

The same frames make the same file: no date, no terminal and no environment enters it.
"""

import io
import json
from collections.abc import Sequence
from itertools import groupby, zip_longest

from rich.color import ColorSystem
from rich.console import Console
from rich.style import Style
from rich.text import Text

from sfmrl.replay import Frame

Cell = tuple[str, Style]
NEAR = 6  # cells: changes in a line that are no farther apart are written in one go
HOLD = 2.0  # s that a recording shows its last frame
# Rich's own, without the typeface that it would fetch: fonts that a reader has, in the size at which the first one's
# blocks fill Rich's lines of 24.4 px, and its columns by that font's aspect.
FONT, ASPECT = 20.95, 0.6305
SVG = """\
<svg viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>
.{unique_id}-matrix {{ font: FONTpx "DejaVu Sans Mono", Menlo, Consolas, monospace }}
.{unique_id}-title {{ font: bold 18px sans-serif }}
{styles}
</style>
<defs>
<clipPath id="{unique_id}-clip-terminal"><rect width="{terminal_width}" height="{terminal_height}"/></clipPath>
{lines}
</defs>
{chrome}
<g transform="translate({terminal_x}, {terminal_y})" clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}
<g class="{unique_id}-matrix">{matrix}</g>
</g>
</svg>
""".replace("FONT", f"{FONT}")


def to_txt(frames: Sequence[Frame]) -> str:
    """The frames one below the other, an empty line between them."""
    return "\n\n".join(frame.plain for frame in frames) + "\n"


def to_svg(frames: Sequence[Frame], title: str, colour: bool = True) -> str:
    """The frames one below the other as one picture."""
    console = _console(_columns(frames), record=True)
    for k, frame in enumerate(frames):
        if k:
            console.line()
        console.print(frame.text if colour else Text(frame.plain), crop=False)
    return console.export_svg(title=title, code_format=SVG, font_aspect_ratio=ASPECT)


def to_cast(frames: Sequence[Frame], title: str, speed: float = 1.0, colour: bool = True) -> str:
    """The frames in time, `speed` times as fast as it was: after the first, what has changed from one to the next."""
    columns, rows = _columns(frames), max(frame.text.plain.count("\n") + 1 for frame in frames)
    ascii_only = all(frame.plain.isascii() for frame in frames)
    lines = [json.dumps({"version": 2, "width": columns, "height": rows, "title": title}, ensure_ascii=ascii_only)]
    before: list[list[Cell]] = []
    for frame in frames:
        now = _cells(frame, columns, colour)
        start = "" if before else "\x1b[?25l\x1b[2J"  # no cursor, an empty screen
        empty = [(" ", Style.null())] * columns
        drawn = [_changes(k, *pair) for k, pair in enumerate(zip_longest(before, now, fillvalue=empty), 1)]
        lines.append(_event(frame.time / speed, start + "".join(drawn), ascii_only))
        before = now
    lines.append(_event(frames[-1].time / speed + HOLD, f"\x1b[{rows};1H\x1b[?25h", ascii_only))
    return "\n".join(lines) + "\n"


def _event(seconds: float, output: str, ascii_only: bool) -> str:
    return json.dumps([round(seconds, 6), "o", output], ensure_ascii=ascii_only)


def _cells(frame: Frame, columns: int, colour: bool) -> list[list[Cell]]:
    """A frame's rows of `columns` cells; without colour, of their styles only bold, dim and the like are left."""
    console = _console(columns)
    rows = []
    for line in console.render_lines(frame.text, console.options):
        pairs = [(text, style or Style.null()) for text, style, _ in line]
        rows.append([(glyph, style if colour else style.without_color) for text, style in pairs for glyph in text])
    return rows


def _changes(row: int, before: list[Cell], now: list[Cell]) -> str:
    """What a terminal with 256 colours must get to show a row as it is `now`: runs of cells, each put in its place."""
    runs: list[list[int]] = []
    for k in (k for k, cell in enumerate(now) if before[k] != cell):
        if runs and k - runs[-1][-1] <= NEAR:
            runs[-1] += range(runs[-1][-1] + 1, k + 1)
        else:
            runs.append([k])
    text = ""
    for run in runs:
        text += f"\x1b[{row};{run[0] + 1}H"
        for style, cells in groupby((now[k] for k in run), key=lambda cell: cell[1]):
            text += style.render("".join(glyph for glyph, _ in cells), color_system=ColorSystem.EIGHT_BIT)
    return text


def _console(columns: int, **extra) -> Console:
    """A console that writes nowhere, and that no environment changes."""
    return Console(
        file=io.StringIO(),
        width=columns,
        force_terminal=True,
        color_system="256",
        legacy_windows=False,
        highlight=False,
        _environ={},
        **extra,
    )


def _columns(frames: Sequence[Frame]) -> int:
    return max(len(line) for frame in frames for line in frame.text.plain.split("\n"))
