"""Replays as files: what an asciinema player or a browser finds in them."""

import json
import re
import xml.etree.ElementTree as ElementTree

import pytest

from sfmrl.config import Reward
from sfmrl.episodes import play
from sfmrl.policies import POLICIES
from sfmrl.replay.frames import Replay
from sfmrl.replay.recordings import LAST_FRAME_SECONDS, to_cast, to_svg
from sfmrl.replay.story import make_story
from sfmrl.scenes import sample_scenes

UNCOLOURED = {"0", "1", "2", "7", "1;2", "1;7", "2;7"}  # bold, dim and reverse
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def replay():
    """A function that returns the replay of one episode as policies play it."""
    scenes = sample_scenes("2", [0])
    stories = {name: make_story(play(scenes, name), POLICIES[name], Reward(), 0.9) for name in ("orca", "linear")}
    return lambda *names, ascii_only=False: Replay(tuple(stories[name] for name in names), names, ascii_only)


@pytest.mark.parametrize("ascii_only", [False, True])
@pytest.mark.parametrize(
    ("names", "size", "width"),
    [
        (("orca",), (80, 24), 80),
        (("orca", "linear"), (80, 24), 79),  # two halves and a column between them
        (("linear",), (40, 11), 38),  # as wide as its longest sentence
    ],
)
def test_a_cast_shows_every_frame_whole_and_in_its_time(replay, names, size, width, ascii_only):
    shown = replay(*names, ascii_only=ascii_only)
    frames = shown.frames(*size)[:30]
    cast = to_cast(frames, shown.title, speed=2.0)
    assert cast.isascii() == ascii_only
    header, *events, end = map(json.loads, cast.splitlines())
    assert header == {"version": 2, "width": width, "height": size[1], "title": shown.title}
    assert [event[:2] for event in events] == [[frame.time / 2, "o"] for frame in frames]
    for frame, event in zip(frames, events, strict=True):
        clear, text = event[2][:16], re.sub(r"\x1b\[[\d;]*m", "", event[2][16:])
        assert clear == "\x1b[?25l\x1b[2J\x1b[1;1H"  # no cursor, an empty screen, its upper left corner
        lines = text.split("\r\n")
        assert all(line.isprintable() and len(line) <= width for line in lines)
        assert [line.rstrip() for line in lines] == frame.plain.split("\n")
    assert end == [events[-1][0] + LAST_FRAME_SECONDS, "o", f"\x1b[{size[1]};1H\x1b[?25h"]  # the cursor is back
    assert to_cast(shown.frames(*size)[:30], shown.title, speed=2.0) == cast


def test_a_cast_keeps_the_colours_and_leaves_them_out_where_none_are_wanted(replay):
    frames = replay("orca").frames()[:4]
    coloured, plain = (set(re.findall(r"\\u001b\[([\d;]*)m", to_cast(frames, "", colour=c))) for c in (True, False))
    assert "1;36" in coloured  # the robot, bold cyan
    assert plain <= UNCOLOURED


@pytest.mark.parametrize("names", [("orca",), ("orca", "linear")])
def test_an_svg_holds_the_frames_words_and_nothing_from_elsewhere(replay, names):
    shown = replay(*names)
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
