"""SGD with momentum and Adam in NumPy, on the one array that holds a network's parameters."""

from typing import Any

import numpy as np

from sfmrl.fast.network import FastNetwork

MOMENTUM = 0.9  # of SGD, as in the paper
BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8  # of Adam, as its authors suggest
NEGLIGIBLE = 1e-20  # a mean gradient too small to move a parameter; hundreds of steps later it is denormal


class SGD:
    """Descent along the sum of all gradients so far, which decays by `MOMENTUM` at each step (Polyak, 1964)."""

    def __init__(self, network: FastNetwork) -> None:
        self.network = network
        self.moments = [np.zeros_like(network.flat)]
        self.steps = 0

    def rate(self, highest: float, progress: float) -> float:
        """The learning rate at a `progress` from 0 to 1 of a training."""
        return highest

    def step(self, rate: float) -> None:
        """Move the network's parameters at learning rate `rate`."""
        (velocity,) = self.moments
        velocity *= np.float32(MOMENTUM)
        velocity += self.network.gradient
        self.network.flat -= np.float32(rate) * velocity
        self.steps += 1

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint stores."""
        return {"moments": self.moments, "steps": self.steps}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self.moments, self.steps = saved["moments"], saved["steps"]


class Adam(SGD):
    """Descent along the mean gradient, divided by the root of the mean squared gradient (Kingma and Ba, 2015)."""

    def __init__(self, network: FastNetwork) -> None:
        super().__init__(network)
        self.moments.append(np.zeros_like(network.flat))

    def rate(self, highest: float, progress: float) -> float:
        """The learning rate at a `progress` from 0 to 1 of a training: it falls linearly to 0."""
        return highest * (1.0 - progress)

    def step(self, rate: float) -> None:
        """Move the network's parameters at learning rate `rate`; both means are corrected for their start at 0."""
        mean, square = self.moments
        self.steps += 1
        change = self.network.gradient - mean
        change *= np.float32(1 - BETA1)
        mean += change
        np.square(self.network.gradient, out=change)
        change -= square
        change *= np.float32(1 - BETA2)
        square += change
        np.sqrt(square, out=change)
        change *= np.float32((1 - BETA2**self.steps) ** -0.5)
        change += np.float32(EPSILON)
        np.divide(mean, change, out=change)
        change *= np.float32(rate / (1 - BETA1**self.steps))
        self.network.flat -= change


OPTIMIZERS: dict[str, type[SGD]] = {"sgd": SGD, "adam": Adam}


def flush_negligible(optimizer: SGD) -> None:
    """Zero the entries of an optimizer's mean gradient that are too small to matter; call it every few hundred steps.

    A unit that is never active again has no gradient. Its mean gradient decays until it is denormal, and processors are
    slow with denormal numbers: with a tenth of the entries denormal, a step of Adam took more than twice as long.
    """
    mean = optimizer.moments[0]
    mean[np.abs(mean) < NEGLIGIBLE] = 0.0
