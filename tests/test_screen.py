"""Playback in a terminal: what keys do, which pictures are drawn in which size, and a terminal left as it was."""

import io
import os
import re
import sys

import pytest
from rich.console import Console
from rich.text import Text

from sfmrl.replay.screen import Player, play_live

LAST = 8


def test_keys_pause_step_and_change_the_speed():
    player = Player(last=10).step(3)
    assert (player.moment, player.playing) == (3, True)
    assert not player.press(" ").playing
    assert player.press(" ").press(" ").playing
    assert (player.press(",").moment, player.press(".").moment) == (2, 4)
    assert (player.press("\x1b[D").moment, player.press("\x1b[C").moment) == (2, 4)
    assert (player.press("\x1bOD").moment, player.press("\x1bOC").moment) == (2, 4)  # as some programs leave them
    assert not player.press(".").playing
    assert (player.press("+").speed, player.press("-").speed) == (2.0, 0.5)
    assert player.press("x") == player
    assert player.press("q") is None
    assert Player(last=10).press(",").moment == 0
    end = player.step(99)
    assert (end.moment, end.playing) == (10, False)
    assert (end.press(" ").moment, end.press(" ").playing) == (0, True)


def test_any_key_closes_the_legend_and_does_nothing_else():
    player = Player(last=10).step(3)
    assert player.press("?").legend
    for key in "?q x.":
        assert player.press("?").press(key) == player


@pytest.fixture
def keyboard(monkeypatch):
    """Standard input as a terminal: a function that types, one that returns the terminal's settings."""
    pty, termios = pytest.importorskip("pty"), pytest.importorskip("termios")
    ours, theirs = pty.openpty()
    with os.fdopen(theirs) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield lambda keys: os.write(ours, keys), lambda: termios.tcgetattr(theirs)
    os.close(ours)


def screen():
    return Console(
        file=io.StringIO(), force_terminal=True, width=80, height=25, color_system=None, legacy_windows=False
    )


def picture(moment, width, height):
    """A picture that fills its size and names its moment."""
    return Text("\n".join([f"moment {moment}."[:width], *["=" * width] * (height - 1)]))


def playing_and_left(console):
    """What was written on the alternate screen, and after that on the normal one."""
    playing, left = console.file.getvalue().split("\x1b[?1049l")
    assert "\x1b[?25h" in playing[-20:]  # the cursor is back
    return playing, left.rstrip()


def test_every_moment_is_shown_and_the_last_one_left(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    console = screen()
    play_live(picture, LAST, console, speed=50.0)
    playing, left = playing_and_left(console)
    assert all(f"moment {t}." in playing for t in range(LAST))
    assert "q quit" not in playing
    assert left == picture(LAST, 80, 24).plain


def test_keys_are_obeyed_and_the_terminal_put_back(keyboard):
    type_keys, terminal = keyboard
    before, console, seen = terminal(), screen(), []
    # Pause, two on, function keys that do nothing, one back, faster, slower, quit.
    keys = [b" ", b".", b"\x1b[C", b"\x1bOP", b"\x1b[15~", b",", b"++", b"-", b"q"]

    def draw(moment, width, height):
        seen.append(moment)
        if keys:
            assert terminal() != before  # single keys, no echo
            type_keys(keys.pop(0))
        return picture(moment, width, height)

    play_live(draw, LAST, console, speed=0.01)
    assert seen == [0, 0, 1, 2, 2, 2, 1, 1, 1, 1]
    playing, left = playing_and_left(console)
    assert "q quit" in playing
    assert "paused x0.04" in playing
    assert "paused x0.02" in playing
    assert "q quit" not in left
    assert terminal() == before


@pytest.mark.parametrize("size", [(80, 25), (40, 20)])
@pytest.mark.parametrize("ascii_only", [False, True])
def test_the_legend_explains_symbols_and_keys_over_the_frame_while_time_stands_still(keyboard, size, ascii_only):
    type_keys, _ = keyboard
    console, seen, keys = screen(), [], [b"?", b"?", b" ", b"q"]
    console.size = size

    def draw(moment, width, height):
        seen.append(moment)
        if keys:
            type_keys(keys.pop(0))
        return Text(picture(moment, width, height).plain.replace("=", "=" if ascii_only else "═"))

    play_live(draw, LAST, console, speed=0.01)
    assert seen == [0] * 5
    shown = console.file.getvalue()
    (legend,) = (part for part in shown.split("\x1b[H") if "any key closes the legend" in part)
    assert legend.isascii() == ascii_only
    for words in ("@       robot", "!       too close", "T       time is up", "space   pause", "q       quit"):
        assert words in legend
    assert "moment 0." not in legend
    assert ("==" in legend or "══" in legend) == (size == (80, 25))  # the frame beside it
    hints = [re.split(" {2,}", line.strip()) for line in re.findall(r" \? legend[^\x1b\n]*", shown)]
    assert [line[-1] for line in hints] == ["x0.01", "x0.01", "paused x0.01"]
    keys = ["? legend", "q quit", "space pause", ", . step", "+ - speed"]
    assert [line[:-1] for line in hints] == ([keys] * 3 if size == (80, 25) else [keys[:3], keys[:3], keys[:2]])


def test_the_terminal_is_put_back_after_an_interruption(keyboard):
    _, terminal = keyboard
    before, console = terminal(), screen()

    def draw(moment, width, height):
        if moment == 2 and terminal() != before:
            raise KeyboardInterrupt
        return picture(moment, width, height)

    with pytest.raises(KeyboardInterrupt):
        play_live(draw, LAST, console, speed=100.0)
    assert terminal() == before
    assert playing_and_left(console)[1].startswith("moment 2.")


@pytest.mark.parametrize("paused", [False, True])
def test_a_resized_terminal_is_drawn_anew(keyboard, paused):
    type_keys, _ = keyboard
    console, sizes = screen(), []
    new = iter([(120, 40), (61, 20), (9, 3), (200, 50)])

    def draw(moment, width, height):
        sizes.append((width, height))
        if len(sizes) == 1 and paused:
            type_keys(b" ")
        elif (size := next(new, None)) is not None:
            console.size = size
        elif len(sizes) < 9:
            type_keys(b"q")
        return picture(moment, width, height)

    play_live(draw, LAST, console, speed=0.01)
    assert list(dict.fromkeys(sizes)) == [(80, 24), (120, 39), (61, 19), (9, 2), (200, 49)]
    assert playing_and_left(console)[1] == picture(0, 200, 49).plain
