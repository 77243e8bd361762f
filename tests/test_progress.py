"""Signals sent to real processes, in a terminal and without: the exit code, the one line, the terminal afterwards."""

import errno
import io
import os
import select
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest
from conftest import environment
from rich.console import Console

from sfmrl.runs.folders import in_training, locked
from sfmrl.runs.progress import SIGNALS, StopSignal, held_back, show_progress

termios = pytest.importorskip("termios")
SFMRL = [sys.executable, "-m", "sfmrl"]
# Where Python met the signal in a call of exec, it ends itself by SIGINT in the end; a shell calls that 130, too.
CODES = (130, -signal.SIGINT)


def shown_until(terminal: int, end: bytes | None) -> bytes:
    """What a terminal is sent up to and with `end`, or (None) until the other side has closed it."""
    shown = b""
    while end is None or end not in shown:
        assert select.select([terminal], [], [], 60)[0], shown
        try:
            got = os.read(terminal, 65536)
        except OSError:  # the other side has been closed
            got = b""
        if not got:
            assert end is None, shown
            break
        shown += got
    return shown


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_ends_a_replay_with_one_line_and_the_terminal_as_it_was(tmp_path, number):
    ours, theirs = os.openpty()
    before = termios.tcgetattr(theirs)
    words = [*SFMRL, "ascii-render", "linear", "--environment", "5", "--speed", "0.01"]
    variables = environment() | {"TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"}
    streams = dict.fromkeys(("stdin", "stdout", "stderr"), theirs)
    process = subprocess.Popen(words, cwd=tmp_path, env=variables, **streams)
    shown_until(ours, b"q quit")
    assert termios.tcgetattr(theirs) != before  # single keys, no echo
    process.send_signal(number)
    assert process.wait(60) == 130
    assert termios.tcgetattr(theirs) == before
    os.close(theirs)
    left = shown_until(ours, None).decode()
    os.close(ours)
    assert left.rindex("\x1b[?1049l") > left.rfind("\x1b[?1049h")  # the first screen
    assert left.rindex("\x1b[?25h") > left.rfind("\x1b[?25l")  # and its cursor
    assert left.endswith("sfmrl: interrupted\r\n")
    assert "Traceback" not in left


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("imported", ["rich.text", "sfmrl.cli.options", "sfmrl.evaluation"])
def test_a_signal_during_the_imports_or_after_is_one_line_too(tmp_path, number, imported):
    words = [sys.executable, "-X", "importtime", *SFMRL[1:], "eval", "orca", "--episodes", "3000"]
    process = subprocess.Popen(words, cwd=tmp_path, env=environment(), stderr=subprocess.PIPE, text=True)
    for line in process.stderr:
        if line.split("|")[-1].strip() == imported:
            break
    process.send_signal(number)
    said = [line for line in process.stderr.read().splitlines() if not line.startswith("import time:")]
    assert said == ["sfmrl: interrupted"]
    assert process.wait(60) in CODES


WHERE = {
    "class": 'type("Made", (), {"field": Signals()})',
    "weak reference": "made = Signals(); reference = weakref.ref(made, Signals.send); del made",  # swallows exceptions
}


@pytest.mark.parametrize(
    ("where", "imported"),
    [
        *(("class", imported) for imported in ("sfmrl.cli", "rich.table", "sfmrl.evaluation", "sfmrl.fast.network")),
        *(("weak reference", imported) for imported in ("sfmrl.cli", "rich.table")),
    ],
)
def test_a_signal_is_one_line_where_an_import_wraps_or_swallows_exceptions_too(tmp_path, where, imported):
    code = f"""
import os, signal, sys, weakref

class Signals:
    def send(self, *_):
        os.kill(os.getpid(), signal.SIGINT)

    __set_name__ = send

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {imported!r}:
            {WHERE[where]}

sys.meta_path.insert(0, Finder())
sys.argv = ["sfmrl", "eval", "sarl", "--episodes", "1"]
from sfmrl.__main__ import main
main()
"""
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("", "sfmrl: interrupted\n")
    assert done.returncode in CODES


def test_the_first_signal_is_a_request_and_the_second_acts_at_once():
    before = signal.getsignal(signal.SIGTERM)
    with StopSignal() as stop:
        assert not stop.requested
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop.requested
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_signal_that_is_ignored_stays_ignored_as_nohup_has_it():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopSignal() as stop:
            os.kill(os.getpid(), signal.SIGHUP)
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
            os.kill(os.getpid(), signal.SIGTERM)
            assert stop.requested
    finally:
        signal.signal(signal.SIGHUP, before)


def test_signals_held_back_come_after_the_block_and_not_to_processes_started_in_it():
    code = "import os, signal; os.kill(os.getpid(), signal.SIGINT); print('alive')"
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012
        with held_back():
            os.kill(os.getpid(), signal.SIGINT)
            child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
            assert (child.stdout, child.stderr) == ("alive\n", "")
        pytest.fail("the signal was lost")


@pytest.mark.parametrize("colours", [False, True])  # as FORCE_COLOR asks for
def test_progress_in_a_pipe_is_a_line_after_two_seconds_and_then_every_ten(monkeypatch, colours):
    now = [0.0]
    monkeypatch.setattr("sfmrl.runs.progress.time", SimpleNamespace(monotonic=lambda: now[0]))
    console = Console(file=io.StringIO(), force_terminal=colours)
    with show_progress(console)("test", 100) as advance:
        for now[0] in (1.0, 3.0, 8.0, 13.5):
            advance(10)
    lines = ["test: 20 of 100, 6.7/s, 12 s left", "test: 40 of 100, 3.0/s, 20 s left"]
    assert console.file.getvalue().splitlines() == lines


def test_a_file_system_without_locks_trains_all_the_same(tmp_path, monkeypatch):
    def flock(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", flock)
    with locked(tmp_path):
        assert not in_training(tmp_path)
