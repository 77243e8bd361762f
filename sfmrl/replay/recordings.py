"""A replay as a file: SVG, or an asciinema recording (asciicast v2). Pure: frames in, a file's text out.

The same frames make the same file: no date, no terminal and no environment enters it.
"""

import io
import json
from collections.abc import Sequence

from rich.console import Console
from rich.text import Text

from sfmrl.replay.frames import Frame

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


def to_svg(frames: Sequence[Frame], title: str, colour: bool = True) -> str:
    """The frames one below the other as one picture."""
    console = _console(_columns(frames), record=True)
    for k, frame in enumerate(frames):
        if k:
            console.line()
        console.print(frame.text if colour else Text(frame.plain), crop=False)
    return console.export_svg(title=title, code_format=SVG, font_aspect_ratio=ASPECT)


def to_cast(frames: Sequence[Frame], title: str, speed: float = 1.0, colour: bool = True) -> str:
    """The frames in time, `speed` times as fast as it was, each drawn whole."""
    columns, rows = _columns(frames), max(frame.text.plain.count("\n") + 1 for frame in frames)
    console = _console(columns)
    lines: list[dict | list] = [{"version": 2, "width": columns, "height": rows, "title": title}]
    for frame in frames:
        with console.capture() as drawn:
            console.print(frame.text if colour else Text(frame.plain), end="")
        cleared = "\x1b[?25l\x1b[2J\x1b[1;1H"  # no cursor, an empty screen
        lines.append([frame.time / speed, "o", cleared + drawn.get().replace("\n", "\r\n")])
    lines.append([frames[-1].time / speed + HOLD, "o", f"\x1b[{rows};1H\x1b[?25h"])
    ascii_only = all(frame.plain.isascii() for frame in frames)
    return "".join(json.dumps(line, ensure_ascii=ascii_only) + "\n" for line in lines)


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
