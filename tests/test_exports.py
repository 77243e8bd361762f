"""Two policies in one picture, and replays as files: what a player, a browser or a reader would find in them."""

import json
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from conftest import environment
from rich.cells import cell_len

from sfmrl.episodes import play
from sfmrl.replay.frames import BESIDE, STACKED, WHOLE, Replay
from sfmrl.replay.recordings import HOLD, to_cast, to_svg
from sfmrl.replay.story import tell
from sfmrl.scenes import sample_scenes

PLAIN = {"0", "1", "2", "7", "1;2", "1;7", "2;7"}  # bold, dim and reverse, but no colour
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def stories():
    """The same episode, as ORCA and a robot that goes straight play it: one of them ends before the other."""
    scenes = sample_scenes("2", [0])
    return {name: tell(play(scenes, name), 0) for name in ("orca", "linear")}


def replay(stories, *names, ascii_only=False):
    return Replay(tuple(stories[name] for name in names), names, ascii_only)


def on_a_terminal(output, columns, rows):
    """What a terminal shows after `output`, as lines, and whether its cursor is seen. It knows what a cast may use."""
    screen, row, column, cursor = [[" "] * columns for _ in range(rows)], 0, 0, True
    for code, glyph in re.findall(r"\x1b\[([?\d;]*[A-Za-z])|([^\x1b])", output):
        if glyph == "\r":
            column = 0
        elif glyph == "\n":
            row += 1
        elif glyph:
            assert glyph.isprintable()
            screen[row][column] = glyph  # an IndexError is a line that is too long
            column += 1
        elif code.endswith("H"):
            row, column = (int(number) - 1 for number in code[:-1].split(";"))
        elif code == "2J":
            screen = [[" "] * columns for _ in range(rows)]
        elif code in ("?25l", "?25h"):
            cursor = code == "?25h"
        else:
            assert re.fullmatch(r"[\d;]*m", code), code
    return ["".join(line).rstrip() for line in screen], cursor


def parsed(cast):
    header, *events = map(json.loads, cast.splitlines())
    return header, events


@pytest.mark.parametrize("size", [(80, 24), (61, 8), (120, 40), (200, 50), (60, 17), (20, 16), (161, 30), (7, 3)])
@pytest.mark.parametrize("ascii_only", [False, True])
def test_two_policies_fit_whatever_the_size(stories, size, ascii_only):
    width, height = size
    both = replay(stories, "orca", "linear", ascii_only=ascii_only)
    assert both.last == max(story.last for story in stories.values())
    for frame in both.frames(*size, 5):
        lines = frame.text.plain.split("\n")
        assert len(lines) <= height
        assert max(map(cell_len, lines)) <= width
        assert frame.plain.count("@") == 2
        assert frame.plain.isascii() == ascii_only or min(size) < 8
        if width >= BESIDE or height >= STACKED:
            assert "orca" in frame.plain
            assert "linea" in frame.plain
        if width >= BESIDE:
            assert {cell_len(line) for line in lines} == {2 * ((width - 1) // 2) + 1}
        if width >= WHOLE:
            assert frame.plain.count("reward of the step") == 2


def test_two_policies_are_in_step_and_who_has_ended_stays_as_it_ended(stories):
    first, second = sorted(stories, key=lambda name: stories[name].last)
    early, late = stories[first], stories[second]
    assert early.last < late.last
    both = replay(stories, first, second)
    for t, frame in enumerate(both.frames()):
        lines = frame.plain.split("\n")
        facts = next(line for line in lines if line.startswith("t "))
        assert re.findall(r"t +([\d.]+) s", facts) == [
            f"{early.time[min(t, early.last)]:.2f}",
            f"{late.time[t]:.2f}",
        ]
        assert frame.time == late.time[t]
        left = [line[:39] for line in lines]
        if t >= early.last:
            assert left == [line[:39] for line in both.frame(early.last).plain.split("\n")]
            assert {"success": "goal reached after", "collision": "collision at"}[early.outcome] in left[-1]
    swapped = replay(stories, second, first).frame(early.last)  # each side looks the same on the other one
    assert [line[40:].rstrip() for line in swapped.plain.split("\n")] == [line.rstrip() for line in left]


def test_both_planes_have_one_scale(stories):
    for width, height in ((80, 24), (120, 40), (200, 50)):
        frame = replay(stories, "orca", "linear").frame(0, width, height)
        lines = frame.text.plain.split("\n")
        half = (width - 1) // 2
        alike = [r for r, line in enumerate(lines) if line.startswith("│")][: height // 3]
        inside = lines[0].index("╮")
        assert [lines[r][: inside + 1] for r in alike] == [lines[r][half + 1 : half + inside + 2] for r in alike]
        assert len({line.split("├")[1].count("─") for line in re.findall("1 m ├─+┤", frame.plain)}) == 1


@pytest.mark.parametrize("ascii_only", [False, True])
@pytest.mark.parametrize(
    ("names", "size", "width"),
    [
        (("orca",), (80, 24), 80),
        (("orca", "linear"), (80, 24), 79),  # two halves and a column between them
        (("linear",), (40, 11), 38),  # as wide as its longest sentence
    ],
)
def test_a_cast_shows_every_frame_in_its_time(stories, names, size, width, ascii_only):
    shown, height = replay(stories, *names, ascii_only=ascii_only), size[1]
    frames = shown.frames(*size)[:30]
    cast = to_cast(frames, shown.title, speed=2.0)
    header, events = parsed(cast)
    assert header == {"version": 2, "width": width, "height": height, "title": shown.title}
    assert cast.isascii() == ascii_only
    assert [event[1] for event in events] == ["o"] * (len(frames) + 1)
    times = [event[0] for event in events]
    assert times[:-1] == [frame.time / 2 for frame in frames]
    assert times[-1] == times[-2] + HOLD
    output = ""
    for frame, event in zip(frames, events, strict=False):
        output += event[2]
        assert on_a_terminal(output, width, height) == (frame.plain.split("\n"), False)
    assert on_a_terminal(output + events[-1][2], width, height) == (frames[-1].plain.split("\n"), True)
    assert to_cast(shown.frames(*size)[:30], shown.title, speed=2.0) == cast


def test_a_cast_keeps_the_colours_and_leaves_them_out_where_none_are_wanted(stories):
    frames = replay(stories, "orca").frames()[:4]
    codes = {colour: set(re.findall(r"\x1b\[([\d;]*)m", "".join(json.loads(line)[2] for line in lines)))
             for colour in (False, True)
             for lines in [to_cast(frames, "", colour=colour).splitlines()[1:]]}  # fmt: skip
    assert "1;36" in codes[True]  # the robot, bold cyan
    assert codes[False] <= PLAIN


@pytest.mark.parametrize("names", [("orca",), ("orca", "linear")])
def test_an_svg_holds_the_frames_words_and_nothing_from_elsewhere(stories, names):
    shown = replay(stories, *names)
    frames = shown.frames(80, 24, 3)
    text = to_svg(frames, shown.title)
    root = ElementTree.fromstring(text)
    assert root.tag == f"{SVG}svg"
    rows: dict[float, str] = {}
    (matrix,) = (group for group in root.iter(f"{SVG}g") if group.get("class", "").endswith("matrix"))
    pieces = [(float(piece.get("y")), float(piece.get("x")), piece.text) for piece in matrix.iter(f"{SVG}text")]
    column = min(float(piece.get("textLength")) / len(piece.text) for piece in matrix.iter(f"{SVG}text"))
    for y, x, piece in pieces:
        rows[y] = rows.get(y, "").ljust(round(x / column)) + piece.replace("\xa0", " ")
    drawn = [line.rstrip() for _, line in sorted(rows.items()) if line.strip()]
    assert drawn == [line for frame in frames for line in frame.plain.split("\n") if line]
    assert shown.title in "".join(root.itertext()).replace("\xa0", " ")
    assert re.findall(r'https?://[^"\s]+', text) == ["http://www.w3.org/2000/svg"]
    assert "url(" not in re.sub(r"url\(#", "", text)
    assert to_svg(shown.frames(80, 24, 3), shown.title) == text
    plain = to_svg(frames, shown.title, colour=False)
    assert len(set(re.findall(r"fill: (#\w+)", plain))) == 1 < len(set(re.findall(r"fill: (#\w+)", text)))


def test_a_still_is_the_one_at_its_time(stories):
    shown = replay(stories, "orca", "linear")
    for at, time in ((0.0, 0.0), (1.1, 1.0), (1.2, 1.25), (np.inf, stories["orca"].time[-1])):
        (frame,) = shown.frames(at=at)
        assert frame.time == time
        assert frame.plain == shown.frames()[round(time / 0.25)].plain


def test_the_command_writes_files_and_plays_nothing(sfmrl, tmp_path):
    words = ("ascii-render", "orca", "--versus", "linear", "--environment", "2", "--ascii")
    stills = sfmrl(*words, "--frames", "2", "--size", "80x24")
    assert stills.returncode == 0, stills.stderr
    done = sfmrl(*words, "--frames", "2", "--svg", "a.svg", "--cast", "a.cast", "--speed", "4")
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    header, events = parsed((tmp_path / "a.cast").read_text(encoding="ascii"))
    written = re.findall(r"wrote (\S+): (\d+) frames of 80x24", done.stderr)
    assert written == [("a.svg", "2"), ("a.cast", str(len(events) - 1))]
    ElementTree.parse(tmp_path / "a.svg")
    assert (header["width"], header["height"]) == (79, 24)
    shown, _ = on_a_terminal("".join(event[2] for event in events), 79, 24)
    assert "\n".join(shown) in stills.stdout
    assert not list(tmp_path.glob(".*"))
    assert events[1][0] == 0.25 / 4

    before = (tmp_path / "a.svg").read_bytes()
    refused = sfmrl(*words, "--svg", "a.svg")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "a.svg is there already" in refused.stderr
    assert "--overwrite" in refused.stderr
    assert (tmp_path / "a.svg").read_bytes() == before
    again = sfmrl(*words, "--frames", "2", "--svg", "a.svg", "--overwrite")
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "a.svg").read_bytes() == before
    assert sfmrl(*words, "--svg", "a.svg", "--overwrite").returncode == 0
    assert (tmp_path / "a.svg").read_bytes() != before  # the last frame alone


def test_a_size_is_kept_in_a_pipe(sfmrl):
    for words in (("--scenes", "--environment", "2"), ("orca", "--at", "1")):
        done = sfmrl("ascii-render", *words, "--size", "140x48")
        assert done.returncode == 0, done.stderr
        assert max(map(len, done.stdout.splitlines())) > 100  # COLUMNS


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("--svg", "none/a.svg"), ("no folder none", "--svg a.svg")),
        (("--cast", "."), ("--cast . is a folder",)),
        (("--cast", "a", "--svg", "a"), ("--svg and --cast", "the same file")),
        (("--cast", "a", "--frames", "3"), ("--frames", "every step")),
        (("--svg", "a", "--frames", "3", "--at", "2"), ("--frames and --at",)),
        (("--scenes", "--svg", "a"), ("--scenes", "leave out --svg")),
        (("--scenes", "--versus", "orca"), ("--scenes", "leave out --versus")),
        (("--versus", "ocra"), ("there is no policy ocra", "orca")),
        (("--versus", "orca", "--size", "60x15"), (f"--versus needs {BESIDE} columns or {STACKED} lines",)),
        (("--size", "80"), ("--size is 80", "COLUMNSxLINES")),
        (("--size", "19x24"), ("--size is 19x24", "20x8")),
        (("--speed", "inf"), ("--speed",)),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(sfmrl, tmp_path, words, parts):
    done = sfmrl("ascii-render", "linear", *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.strip().splitlines()) == 1
    for part in parts:
        assert part in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("term", "no_color"), [("dumb", ""), ("xterm-256color", "1"), ("xterm-256color", "")])
def test_a_terminal_gets_only_what_it_can_show(term, no_color):
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    variables = environment() | {"TERM": term, "NO_COLOR": no_color, "COLUMNS": "80", "LINES": "24"}
    words = ["ascii-render", "orca", "--versus", "linear", *(["--frames", "2"] if term != "dumb" else [])]
    process = subprocess.Popen([sys.executable, "-m", "sfmrl", *words], env=variables, stdout=theirs, stdin=theirs)
    os.close(theirs)
    shown = b""
    while True:
        try:
            got = os.read(ours, 65536)
        except OSError:  # the other end has been closed
            got = b""
        if not got:
            break
        shown += got
    os.close(ours)
    assert process.wait() == 0
    text = shown.decode().replace("\r\n", "\n")
    codes = set(re.findall(r"\x1b\[([?\d;]*[A-Za-z])", text))
    if term == "dumb":
        assert "\x1b" not in text
        assert text.count("orca · environment") == 6
    elif no_color:
        assert codes <= {f"{code}m" for code in PLAIN}
    else:
        assert "1;36m" in codes
    lines = re.sub(r"\x1b\[[\d;]*m", "", text).split("\n")
    assert {cell_len(line) for line in lines if line} == {79}
    assert np.ptp([line.count("╭") for line in lines]) == 2
