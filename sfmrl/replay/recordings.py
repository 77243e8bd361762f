"""Write frames as SVG or as an asciinema recording (asciicast v2). Pure: frames in, the text of a file out.

The same frames give the same file: it holds no date and nothing of the terminal or the environment.
"""

import io
import json
from collections.abc import Sequence

from rich.console import Console
from rich.text import Text

from sfmrl.replay.frames import Frame

LAST_FRAME_SECONDS = 2.0  # s for which a recording shows its last frame
# Rich's template, but with fonts that readers have instead of one to download. At this size, block characters of the
# first font fill Rich's lines of 24.4 px; the width of a column follows from the font's aspect ratio.
FONT_SIZE, FONT_ASPECT = 20.95, 0.6305
SVG = """\
<svg viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>
.{unique_id}-matrix {{ font: FONT_SIZEpx "DejaVu Sans Mono", Menlo, Consolas, monospace }}
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
""".replace("FONT_SIZE", f"{FONT_SIZE}")


def to_svg(frames: Sequence[Frame], title: str, colour: bool = True) -> str:
    """The frames as one picture, one below the other."""
    console = _console(_columns(frames), record=True)
    for k, frame in enumerate(frames):
        if k:
            console.line()
        console.print(frame.text if colour else Text(frame.plain), crop=False)
    return console.export_svg(title=title, code_format=SVG, font_aspect_ratio=FONT_ASPECT)


def to_cast(frames: Sequence[Frame], title: str, speed: float = 1.0, colour: bool = True) -> str:
    """The frames as a recording that plays them at `speed` times real time; each is drawn whole on an empty screen."""
    columns, rows = _columns(frames), max(frame.text.plain.count("\n") + 1 for frame in frames)
    console = _console(columns)
    lines: list[dict | list] = [{"version": 2, "width": columns, "height": rows, "title": title}]
    for frame in frames:
        with console.capture() as drawn:
            console.print(frame.text if colour else Text(frame.plain), end="")
        clear = "\x1b[?25l\x1b[2J\x1b[1;1H"  # hides the cursor, empties the screen, goes to its upper left corner
        lines.append([frame.time / speed, "o", clear + drawn.get().replace("\n", "\r\n")])
    lines.append([frames[-1].time / speed + LAST_FRAME_SECONDS, "o", f"\x1b[{rows};1H\x1b[?25h"])
    ascii_only = all(frame.plain.isascii() for frame in frames)
    return "".join(json.dumps(line, ensure_ascii=ascii_only) + "\n" for line in lines)


def _console(columns: int, record: bool = False) -> Console:
    """A console that keeps its output in memory and reads no environment variables."""
    return Console(
        file=io.StringIO(),
        width=columns,
        force_terminal=True,
        color_system="256",
        legacy_windows=False,
        _environ={},
        record=record,
    )


def _columns(frames: Sequence[Frame]) -> int:
    return max(len(line) for frame in frames for line in frame.text.plain.split("\n"))
