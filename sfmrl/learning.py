"""Gradient descent on stored values: what imitation and reinforcement learning share.

Mean squared error between the network's value and the stored one, as in CrowdNav.
"""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sfmrl.config import Config, ConfigError, Imitation, Reinforcement
from sfmrl.fast import FastNetwork
from sfmrl.memory import Memory

MOMENTUM = 0.9  # of SGD, as in the paper
MEAN, SQUARE, TINY = 0.9, 0.999, 1e-8  # of Adam, as its authors suggest
FORGOTTEN = 1e-20  # a mean gradient too small to move a parameter; hundreds of steps later it would be denormal


class SGD:
    """Descent along the running sum of gradients, each step's weighing `MOMENTUM` less at the next (Polyak, 1964)."""

    falls = False  # whether the learning rate falls to 0 over a training, in a straight line

    def __init__(self, network: FastNetwork) -> None:
        self.network = network
        self.moments = [np.zeros_like(network.flat)]
        self.steps = 0

    def rate(self, highest: float, progress: float) -> float:
        """The learning rate after `progress`, from 0 to 1, of a training."""
        return highest * (1.0 - progress) if self.falls else highest

    def step(self, rate: float) -> None:
        """Move the network's parameters at learning rate `rate`."""
        (velocity,) = self.moments
        velocity *= np.float32(MOMENTUM)
        velocity += self.network.gradient
        self.network.flat -= np.float32(rate) * velocity
        self.steps += 1

    def state_dict(self) -> dict[str, Any]:
        """What it has to keep to go on."""
        return {"moments": self.moments, "steps": self.steps}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Take back what `state_dict` gave."""
        self.moments, self.steps = saved["moments"], saved["steps"]


class Adam(SGD):
    """Descent along the running mean of gradients over the root of that of their squares (Kingma and Ba, 2015)."""

    falls = True

    def __init__(self, network: FastNetwork) -> None:
        super().__init__(network)
        self.moments.append(np.zeros_like(network.flat))

    def step(self, rate: float) -> None:
        """Move the network's parameters at learning rate `rate`; both means are corrected for their start at 0."""
        mean, square = self.moments
        self.steps += 1
        change = self.network.gradient - mean
        change *= np.float32(1 - MEAN)
        mean += change
        np.square(self.network.gradient, out=change)
        change -= square
        change *= np.float32(1 - SQUARE)
        square += change
        np.sqrt(square, out=change)
        change *= np.float32((1 - SQUARE**self.steps) ** -0.5)
        change += np.float32(TINY)
        np.divide(mean, change, out=change)
        change *= np.float32(rate / (1 - MEAN**self.steps))
        self.network.flat -= change


OPTIMIZERS: dict[str, type[SGD]] = {"sgd": SGD, "adam": Adam}


@np.errstate(over="ignore", invalid="ignore")  # found by `mean_loss`
def learn(network: FastNetwork, optimizer: SGD, rate: float, states: np.ndarray, values: np.ndarray) -> float:
    """One step of descent at learning rate `rate` on states (B, K, F) and values (B,); returns the loss."""
    loss, _ = network.loss_and_gradients(states, values)
    optimizer.step(rate)
    return loss


def mean_loss(losses: list[float], optimizer: SGD, settings: Imitation | Reinforcement) -> float:
    """The mean of the losses of steps of descent; raises ConfigError where it or the network is not finite after them.

    Checkpoints are written after this, so the last one is finite.
    """
    loss = float(np.mean(losses))
    if not (math.isfinite(loss) and np.isfinite(optimizer.network.flat).all()):
        raise ConfigError(
            f"the training diverged, its loss is {loss:g}: learning-rate {settings.learning_rate:g} is likely too high "
            f"for {type(optimizer).__name__} (or the rewards are too large); start a new run with a smaller "
            "--learning-rate. This one keeps its last good checkpoint"
        )
    return loss


def forget(optimizer: SGD) -> None:
    """Take what is left of gradients long past out of an optimizer's running means; to be done every few hundred steps.

    A unit that is no longer active has no gradient, and its mean falls until it is denormal, which processors are slow
    with: a tenth of the parameters made a step of Adam more than twice as slow.
    """
    mean = optimizer.moments[0]
    mean[np.abs(mean) < FORGOTTEN] = 0.0


class Fit:
    """A network on its way through the epochs of imitation: what has to be kept to go on after an interruption."""

    def __init__(self, network: FastNetwork, config: Config, rng: np.random.Generator) -> None:
        self.network, self.settings, self.rng = network, config.imitation, rng
        self.optimizer = OPTIMIZERS[config.optimizer](network)
        self.epoch = 0

    def run_epoch(self, memory: Memory, progress: Callable[[int], None]) -> float:
        """One pass over all that is stored, in random order; returns the mean loss."""
        size = self.settings.batch_size
        order = self.rng.permutation(len(memory))
        batches = [order[first : first + size] for first in range(0, len(order), size)]
        steps = self.settings.epochs * len(batches)
        losses = []
        forget(self.optimizer)
        for number, rows in enumerate(batches, start=self.epoch * len(batches)):
            rate = self.optimizer.rate(self.settings.learning_rate, number / steps)
            losses.append(learn(self.network, self.optimizer, rate, *memory.take(rows)))
            progress(1)
        loss = mean_loss(losses, self.optimizer, self.settings)
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
