"""Gradient descent on stored values, which imitation and reinforcement learning share.

The loss is the mean squared error between the network's value of a state and the stored one, as in CrowdNav. `Memory`
is the replay memory, `Fit` a network on its way through the epochs of imitation, and `Learner` one on its way through
the episodes of deep V-learning.
"""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sfmrl.config import Config, ConfigError, Imitation, Reinforcement
from sfmrl.fast import FastNetwork
from sfmrl.fast.optimizers import OPTIMIZERS, SGD, forget
from sfmrl.scenes import generator
from sfmrl.states import OWN, column_names, mirrored_columns

PARTS = ("network", "actor", "target", "average", "optimizer", "memory")
COUNTERS = ("episode", "batch", "failed", "rows", "validations")


class Memory:
    """At most `capacity` states (K, F) with a value each; those of fewer elements are filled up with absent ones.

    With `mirror`, every other state that is taken out is mirrored left to right: it is worth as much.
    """

    def __init__(self, capacity: int, elements: int, *, forces: bool = False, mirror: bool = False) -> None:
        columns, own = len(column_names(forces)), len(OWN) + 2 * forces
        self.mirror = mirrored_columns(forces) if mirror else None
        self.states = np.empty((capacity, elements, columns), dtype=np.float32)
        self.values = np.empty(capacity, dtype=np.float32)
        self.own = own  # the columns from here on are the element's, and NaN where it is absent
        self.size = self.next = 0

    def __len__(self) -> int:
        return self.size

    def push(self, states: np.ndarray, values: np.ndarray) -> None:
        """Add states (S, k, F) with k <= K, and their values (S,), in order."""
        capacity, elements = self.states.shape[:2]
        states, values = states[-capacity:], values[-capacity:]
        where = (self.next + np.arange(len(states))) % capacity
        present = states.shape[1]
        self.states[where, :present] = states
        if present < elements:
            self.states[where, present:, : self.own] = states[:, :1, : self.own]
            self.states[where, present:, self.own :] = np.nan
        self.values[where] = values
        self.next = int((self.next + len(states)) % capacity)
        self.size = min(self.size + len(states), capacity)

    def take(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The states (B, K, F) and values (B,) at some indices."""
        states = self.states[rows]
        if self.mirror is not None:
            states[::2] *= self.mirror
        return states, self.values[rows]

    def state_dict(self) -> dict[str, Any]:
        """All that is stored, for a checkpoint."""
        return {"states": self.states[: self.size], "values": self.values[: self.size], "next": self.next}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Take back what `state_dict` gave."""
        self.size, self.next = len(saved["values"]), saved["next"]
        self.states[: self.size], self.values[: self.size] = saved["states"], saved["values"]


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


class Learner:
    """All that has to be kept to go on to the same bits after an interruption."""

    def __init__(self, network: FastNetwork, memory: Memory, config: Config) -> None:
        self.config, self.memory, self.network = config, memory, network
        self.target = network.copy()
        self.average = network.copy()  # of the network over the last batches (Polyak and Juditsky, 1992)
        # What explores: the network itself, or what it was before the batches that are being learnt meanwhile.
        self.actor = network.copy() if config.reinforcement.parallel > 1 else network
        self.optimizer = OPTIMIZERS[config.optimizer](network)
        self.rng = generator(config.seed, "batches")
        self.episode = self.batch = 0
        self.failed: list[list[int]] = []  # scenes in which the robot failed at its last try, and the episode after it
        self.rows: list[dict[str, Any]] = []
        self.validations: list[dict[str, Any]] = []

    @property
    def tested(self) -> FastNetwork:
        """The network that validation and test use."""
        return self.average if self.config.reinforcement.average else self.network

    def learn(self, batches: int) -> float:
        """So many batches of gradient descent on what is stored; returns their mean loss (NaN without any)."""
        settings = self.config.reinforcement
        if not len(self.memory):
            return float("nan")
        losses = []
        forget(self.optimizer)
        stored, size = len(self.memory), min(settings.batch_size, len(self.memory))
        # All draws in a row: between batches, each would take eight times as long, out of the processor's cache.
        for rows in [self.rng.choice(stored, size, replace=False) for _ in range(batches)]:
            progress = self.batch / max(settings.episodes * settings.batches, 1)
            rate = self.optimizer.rate(settings.learning_rate, progress)
            losses.append(learn(self.network, self.optimizer, rate, *self.memory.take(rows)))
            if settings.average:
                self.average.flat += np.float32(1 / settings.average) * (self.network.flat - self.average.flat)
            self.batch += 1
        return mean_loss(losses, self.optimizer, settings) if losses else float("nan")

    def advance(self, episodes: int) -> None:
        """So many more episodes have been learnt from: renew the target network where its interval has passed."""
        interval = self.config.reinforcement.target_interval
        renew = self.episode // interval < (self.episode + episodes) // interval
        self.episode += episodes
        if renew:
            self.target.flat[:] = self.network.flat

    def scenes_for(self, episodes: range) -> list[int]:
        """The scenes in which to play the next episodes: their own or, in up to half of them, where it has failed.

        Only failures that it has learnt from count, and not those of the round before, which is being learnt meanwhile.
        """
        learnt = [scene for scene, after in self.failed if after < episodes.start]
        again = learnt[: len(episodes) // 2] if self.config.reinforcement.retry else []
        return [*again, *episodes[len(again) :]]

    def note_failures(self, scenes: np.ndarray, outcome: np.ndarray) -> None:
        """Keep the numbers of the scenes (E,) whose episodes had another outcome (E,) than success, oldest first."""
        tried, following = set(scenes.tolist()), self.episode + len(scenes)
        self.failed = [pair for pair in self.failed if pair[0] not in tried]
        self.failed += [[scene, following] for scene in scenes[outcome != "success"].tolist()]

    def renew_actor(self) -> None:
        """Let the next episodes be played with the network as it is now."""
        self.actor.flat[:] = self.network.flat

    def state_dict(self) -> dict[str, Any]:
        """All that decides how the training goes on."""
        parts = {name: getattr(self, name).state_dict() for name in PARTS}
        counters = {name: getattr(self, name) for name in COUNTERS}
        return parts | counters | {"rng": generator_state(self.rng)}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Take back what `state_dict` gave."""
        for name in PARTS:
            getattr(self, name).load_state_dict(saved[name])
        for name in COUNTERS:
            setattr(self, name, saved[name])
        set_generator_state(self.rng, saved["rng"])


def generator_state(rng: np.random.Generator) -> str:
    """A generator's state as text."""
    return json.dumps(rng.bit_generator.state)


def set_generator_state(rng: np.random.Generator, state: str) -> None:
    """Put a generator into a state that `generator_state` gave."""
    rng.bit_generator.state = json.loads(state)
