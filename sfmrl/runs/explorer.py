"""Play training episodes on a second process while the network learns from the previous ones."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from functools import cache, partial
from multiprocessing.process import BaseProcess
from threading import Thread
from typing import cast

import numpy as np

from sfmrl.config import Config
from sfmrl.exploration import Explored, explore
from sfmrl.fast import FastNetwork, Sizes, new_network
from sfmrl.lookahead import SarlPolicy
from sfmrl.own_code.trust import check_unchanged
from sfmrl.runs.progress import SIGNALS, held_back


class Explorer:
    """Plays training episodes with a network, on a second process if `aside`; a context manager.

    Threads would not do: the network's operations are many and small, and between them, threads of one process wait for
    each other. If the second process is killed, this one plays. `own_reward` is the SHA-256 of the user's own reward.
    """

    def __init__(
        self, config: Config, threads: int, aside: bool, sizes: Sizes = Sizes(), own_reward: str | None = None
    ) -> None:
        self._setup, self._own_reward = (config, threads, sizes), own_reward
        self._pool = None
        if aside:
            spawn = multiprocessing.get_context("spawn")  # a fork would inherit locks that threads hold
            self._pool = ProcessPoolExecutor(1, spawn, _prepare)
            with held_back():  # the new process inherits this, so no signal interrupts its imports
                self._pool.submit(_warm_up, *self._setup)

    def __enter__(self) -> "Explorer":
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool:
            self._pool.shutdown(cancel_futures=True)

    def start(self, actor: FastNetwork, episodes: Sequence[int]) -> Callable[[], Explored]:
        """Start to `explore` the episodes with the network `actor`; returns a function that waits for the result.

        Without a second process, that function plays, with the actor as it is then. With one, the actor must not change
        before that function returns.
        """
        work = partial(_explore, *self._setup, self._own_reward, actor.flat, episodes)
        future = None
        if self._pool:
            with suppress(BrokenProcessPool):
                future = self._pool.submit(work)

        def outcome() -> Explored:
            with suppress(BrokenProcessPool):
                if future:
                    return future.result()
            return work()

        return outcome


def _prepare() -> None:
    """Set up the second process: it ignores signals, which the parent handles, and ends when the parent ends."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    parent = cast(BaseProcess, multiprocessing.parent_process())  # only the first process has none

    def end_with_it() -> None:
        parent.join()
        os._exit(1)

    Thread(target=end_with_it, daemon=True).start()


@cache
def _policy(config: Config, threads: int, sizes: Sizes) -> SarlPolicy:
    return SarlPolicy(new_network(config, sizes=sizes), config, threads)


def _warm_up(config: Config, threads: int, sizes: Sizes) -> None:
    """Import and allocate before the first episode is due; returns nothing, since a result would be sent back."""
    _policy(config, threads, sizes)


def _explore(
    config: Config, threads: int, sizes: Sizes, own_reward: str | None, weights: np.ndarray, episodes: Sequence[int]
) -> Explored:
    policy = _policy(config, threads, sizes)
    policy.network.flat[:] = weights
    explored = explore(policy, config, episodes)  # which loads the user's own reward
    check_unchanged(config.reward.reward, own_reward)
    return explored
