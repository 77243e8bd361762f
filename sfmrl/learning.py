"""Gradient descent on stored values, which imitation and reinforcement learning share.

The loss is the mean squared error between the network's value of a state and the stored one, as in CrowdNav. `Memory`
is the replay memory, `Learner` the state of deep V-learning between two rounds of episodes.
"""

import json
import math
from collections.abc import Callable
from copy import copy
from typing import Any

import numpy as np

from sfmrl.config import Config, ConfigError
from sfmrl.fast import FastNetwork
from sfmrl.fast.optimizers import OPTIMIZERS, SGD, flush_negligible
from sfmrl.scenes import generator
from sfmrl.states import column_names, mirrored_columns, own_columns


class Memory:
    """The newest `capacity` states (K, F) with their values; states with fewer than K elements get absent ones.

    With `mirror`, every other state of a batch is mirrored left to right, which does not change its value.
    """

    def __init__(self, capacity: int, elements: int, *, forces: bool = False, mirror: bool = False) -> None:
        self.mirror = mirrored_columns(forces) if mirror else None
        self.states = np.empty((capacity, elements, len(column_names(forces))), dtype=np.float32)
        self.values = np.empty(capacity, dtype=np.float32)
        self.own = own_columns(forces)  # the columns from here on are an element's, and NaN where it is absent
        self.size = self.next = 0

    def __len__(self) -> int:
        return self.size

    def push(self, states: np.ndarray, values: np.ndarray) -> None:
        """Add states (S, k, F) with k <= K, and their values (S,), in order."""
        capacity = len(self.states)
        states, values = states[-capacity:], values[-capacity:]
        where, elements = (self.next + np.arange(len(states))) % capacity, states.shape[1]
        self.states[where, :elements] = states
        self.states[where, elements:, : self.own] = states[:, :1, : self.own]  # absent ones have the robot's columns
        self.states[where, elements:, self.own :] = np.nan
        self.values[where] = values
        self.next = int((self.next + len(states)) % capacity)
        self.size = min(self.size + len(states), capacity)

    def take(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A batch of states (B, K, F) and values (B,), by their indices in the memory, (B,)."""
        states = self.states[rows]
        if self.mirror is not None:
            states[::2] *= self.mirror
        return states, self.values[rows]

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint stores."""
        return {"states": self.states[: self.size], "values": self.values[: self.size], "next": self.next}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self.size, self.next = len(saved["values"]), saved["next"]
        self.states[: self.size], self.values[: self.size] = saved["states"], saved["values"]


@np.errstate(over="ignore", invalid="ignore")  # `descend` finds what is not finite
def learn(optimizer: SGD, rate: float, states: np.ndarray, values: np.ndarray) -> float:
    """One step of descent at learning rate `rate` on states (B, K, F) and values (B,); returns the loss."""
    loss, _ = optimizer.network.loss_and_gradients(states, values)
    optimizer.step(rate)  # along the network's `gradient`, which the line above has written
    return loss


def descend(
    optimizer: SGD,
    memory: Memory,
    batches: list[np.ndarray],
    rate: float,
    steps: int,
    progress: Callable[[int], None] = lambda batches: None,
) -> float:
    """Take a step of descent on each of the `batches`, indices (B,) in the memory; returns the mean loss.

    `rate` is the highest learning rate of the training, `steps` how many it takes in all; `progress` is called with 1
    after each. Raises ConfigError if the loss or a weight is not finite, so that such a network is never saved.
    """
    flush_negligible(optimizer)
    losses = []
    for rows in batches:
        now = optimizer.rate(rate, optimizer.steps / steps)
        losses.append(learn(optimizer, now, *memory.take(rows)))
        progress(1)
    loss = float(np.mean(losses))
    if not (math.isfinite(loss) and np.isfinite(optimizer.network.flat).all()):
        raise ConfigError(
            f"the training diverged (loss {loss:g}): learning-rate {rate:g} is likely too high for "
            f"{type(optimizer).__name__} (or the rewards are too large); start a new run with a smaller "
            "--learning-rate. The old run keeps its last good checkpoint"
        )
    return loss


class Resumable:
    """Base of trainings that can be interrupted: restored `parts`, `counters` and `rng` lead on to the same bits."""

    parts: tuple[str, ...]
    counters: tuple[str, ...]
    rng: np.random.Generator

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint stores."""
        parts = {name: getattr(self, name).state_dict() for name in self.parts}
        counters = {name: getattr(self, name) for name in self.counters}
        return parts | counters | {"rng": json.dumps(self.rng.bit_generator.state)}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        for name in self.parts:
            getattr(self, name).load_state_dict(saved[name])
        for name in self.counters:
            setattr(self, name, saved[name])
        self.rng.bit_generator.state = json.loads(saved["rng"])


class Learner(Resumable):
    """The state of deep V-learning between two rounds of episodes.

    network: the network in training
    actor: the network that explores: the same or, in rounds of several episodes, a copy from before the latest batches
    target: the target network, a copy that is renewed at intervals, for the values to learn
    episode: the number of episodes learnt from
    rows, validations: the lines of metrics.csv and validation.csv
    """

    parts = ("network", "actor", "target", "optimizer", "memory")
    counters = ("episode", "rows", "validations")

    def __init__(self, network: FastNetwork, memory: Memory, config: Config) -> None:
        self.config, self.memory, self.network = config, memory, network
        self.target = copy(network)
        self.actor = copy(network) if config.reinforcement.parallel > 1 else network
        self.optimizer = OPTIMIZERS[config.optimizer](network)
        self.rng = generator(config.seed, "batches")
        self.episode = 0
        self.rows: list[dict[str, Any]] = []
        self.validations: list[dict[str, Any]] = []

    def learn(self, batches: int) -> float:
        """Run `batches` steps of descent on the memory; returns their mean loss, NaN without any."""
        settings, stored = self.config.reinforcement, len(self.memory)
        if not (stored and batches):
            return math.nan
        # Draw all batches first: between steps of descent, a draw takes eight times as long, with cold caches.
        size = min(settings.batch_size, stored)
        draws = [self.rng.choice(stored, size, replace=False) for _ in range(batches)]
        steps = settings.episodes * settings.batches
        return descend(self.optimizer, self.memory, draws, settings.learning_rate, steps)

    def advance(self, episodes: int) -> None:
        """Count these episodes as learnt from, and renew the target network at its interval."""
        interval = self.config.reinforcement.target_interval
        renew = self.episode // interval < (self.episode + episodes) // interval
        self.episode += episodes
        if renew:
            self.target.flat[:] = self.network.flat

    def renew_actor(self) -> None:
        """Copy the network as it is now to the actor, which plays the next round."""
        self.actor.flat[:] = self.network.flat
