"""Versions, and the bits that this machine computes: a run's numbers depend on both, and on its config.

Processors and libraries add numbers in different orders, so the same training can end with other last digits on another
machine, even with the same versions. `machine_bits`, a digest of small computations, shows whether it does: compare it
before you compare numbers to the last digit. It uses no code of the simulator or the network, so it does not change
when they do.
"""

import hashlib
import platform
import subprocess
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from sfmrl import __version__
from sfmrl.fast import kernels  # importing sfmrl.fast also sets OpenBLAS to one thread

ROWS, WIDTHS = 2000, (13, 150, 100, 1)  # 200 states of ten elements each, through layers as wide as SARL's
STEPS, RATE = 8, 0.05  # of gradient descent


def versions() -> dict[str, str]:
    """Versions of sfmrl and of all that its numbers depend on, as run.json stores them."""
    checkout = commit()
    return {
        "sfmrl": __version__,
        **({"commit": checkout} if checkout else {}),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "system": platform.platform(),
        "processor": kernels(),
        "bits": machine_bits(),
    }


@cache
def commit() -> str | None:
    """The commit of the checkout that sfmrl runs from, "-dirty" after it if files have changed; None outside of one."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    words = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        return subprocess.run(words, capture_output=True, text=True, timeout=10, check=False).stdout.strip() or None
    except (OSError, subprocess.SubprocessError):
        return None


@cache
def machine_bits() -> str:
    """Twelve hexadecimal digits, equal on machines that compute the same bits as far as a short test can tell."""
    return hashlib.sha256(b"".join(array.tobytes() for array in (*_functions(), *_descent()))).hexdigest()[:12]


def _functions() -> Iterator[np.ndarray]:
    """Values of the functions that simulator, states and network use."""
    for kind in (np.float32, np.float64):
        # 1,001 numbers do not fill the vector registers evenly, so the code for the remainder runs, too.
        x, y = np.random.default_rng(0).uniform(0.01, 8.0, (2, 1001)).astype(kind)
        yield from (np.exp(-x), np.sqrt(x), np.sin(x), np.cos(x), np.arctan2(x, y), np.hypot(x, y), kind(0.9) ** x)
    yield x[:1000].reshape(-1, 10).astype(np.float32).sum(1)


def _descent() -> list[np.ndarray]:
    """Losses and weights of a short gradient descent on random data."""
    rng = np.random.default_rng(0)
    states, values = (rng.standard_normal((ROWS, width), np.float32) for width in (WIDTHS[0], 1))
    weights = [rng.standard_normal(shape, np.float32) / 8 for shape in pairwise(WIDTHS)]
    losses = []
    for _ in range(STEPS):
        layers = [states]
        for weight in weights:
            layers.append(np.maximum(layers[-1] @ weight, 0))
        d = layers[-1] - values
        losses.append(np.square(d).mean())
        for weight, x, y in zip(weights[::-1], layers[-2::-1], layers[::-1], strict=False):
            d *= y > 0
            change, d = x.T @ d, d @ weight.T
            weight -= np.float32(2 * RATE / ROWS) * change
    return [np.array(losses), *weights]
