"""Play pictures in a terminal in real time, with keys to pause, step and change the speed.

What a key does is a pure function of the player; the rest is Rich's live display and, where standard input is a
terminal on a system that has termios, one key at a time from it. The terminal is put back however the playing ends.
"""

import os
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from sfmrl.canvas import FAINT, fitted, to_ascii

SPEEDS = (0.01, 64.0)  # times real time, the slowest and the fastest
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


def play_live(frames: Sequence, console: Console, speed: float = 1.0, time_step: float = 0.25) -> None:
    """Play frames, each with a `text`, at `speed` times real time, a frame for every `time_step` seconds.

    The keys are told in a line below where the console has one to spare. With keys, the end waits for a last one;
    without, the playing ends there. Either way the frame shown last stays. A console that is no terminal gets the
    last frame alone.
    """
    if not console.is_terminal:
        console.print(frames[-1].text)
        return
    player: Player | None = Player(len(frames) - 1, playing=len(frames) > 1, speed=speed)
    shown = Text()
    with _keyboard() as read, Live(console=console, auto_refresh=False, vertical_overflow="crop") as live:
        try:
            due = time.monotonic()
            while player is not None and (player.playing or read):
                shown = frames[player.moment].text
                live.update(_with_legend(shown, player, console) if read else shown, refresh=True)
                now, step = time.monotonic(), time_step / player.speed
                due = min(max(due + step, now), now + step)  # drawing takes time too: no wait longer than needed
                player = _after_wait(player, due - now, read)
            shown = shown if player is None else frames[player.moment].text
        finally:
            live.update(shown, refresh=True)


def _after_wait(player: Player, seconds: float, read: Callable | None) -> Player | None:
    """The player one moment on after so many seconds, or after the keys that were pressed before."""
    if read is None:
        time.sleep(seconds)
        return player.step(1)
    keys = read(seconds if player.playing else None)
    if not keys:
        return player.step(1)
    for key in keys:
        player = None if player is None else player.press(key)
    return player


def _with_legend(picture: Text, player: Player, console: Console) -> Group | Text:
    """The picture and, where the console has a line left, what the keys do."""
    if picture.plain.count("\n") + 1 >= console.height:
        return picture
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
