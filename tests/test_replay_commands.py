"""`sfmrl ascii-render`: files, pipes and terminals get what they can show, and wrong options one line."""

import json
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from conftest import assert_one_line_error, environment
from rich.cells import cell_len

UNCOLOURED = {"0", "1", "2", "7", "1;2", "1;7", "2;7"}  # bold, dim and reverse


def test_the_command_writes_files_and_plays_nothing(sfmrl, tmp_path):
    words = ("ascii-render", "orca", "--versus", "linear", "--environment", "2", "--ascii")
    stills = sfmrl(*words, "--frames", "2", "--size", "80x24")
    assert stills.returncode == 0, stills.stderr
    done = sfmrl(*words, "--frames", "2", "--svg", "a.svg", "--cast", "a.cast", "--speed", "4")
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    header, *events = map(json.loads, (tmp_path / "a.cast").read_text(encoding="ascii").splitlines())
    written = re.findall(r"wrote (\S+): (\d+) frames of 80x24", done.stderr)
    assert written == [("a.svg", "2"), ("a.cast", str(len(events) - 1))]
    ElementTree.parse(tmp_path / "a.svg")
    assert (header["width"], header["height"]) == (79, 24)
    last = re.sub(r"\x1b\[[?\d;]*[A-Za-z]", "", events[-2][2])
    assert "\n".join(line.rstrip() for line in last.split("\r\n")) in stills.stdout
    assert not list(tmp_path.glob(".*"))
    assert events[1][0] == 0.25 / 4

    before = (tmp_path / "a.svg").read_bytes()
    refused = sfmrl(*words, "--svg", "a.svg")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "a.svg already exists" in refused.stderr
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
        (("--svg", "none/a.svg"), ("no folder none", "another --svg")),
        (("--cast", "."), (". is not a regular file",)),
        (("--cast", "a", "--svg", "a"), ("--svg and --cast", "the same file")),
        (("--cast", "a", "--frames", "3"), ("--frames", "every step")),
        (("--svg", "a", "--frames", "3", "--at", "2"), ("--frames and --at",)),
        (("--scenes", "--svg", "a"), ("--scenes", "leave out --svg")),
        (("--scenes", "--versus", "orca"), ("--scenes", "leave out --versus")),
        (("--scenes", "--at", "0"), ("--scenes plays nothing; leave out --at",)),
        (("--scenes",), ("--scenes plays nothing; leave out the policy linear",)),
        (("--draw", "--environment", "2"), ("--draw plays nothing; leave out the policy linear",)),
        (("--versus", "ocra"), ("there is no policy ocra", "orca")),
        (
            ("--versus", "orca", "--size", "60x15"),
            ("--versus needs 61 columns or 16 lines",),
        ),
        (("--size", "80"), ("--size is 80", "COLUMNSxLINES")),
        (("--size", "19x24"), ("--size is 19x24", "20x8")),
        (("--speed", "inf"), ("--speed",)),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(in_process, tmp_path, words, parts):
    assert_one_line_error(in_process("ascii-render", "linear", *words), *parts)
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
        assert codes <= {f"{code}m" for code in UNCOLOURED}
    else:
        assert "1;36m" in codes
    lines = re.sub(r"\x1b\[[\d;]*m", "", text).split("\n")
    assert {cell_len(line) for line in lines if line} == {79}
    assert np.ptp([line.count("╭") for line in lines]) == 2
