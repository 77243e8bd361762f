"""Does sfmrl work here: versions, terminal, ORCA, the same bits on two threads, and which bits this processor computes.

NumPy and torch are imported inside the checks, so that there is an answer where one of them is missing, too. Nothing is
written.
"""

import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from rich.console import Console

from sfmrl import __version__

LEAST_PYTHON = (3, 11)
READABLE = (80, 24)  # columns and lines that the pictures are made for
REINSTALL = "pip install --force-reinstall numpy torch"


@dataclass(frozen=True)
class Check:
    """One result: whether it is as it should be (None: nothing to judge), what was found, and what would help."""

    what: str
    good: bool | None
    said: str
    remedy: str = ""


def examine(console: Console) -> Iterator[Check]:
    """All checks; `console` is the one that results are printed on."""
    yield Check("sfmrl", None, f"{__version__}, in {Path(__file__).parents[1]}")
    right = sys.version_info >= LEAST_PYTHON
    yield Check("Python", right, platform.python_version(), f"install Python {'.'.join(map(str, LEAST_PYTHON))}")
    for name in ("numpy", "torch", "typer", "rich"):
        try:
            __import__(name)
            yield Check(name, True, metadata.version(name))
        except Exception as error:  # a broken installation can raise anything
            yield Check(name, False, f"cannot be imported: {error}", f"pip install --force-reinstall {name}")
    yield _terminal(console)
    for what, check in (("ORCA", _orca), ("two threads", _two_threads), ("processor", _processor)):
        try:
            yield check()
        except Exception as error:
            yield Check(what, False, f"{type(error).__name__}: {error}", REINSTALL)


def _terminal(console: Console) -> Check:
    """How replays are drawn here; nothing of it hinders a training."""
    if not console.is_terminal or console.is_dumb_terminal:
        return Check("terminal", None, "standard output is not one: replays are stills, without colours")
    encoding = (console.encoding or "none").lower()
    said = f"{console.width} x {console.height}, {encoding}, colours: {console.color_system or 'none'}"
    if not encoding.startswith("utf"):
        return Check("terminal", None, said, "replays are drawn in ASCII; set PYTHONIOENCODING=utf-8 for more")
    large = console.width >= READABLE[0] and console.height >= READABLE[1]
    return Check("terminal", large or None, said, f"make it {READABLE[0]} x {READABLE[1]} for the whole picture")


def _orca() -> Check:
    """ORCA steers everybody, and most episodes end in success."""
    from sfmrl import play, sample_scenes

    successes = int((play(sample_scenes("circle5", 16), "orca").outcome == "success").sum())
    return Check(
        "ORCA", successes >= 12, f"reaches the goal in {successes} of 16 episodes among five people", REINSTALL
    )


def _two_threads() -> Check:
    """A network plays the same positions on one thread and, in other batches, on two."""
    from sfmrl.episodes import play_episodes
    from sfmrl.fast import new_network
    from sfmrl.lookahead import SarlPolicy
    from sfmrl.scenes import sample_scenes
    from sfmrl.variants import make_config

    config, found = make_config(simulation={"time_limit": 6.0}), set()
    for threads, batch in ((1, 8), (2, 3)):
        policy = SarlPolicy(new_network(config, seed=5), config, threads)
        record = play_episodes(sample_scenes("table1", 8), policy, config.reward, config.simulation, batch=batch)
        found.add(record.position.tobytes())
    said = f"8 episodes end in {'the same' if len(found) == 1 else 'OTHER'} bits as on one"
    return Check("two threads", len(found) == 1, said, "train with --threads 1")


def _processor() -> Check:
    """Which bits the processor and the libraries compute; where they are equal, so are the numbers of a training."""
    from sfmrl.bits import machine_bits
    from sfmrl.lookahead import available_cores

    cores = f"{available_cores()} usable cores of {os.cpu_count() or 1}"
    return Check("processor", None, f"{platform.machine()}, {cores}, bits {machine_bits()}")
