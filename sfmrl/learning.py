"""Gradient descent on stored values: what imitation and reinforcement learning share.

Mean squared error between the network's value and the stored one, as in CrowdNav. The learning rate is a pure function
of progress, so a resumed training needs no scheduler's state.
"""

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.optim.sgd import sgd

from sfmrl.config import ConfigError, Imitation, Reinforcement
from sfmrl.gradients import loss_and_gradients
from sfmrl.memory import Memory
from sfmrl.network import ValueNetwork

MOMENTUM = 0.9  # of SGD, as in the paper
PLAIN = {"weight_decay": 0.0, "dampening": 0.0, "nesterov": False, "maximize": False, "fused": True}  # the rest of SGD
USEFUL_THREADS = 2  # a batch is too small for more
FORGOTTEN = 1e-20  # a mean gradient too small to move a parameter; hundreds of steps later it would be denormal


def _constant(progress: float) -> float:
    return 1.0


def _linear(progress: float) -> float:
    """Down to nothing in a straight line."""
    return 1.0 - progress


def _one_cycle(progress: float) -> float:
    """Up from 1/25 over the first 0.3, then down to nothing, both along a cosine (Smith and Topin, 2017)."""
    if progress < 0.3:
        return 1 / 25 + (1 - 1 / 25) * (1 - math.cos(math.pi * progress / 0.3)) / 2
    return (1 + math.cos(math.pi * (progress - 0.3) / 0.7)) / 2


SCHEDULES: dict[str, Callable[[float], float]] = {"constant": _constant, "linear": _linear, "one-cycle": _one_cycle}
OPTIMIZERS: dict[str, Callable[[ValueNetwork], torch.optim.Optimizer]] = {
    "sgd": lambda network: torch.optim.SGD([network.flat], lr=0.0, momentum=MOMENTUM, fused=True),
    "adam": lambda network: torch.optim.Adam([network.flat], lr=0.0, fused=True),
}


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Let torch use `count` threads on this one, two at most, and then one again."""
    torch.set_num_threads(min(count, USEFUL_THREADS))
    try:
        yield
    finally:
        torch.set_num_threads(1)


def learn(
    network: ValueNetwork, optimizer: torch.optim.Optimizer, rate: float, states: Tensor, values: Tensor
) -> Tensor:
    """One step of descent at learning rate `rate` on states (B, K, F) and values (B,); returns the loss, a scalar."""
    loss, _ = loss_and_gradients(network, states, values)
    _descend(optimizer, network.flat, rate)
    return loss


def mean_loss(losses: list[Tensor], network: ValueNetwork, settings: Imitation | Reinforcement) -> float:
    """The mean of the losses of steps of descent; raises ConfigError where it or the network is not finite after them.

    Checkpoints are written after this, so the last one is finite.
    """
    loss = float(torch.stack(losses).mean())
    if not (math.isfinite(loss) and bool(network.flat.isfinite().all())):
        raise ConfigError(
            f"the training diverged, its loss is {loss:g}: learning-rate {settings.learning_rate:g} is likely too high "
            f"for {settings.optimizer} (or the rewards are too large); start a new run with a smaller --learning-rate. "
            "This one keeps its last good checkpoint"
        )
    return loss


@torch.no_grad()
def _descend(optimizer: torch.optim.Optimizer, flat: Tensor, rate: float) -> None:
    """An optimizer's step; SGD's without what torch does around it, which takes longer than the arithmetic."""
    if isinstance(optimizer, torch.optim.SGD):
        state = optimizer.state[flat]
        if "momentum_buffer" not in state:
            state["momentum_buffer"] = torch.zeros_like(flat)
        sgd([flat], [flat.grad], [state["momentum_buffer"]], lr=rate, momentum=MOMENTUM, **PLAIN)
    else:
        for group in optimizer.param_groups:
            group["lr"] = rate
        optimizer.step()


def forget(optimizer: torch.optim.Optimizer) -> None:
    """Take what is left of gradients long past out of an optimizer's running means; to be done every few hundred steps.

    A unit that is no longer active has no gradient, and its mean falls until it is denormal, which processors are slow
    with: a tenth of the parameters made a step of Adam more than twice as slow.
    """
    for state in optimizer.state.values():
        for name in ("momentum_buffer", "exp_avg"):
            if name in state:
                state[name].masked_fill_(state[name].abs() < FORGOTTEN, 0.0)


class Fit:
    """A network on its way through the epochs of imitation: what has to be kept to go on after an interruption."""

    def __init__(self, network: ValueNetwork, settings: Imitation, rng: np.random.Generator) -> None:
        self.network, self.settings, self.rng = network, settings, rng
        self.optimizer = OPTIMIZERS[settings.optimizer](network)
        self.epoch = 0

    def run_epoch(self, memory: Memory, progress: Callable[[int], None]) -> float:
        """One pass over all that is stored, in random order; returns the mean loss."""
        size = self.settings.batch_size
        order = self.rng.permutation(len(memory))
        batches = [order[first : first + size] for first in range(0, len(order), size)]
        schedule, steps = SCHEDULES[self.settings.schedule], self.settings.epochs * len(batches)
        losses = []
        forget(self.optimizer)
        for number, rows in enumerate(batches, start=self.epoch * len(batches)):
            rate = self.settings.learning_rate * schedule(number / steps)
            losses.append(learn(self.network, self.optimizer, rate, *memory.take(rows)))
            progress(1)
        loss = mean_loss(losses, self.network, self.settings)
        self.epoch += 1
        return loss

    def state_dict(self) -> dict[str, Any]:
        """All that decides how it goes on."""
        return {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "rng": generator_state(self.rng),
            "epoch": self.epoch,
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Take back what `state_dict` gave."""
        self.network.load_state_dict(saved["network"])
        self.optimizer.load_state_dict(saved["optimizer"])
        set_generator_state(self.rng, saved["rng"])
        self.epoch = saved["epoch"]


def generator_state(rng: np.random.Generator) -> str:
    """A generator's state as text."""
    return json.dumps(rng.bit_generator.state)


def set_generator_state(rng: np.random.Generator, state: str) -> None:
    """Put a generator into a state that `generator_state` gave."""
    rng.bit_generator.state = json.loads(state)
