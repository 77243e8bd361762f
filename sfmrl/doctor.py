"""Is this a place where sfmrl works: versions, processor, terminal, the runs' folder, and a self-test.

NumPy and torch are imported by what looks at them, so that there is an answer where one of them is missing, too.
Nothing is written.
"""

import os
import platform
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from rich.console import Console

from sfmrl import __version__
from sfmrl.folders import RUNS, finished, in_training, kind_of, run_folders

LEAST_PYTHON = (3, 11)
SPACE = 1.0  # GB that should be free: a run's checkpoints take 0.1
READABLE = (80, 24)  # columns and lines that the pictures are made for


@dataclass(frozen=True)
class Check:
    """One thing that was looked at: whether it is as it should be (None: as it is), what it is, and what would help."""

    what: str
    good: bool | None
    said: str
    remedy: str = ""


def examine(console: Console) -> Iterator[Check]:
    """All checks but the self-test; `console` is the one that results are printed on."""
    yield Check("sfmrl", None, f"{__version__}, in {Path(__file__).parent}")
    right = sys.version_info >= LEAST_PYTHON
    yield Check("Python", right, platform.python_version(), f"install Python {'.'.join(map(str, LEAST_PYTHON))}")
    yield from _packages()
    yield from _torch()
    yield from _terminal(console)
    yield from _runs()


def self_test() -> Iterator[Check]:
    """The self-test, one part after another."""
    try:
        import torch

        from sfmrl.self_test import TESTS, Failure

        torch.set_num_threads(1)  # each part asks for as many as it means to test
    except Exception as error:  # a broken installation can raise anything
        yield Check("self-test", False, f"cannot begin: {type(error).__name__}: {error}", "see the lines above")
        return
    for what, (test, remedy) in TESTS.items():
        try:
            yield Check(what, True, test())
        except Failure as failure:
            yield Check(what, False, str(failure), remedy)
        except Exception as error:
            yield Check(what, False, f"{type(error).__name__}: {error}", remedy)


def _packages() -> Iterator[Check]:
    for name in ("numpy", "torch", "typer", "rich"):
        try:
            __import__(name)
            yield Check(name, True, metadata.version(name))
        except Exception as error:
            yield Check(name, False, f"cannot be imported: {error}", f"pip install --force-reinstall {name}")


def _torch() -> Iterator[Check]:
    """The build and the processor, as torch sees them; nothing where there is no torch."""
    try:
        import torch

        from sfmrl.lookahead import available_cores
        from sfmrl.network import resolved
    except Exception:
        return
    build = "CPU"
    if torch.version.cuda or torch.version.hip:
        usable = torch.cuda.is_available()
        build = f"GPU ({torch.version.cuda or torch.version.hip}), {'usable' if usable else 'none usable'} here"
    yield Check("torch's build", None, f"{build}; nothing in sfmrl needs a GPU")
    has = getattr(torch.cpu, "get_capabilities", dict)()
    types = ", ".join(name for name in ("amx_bf16", "avx512_bf16", "bf16") if has.get(name)) or "no bfloat16"
    auto = resolved("auto")
    yield Check(
        "processor", None, f"{platform.machine()}, {torch.backends.cpu.get_cpu_capability()}, {types}: auto is {auto}"
    )
    cores, there = available_cores(), os.cpu_count() or 1
    limit = os.environ.get("OMP_NUM_THREADS")
    said = f"{cores} usable of {there}; torch's own default {torch.get_num_threads()} threads"
    yield Check("cores", None, said + (f" (OMP_NUM_THREADS={limit})" if limit else ""))


def _terminal(console: Console) -> Iterator[Check]:
    """What pictures can be shown; none of it keeps a training from its work."""
    terminal = console.is_terminal and not console.is_dumb_terminal
    if terminal:
        large = console.width >= READABLE[0] and console.height >= READABLE[1]
        remedy = "" if large else f"for the whole picture make it {READABLE[0]} x {READABLE[1]}"
        yield Check("terminal", large or None, f"{console.width} x {console.height}", remedy)
        unset = "unset NO_COLOR" if "NO_COLOR" in os.environ else ""
        yield Check("colours", True if console.color_system else None, console.color_system or "none", unset)
    else:
        yield Check("terminal", None, "standard output is not one: replays are stills, without colours")
    encoding = (console.encoding or "none").lower()
    utf8 = encoding.startswith("utf")
    yield Check("characters", utf8 or None, encoding, "pictures are drawn with --ascii; or set PYTHONIOENCODING=utf-8")
    keys = _keys()
    yield Check("keys", keys or None, "pause and step a replay" if keys else "none: a replay just runs to its end")


def _keys() -> bool:
    """Whether single keys can be read: on a system with termios, where standard input is a terminal."""
    try:
        import termios  # noqa: F401
    except ImportError:
        return False
    return sys.stdin is not None and sys.stdin.isatty()


def _runs() -> Iterator[Check]:
    """Where runs go, and what is there."""
    here = Path.cwd()
    place = RUNS if RUNS.exists() else here
    writable = place.is_dir() and os.access(place, os.W_OK | os.X_OK)
    name = f"{RUNS}/ in {here}" if RUNS.exists() else f"none yet in {here}"
    said = f"{name}: {'writable' if writable else 'NOT writable'}"
    yield Check("runs", writable, said, "go to a folder of your own, or name one with --run")
    free = shutil.disk_usage(here).free / 1e9
    yield Check("space", free >= SPACE, f"{free:,.1f} GB free", f"free {SPACE:g} GB, or name another place with --run")
    folders = run_folders()
    if not folders:
        return
    words = []
    for kind in ("il", "rl"):
        of_kind = [folder for folder in folders if kind_of(folder) == kind]
        ended = sum(map(finished, of_kind))
        if of_kind:
            now = sum(map(in_training, of_kind))
            training = f", {now} being trained now" if now else ""
            words.append(f"{len(of_kind)} of sfmrl {kind}, {ended} of them finished{training}")
    yield Check("trained", None, "; ".join(words))
