"""Check an installation: versions, terminal, ORCA, the same bits on two threads, and which bits are computed here.

NumPy and torch are imported inside the checks, which report a missing one. Writes nothing.
"""

import os
import platform
import sys
from collections.abc import Iterator
from importlib import import_module, metadata
from pathlib import Path

from rich.console import Console

from sfmrl import __version__
from sfmrl.lessons import Finding

COLUMNS, LINES = 80, 24  # the size of terminal that the pictures are made for
REINSTALL = "pip install --force-reinstall"
INTEL_MAC = sys.platform == "darwin" and platform.machine() == "x86_64"


def examine(console: Console) -> Iterator[Finding]:
    """Yield all checks; `console` is the one that results are printed on."""
    yield Finding("sfmrl", None, f"{__version__}, in {Path(__file__).parents[1]}")
    yield Finding("Python", True, platform.python_version())
    for name in ("numpy", "torch", "typer", "rich"):
        try:
            import_module(name)
            yield Finding(name, True, metadata.version(name))
        except Exception as error:  # a broken installation can raise anything
            if name == "torch" and INTEL_MAC:
                said = "there is no torch 2.4 or later for Intel Macs; only ValueNetwork and CrowdNav's files need it"
                yield Finding(name, None, said)
                continue
            yield Finding(name, False, f"cannot be imported: {error}", f"{REINSTALL} {name}")
    yield _terminal(console)
    for what, check in (("ORCA", _orca), ("two threads", _two_threads), ("processor", _processor)):
        try:
            yield check()
        except Exception as error:
            yield Finding(what, False, f"{type(error).__name__}: {error}", f"{REINSTALL} numpy")


def _terminal(console: Console) -> Finding:
    """Check how replays are drawn here; a training needs no terminal."""
    if not console.is_terminal or console.is_dumb_terminal:
        return Finding("terminal", None, "standard output is not one: replays are stills, without colours")
    encoding = (console.encoding or "none").lower()
    said = f"{console.width} x {console.height}, {encoding}, colours: {console.color_system or 'none'}"
    if not encoding.startswith("utf"):
        return Finding("terminal", None, said, "replays are drawn in ASCII; set PYTHONIOENCODING=utf-8 for more")
    large = console.width >= COLUMNS and console.height >= LINES
    return Finding("terminal", large or None, said, f"make it {COLUMNS} x {LINES} for the whole picture")


def _orca() -> Finding:
    """Check that ORCA reaches its goal."""
    from sfmrl import play, sample_scenes

    successes = int((play(sample_scenes("circle5", 16), "orca").outcome == "success").sum())
    said = f"reaches the goal in {successes} of 16 episodes among five people"
    return Finding("ORCA", successes >= 12, said, f"{REINSTALL} numpy")


def _two_threads() -> Finding:
    """Check that a network plays the same positions on one thread and, in other batches, on two."""
    from sfmrl.episodes import play_episodes
    from sfmrl.fast import new_network
    from sfmrl.lookahead import SarlPolicy
    from sfmrl.scenes import sample_scenes
    from sfmrl.variants import make_config

    config, played = make_config(simulation={"time_limit": 6.0}), set()
    for threads, batch in ((1, 8), (2, 3)):
        policy = SarlPolicy(new_network(config, seed=5), config, threads)
        record = play_episodes(sample_scenes("table1", 8), policy, config.reward, config.simulation, batch=batch)
        played.add(record.position.tobytes())
    said = f"8 episodes end in {'the same bits as' if len(played) == 1 else 'OTHER bits than'} on one"
    return Finding("two threads", len(played) == 1, said, "train with --threads 1")


def _processor() -> Finding:
    """Return which bits processor and libraries compute; machines with equal ones train to equal numbers."""
    from sfmrl.policies import available_cores
    from sfmrl.runs.bits import machine_bits

    cores = f"{available_cores()} usable cores of {os.cpu_count() or 1}"
    return Finding("processor", None, f"{platform.machine()}, {cores}, bits {machine_bits()}")
