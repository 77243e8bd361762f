"""Which bits this machine computes: a digest of small computations, to compare with one from another machine.

Processors and libraries add up sums in different orders, so the same training has other last digits elsewhere. Neither
the processor's name nor equal versions tell whether it has. Compare these digests before you compare numbers to the
digit. No code of the simulator or the network takes part, so a change to them changes no digest.
"""

import hashlib
from collections.abc import Iterator
from functools import cache
from itertools import pairwise

import numpy as np
import torch
from torch.nn.functional import linear

from sfmrl.network import resolved

ROWS, WIDTHS = 2000, (13, 150, 100, 1)  # 200 states of ten elements each, through layers as wide as SARL's
STEPS, RATE = 8, 0.05  # of the descent


@cache
def machine_bits() -> str:
    """Twelve hexadecimal digits, equal on machines that compute the same bits as far as a short test can tell."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        types = dict.fromkeys((torch.float32, torch.bfloat16 if resolved("auto") == "bf16" else torch.float32))
        arrays = [*_functions(), *(array for low in types for array in _descent(low))]
    finally:
        torch.set_num_threads(threads)
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()[:12]


def _functions() -> Iterator[np.ndarray]:
    """Values of the functions that simulator, states and network use; 1,001 numbers leave a remainder."""
    for kind in (np.float32, np.float64):
        x, y = np.random.default_rng(0).uniform(0.01, 8.0, (2, 1001)).astype(kind)
        yield from (np.exp(-x), np.sqrt(x), np.sin(x), np.cos(x), np.arctan2(x, y), np.hypot(x, y), kind(0.9) ** x)
    share = torch.exp(-torch.from_numpy(x.astype(np.float32))[:1000].view(-1, 10))
    yield (share / share.sum(1, keepdim=True)).numpy()


def _descent(low: torch.dtype) -> list[np.ndarray]:
    """Losses and parameters along a short gradient descent whose layers compute in the type `low`."""
    rng = np.random.default_rng(0)
    states, values = (torch.from_numpy(rng.standard_normal((ROWS, width), np.float32)) for width in (WIDTHS[0], 1))
    shapes = [shape for inputs, width in pairwise(WIDTHS) for shape in ((width, inputs), width)]
    parameters = [torch.from_numpy(rng.standard_normal(shape, np.float32) / 8).requires_grad_() for shape in shapes]
    losses = []
    for _ in range(STEPS):
        x = states.to(low)
        for number, (weight, bias) in enumerate(zip(parameters[::2], parameters[1::2], strict=True)):
            x = linear(x.relu() if number else x, weight.to(low), bias.to(low))
        loss = (x.float() - values).square().mean()
        gradients = torch.autograd.grad(loss, parameters)
        with torch.no_grad():
            for parameter, gradient in zip(parameters, gradients, strict=True):
                parameter -= RATE * gradient
        losses.append(loss)
    return [tensor.detach().numpy() for tensor in (*losses, *parameters)]
