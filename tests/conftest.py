"""What all tests share: the same examples on every run, the `sfmrl` command, and the data's place."""

import os
import subprocess
import sys
from code import InteractiveConsole
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

Call = Callable[..., subprocess.CompletedProcess]
ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "tests" / "data"

os.environ.setdefault("OMP_NUM_THREADS", "1")  # tests are small; torch's threads would only wait for each other

settings.register_profile("sfmrl", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("sfmrl")


def environment() -> dict[str, str]:
    """The environment of a subprocess that must find this checkout, and not colour its output."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    plain = {name: value for name, value in os.environ.items() if name not in ("FORCE_COLOR", "TTY_COMPATIBLE")}
    return plain | {"PYTHONPATH": path, "NO_COLOR": "1", "COLUMNS": "100", "LINES": "30", "PYTHONIOENCODING": "utf-8"}


class Interpreter(InteractiveConsole):
    """`python` as a user types into it, with no names but its own; an error ends the test."""

    def showtraceback(self) -> None:
        raise

    def showsyntaxerror(self, *_: object, **__: object) -> None:
        raise

    def paste(self, block: str) -> None:
        """Type a block line by line, and an empty line in the end, without which a loop would wait for more."""
        waits = [self.push(line) for line in [*block.splitlines(), ""]]
        assert not waits[-1], block


@pytest.fixture
def sfmrl(tmp_path: Path) -> Call:
    """Call the command in a temporary folder: `sfmrl("eval", "orca")` -> code, stdout, stderr as text."""

    def call(*words: object, cwd: Path = tmp_path) -> subprocess.CompletedProcess:
        command = [sys.executable, "-m", "sfmrl", *map(str, words)]
        return subprocess.run(
            command, cwd=cwd, env=environment(), stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=200
        )

    return call


@pytest.fixture
def in_process(monkeypatch, capsys, tmp_path: Path) -> Call:
    """The same command without a process of its own, for the many small errors; an unexpected one is raised here."""
    from sfmrl.cli import main

    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> subprocess.CompletedProcess:
        monkeypatch.setattr(sys, "argv", ["sfmrl", *words])
        with pytest.raises(SystemExit) as end:
            main()
        return subprocess.CompletedProcess(words, end.value.code, *capsys.readouterr())

    return call


def assert_one_line_error(done: subprocess.CompletedProcess, *words: str) -> None:
    """Wrong use: exit code 2, nothing on standard output, one line on standard error with all of `words` in it."""
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1, done.stderr
    for word in words:
        assert word in done.stderr
