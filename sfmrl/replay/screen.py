"""Play pictures in a terminal in real time, with keys to pause, step and change the speed.

What a key does is a pure function of the player; the rest is Rich's live display on the terminal's second screen and,
where standard input is a terminal on a system that has termios, one key at a time from it. A terminal that changes its
size is drawn on anew. The terminal is restored however playback ends, by a key or by a signal.
"""

import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from sfmrl.replay.canvas import FAINT, fitted, to_ascii

SPEEDS = (0.01, 64.0)  # times real time, the slowest and the fastest
GLANCE = 0.2  # s, the longest time without a look at the terminal's size
STEPS = {",": -1, "\x1b[D": -1, ".": 1, "\x1b[C": 1}  # comma and full stop, or the arrow keys
LEGEND = " space pause   , . step   + - speed   q quit"


@dataclass(frozen=True)
class Player:
    """Which of the moments 0 to `last` is shown, whether time goes on, and how fast, in times real time."""

    last: int
    moment: int = 0
    playing: bool = True
    speed: float = 1.0

    @property
    def status(self) -> str:
        """What the player is doing, in words."""
        doing = "" if self.playing else "the end   " if self.moment == self.last else "paused   "
        return f"{doing}x{self.speed:g} "

    def step(self, by: int) -> "Player":
        """The player `by` moments on, within the episode; it stops at the end."""
        moment = min(max(self.moment + by, 0), self.last)
        return replace(self, moment=moment, playing=self.playing and moment < self.last)

    def press(self, key: str) -> "Player | None":
        """The player after a key; None where it is a key that ends the playing. Space at the end starts again."""
        if key in ("q", "Q", "\x1b", "\x04"):
            return None
        if key == " ":
            again = self.moment == self.last
            return replace(self, moment=0 if again else self.moment, playing=again or not self.playing)
        if key in STEPS:
            return replace(self, playing=False).step(STEPS[key])
        if key in ("+", "=", "-"):
            speed = self.speed / 2 if key == "-" else self.speed * 2
            return replace(self, speed=min(max(speed, SPEEDS[0]), SPEEDS[1]))
        return self


def play_live(
    draw: Callable[[int, int, int], Text], last: int, console: Console, speed: float = 1.0, time_step: float = 0.25
) -> None:
    """Play the moments 0 to `last` at `speed` times real time, one for every `time_step` seconds.

    `draw` makes a moment's picture of at most so many columns and lines. The keys are told in a line below. With keys,
    the end waits for a last one; without, the playing ends there. Either way the moment shown last stays. A console
    that is no terminal gets the last one alone.
    """
    if not console.is_terminal:
        console.print(draw(last, console.width, console.height - 1))
        return
    player: Player | None = Player(last, playing=last > 0, speed=speed)
    shown = 0

    def picture() -> Text:
        return draw(shown, console.width, max(console.height - 1, 1))

    try:
        with _keyboard() as read, Live(console=console, auto_refresh=False, screen=True) as live:
            due = time.monotonic()
            while player is not None and (player.playing or read):
                shown, size = player.moment, console.size
                live.update(_with_legend(picture(), player, console) if read else picture(), refresh=True)
                now, step = time.monotonic(), time_step / player.speed
                due = min(max(due + step, now), now + step)  # drawing takes time too: no wait longer than needed
                player = _after_wait(player, due, read, lambda size=size: console.size == size)
            shown = shown if player is None else player.moment
    finally:
        console.print(picture())


def _after_wait(player: Player, due: float, read: Callable | None, unchanged: Callable[[], bool]) -> Player | None:
    """The player one moment on at the time `due`, or after the keys that were pressed before.

    As it is as soon as the terminal is not `unchanged`: then the same moment is due to be drawn again.
    """
    while unchanged():
        left = due - time.monotonic() if player.playing else GLANCE
        if left <= 0:
            return player.step(1)
        if read is None:
            time.sleep(min(left, GLANCE))
        elif keys := read(min(left, GLANCE)):
            for key in keys:
                player = None if player is None else player.press(key)
            return player
    return player


def _with_legend(picture: Text, player: Player, console: Console) -> Group:
    """The picture, and what the keys do."""
    legend = fitted(Text(LEGEND, FAINT), console.width, Text(player.status, FAINT))
    return Group(picture, to_ascii(legend) if picture.plain.isascii() else legend)


@contextmanager
def _keyboard() -> Iterator[Callable[[float | None], list[str]] | None]:
    """A function that waits for keys at most so many seconds (None: as long as it takes); None without a keyboard."""
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

    def read(seconds: float | None) -> list[str]:
        if not select.select([terminal], [], [], seconds)[0]:
            return []
        pressed = os.read(terminal, 64).decode(errors="ignore")
        return re.findall(r"\x1b\[.|.", pressed, re.DOTALL) or ["q"]  # nothing to read: the terminal has gone

    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        yield read
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
