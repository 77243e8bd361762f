"""Play pictures in a terminal in real time, with keys to pause, step and change the speed, and a legend over them.

The effect of a key is a pure function of the player. The display is Rich's, on the terminal's alternate screen; keys
are read one at a time if standard input is a terminal and the system has termios. A picture is drawn again when the
terminal is resized. The terminal is restored however playback ends, by a key or by a signal.
"""

import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import zip_longest

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from sfmrl.replay.canvas import Style, first_fitting, fitted, shortened, to_ascii
from sfmrl.replay.panel import SHADES

SPEEDS = (0.01, 64.0)  # times real time, the slowest and the fastest
LONGEST_WAIT = 0.2  # s between two checks whether the terminal was resized
# Comma and full stop, or the arrow keys, of which terminals send one form or the other.
STEP_KEYS = dict.fromkeys((",", "\x1b[D", "\x1bOD"), -1) | dict.fromkeys((".", "\x1b[C", "\x1bOC"), 1)
HINTS = "? legend  q quit  space pause  , . step  + - speed"  # the most important ones first
LEGEND_COLUMNS, SYMBOL_COLUMNS = 40, 8  # of the legend, and of the symbols in it
LEGEND = (
    ("@", Style.ROBOT, "robot, and where it was"),
    ("★", Style.GOAL, "robot's goal; goal reached"),
    ("1 2 a", Style.PERSON, "people, and where they were"),
    ("█", Style.SQUARE, "square, with its number"),
    ("→", "", "velocity"),
    ("⇒", Style.FORCE, "repulsion on the robot"),
    ("magenta", Style.MOST_ATTENTION, "gets the most attention"),
    (f"{SHADES} o", "", "values of actions; o is next"),
    ("━●─", "", "timeline; ● is now"),
    ("!", Style.DANGER, "too close to an element"),
    ("~", Style.DELAY, "stuck: led around squares"),
    ("X", Style.DANGER, "collision"),
    ("T", Style.DELAY, "time is up"),
    ("space", Style.PERSON, "pause, resume"),
    (", .", Style.PERSON, "one step back, ahead"),
    ("+ -", Style.PERSON, "faster, slower"),
    ("q", Style.PERSON, "quit"),
)


@dataclass(frozen=True)
class Player:
    """Which of the moments 0 to `last` is shown, whether it is playing, and how fast, in times real time.

    While the `legend` is shown, playback waits.
    """

    last: int
    moment: int = 0
    playing: bool = True
    speed: float = 1.0
    legend: bool = False

    @property
    def status(self) -> str:
        """State and speed in words."""
        state = "" if self.playing else "the end " if self.moment == self.last else "paused "
        return f"{state}x{self.speed:g}"

    def step(self, by: int) -> "Player":
        """The player `by` moments later, within the episode; it stops at the end."""
        moment = min(max(self.moment + by, 0), self.last)
        return replace(self, moment=moment, playing=self.playing and moment < self.last)

    def press(self, key: str) -> "Player | None":
        """The player after a key, None after a key that quits. Space at the end starts again."""
        if self.legend or key == "?":
            return replace(self, legend=not self.legend)  # any key closes it
        if key in ("q", "Q", "\x1b", "\x04"):
            return None
        if key == " ":
            again = self.moment == self.last
            return replace(self, moment=0 if again else self.moment, playing=again or not self.playing)
        if key in STEP_KEYS:
            return replace(self, playing=False).step(STEP_KEYS[key])
        if key in ("+", "=", "-"):
            speed = self.speed / 2 if key == "-" else self.speed * 2
            return replace(self, speed=min(max(speed, SPEEDS[0]), SPEEDS[1]))
        return self


def play_live(
    draw: Callable[[int, int, int], Text], last: int, console: Console, speed: float = 1.0, time_step: float = 0.25
) -> None:
    """Play the moments 0 to `last`, `time_step` seconds apart, at `speed` times real time in a terminal.

    `draw(moment, columns, lines)` returns a picture of at most that size. If there is a keyboard, a line below explains
    the keys, and playback waits at the end for one that quits. The moment shown last stays on the normal screen.
    """
    player: Player | None = Player(last, playing=last > 0, speed=speed)
    shown = 0

    def picture() -> Text:
        return draw(shown, console.width, max(console.height - 1, 1))

    try:
        with _keyboard() as read, Live(console=console, auto_refresh=False, screen=True) as live:
            due = time.monotonic()
            while player is not None and (player.playing or read):
                shown, size = player.moment, console.size
                live.update(_with_hints(picture(), player, console) if read else picture(), refresh=True)
                now, step = time.monotonic(), time_step / player.speed
                due = min(max(due + step, now), now + step)  # drawing takes time, too: wait only for the rest
                player = _after_wait(player, due, read, console, size)
            shown = shown if player is None else player.moment
    finally:
        console.print(picture())


def _after_wait(
    player: Player, due: float, read: Callable | None, console: Console, size: tuple[int, int]
) -> Player | None:
    """The player one moment later at the time `due`, or before that, after the keys that were pressed.

    It is returned as it is as soon as the terminal has another `size`, so that the same moment is drawn again.
    """
    while console.size == size:
        left = due - time.monotonic() if player.playing and not player.legend else LONGEST_WAIT
        if left <= 0:
            return player.step(1)
        if read is None:
            time.sleep(min(left, LONGEST_WAIT))
        elif keys := read(min(left, LONGEST_WAIT)):
            pressed: Player | None = player
            for key in keys:
                pressed = None if pressed is None else pressed.press(key)
            return pressed
    return player


def _with_hints(picture: Text, player: Player, console: Console) -> Group:
    """The picture, under the legend if that is shown, and a line that names as many keys as fit."""
    columns, ascii_only = console.width, picture.plain.isascii()
    status = Text(player.status, Style.DIM)
    words = first_fitting(shortened(HINTS, "  "), columns - status.cell_len - 2)
    if player.legend:
        picture, words = _with_legend(picture, columns, max(console.height - 1, 1)), "any key closes the legend"
    shown = picture, fitted(Text(f" {words}", Style.DIM), columns, status)
    return Group(*map(to_ascii, shown) if ascii_only else shown)


def _with_legend(picture: Text, columns: int, lines: int) -> Text:
    """The picture with the legend over its upper left corner, in at most `columns` x `lines`."""
    entries = [Text.assemble(fitted(Text(symbol, style), SYMBOL_COLUMNS), words) for symbol, style, words in LEGEND]
    box = [
        Text("╭─ legend ".ljust(LEGEND_COLUMNS - 1, "─") + "╮", Style.DIM),
        *(Text.assemble(("│ ", Style.DIM), fitted(entry, LEGEND_COLUMNS - 4), (" │", Style.DIM)) for entry in entries),
        Text("╰".ljust(LEGEND_COLUMNS - 1, "─") + "╯", Style.DIM),
    ]
    box = [fitted(line, min(columns, LEGEND_COLUMNS)) for line in box[:lines]]
    both = zip_longest(box, picture.split(allow_blank=True), fillvalue=Text())
    return Text("\n", no_wrap=True).join(Text.assemble(over, under[len(over) :]) for over, under in both)


@contextmanager
def _keyboard() -> Iterator[Callable[[float], list[str]] | None]:
    """A function that waits for keys, at most some seconds, and returns them; None without a keyboard."""
    try:
        import select
        import termios
        import tty
    except ImportError:  # Windows
        yield None
        return
    if sys.stdin is None or not sys.stdin.isatty():
        yield None
        return
    terminal = sys.stdin.fileno()

    def read(seconds: float) -> list[str]:
        if not select.select([terminal], [], [], seconds)[0]:
            return []
        pressed = os.read(terminal, 64).decode(errors="ignore")
        keys = re.findall(r"\x1b\[[0-9;]*.|\x1bO.|.", pressed, re.DOTALL)
        return keys or ["q"]  # nothing to read: the terminal is gone

    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        yield read
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
