"""A training on its way: the networks, the memory and the counters of deep V-learning, and a batch's step.

The target network gives the values that others bootstrap from, and is renewed at intervals.
"""

from typing import Any

import numpy as np

from sfmrl.config import Config
from sfmrl.fast import FastNetwork
from sfmrl.learning import OPTIMIZERS, forget, generator_state, learn, mean_loss, set_generator_state
from sfmrl.memory import Memory
from sfmrl.scenes import generator

PARTS = ("network", "actor", "target", "optimizer", "memory")
COUNTERS = ("episode", "batch", "failed", "rows", "validations")


class Learner:
    """All that has to be kept to go on to the same bits after an interruption."""

    def __init__(self, network: FastNetwork, memory: Memory, config: Config) -> None:
        self.config, self.memory, self.network = config, memory, network
        self.target = network.copy()
        # What explores: the network itself, or what it was before the batches that are being learnt meanwhile.
        self.actor = network.copy() if config.reinforcement.parallel > 1 else network
        self.optimizer = OPTIMIZERS[config.optimizer](network)
        self.rng = generator(config.seed, "batches")
        self.episode = self.batch = 0
        self.failed: list[list[int]] = []  # scenes in which the robot failed at its last try, and the episode after it
        self.rows: list[dict[str, Any]] = []
        self.validations: list[dict[str, Any]] = []

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
