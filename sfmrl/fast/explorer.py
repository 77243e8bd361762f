"""Training episodes played on a process of their own, while the last ones are learnt from."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import cache, partial
from threading import Thread

import numpy as np

from sfmrl.config import Config
from sfmrl.exploration import Explored, explore
from sfmrl.fast import FastNetwork, Sizes, new_network
from sfmrl.lookahead import SarlPolicy
from sfmrl.runs.progress import SIGNALS, held_back


class Explorer:
    """Plays training episodes with a network, on a process of its own if `aside`; a context manager.

    Two threads of one process would wait for each other between the network's many operations. Should the process be
    killed, its work is done here.
    """

    def __init__(self, config: Config, threads: int, aside: bool, sizes: Sizes = Sizes()) -> None:
        self._config, self._threads = config, threads
        self._pool = self._policy = None
        if aside:
            spawn = multiprocessing.get_context("spawn")  # a fork would inherit threads in the middle of work
            self._pool = ProcessPoolExecutor(1, spawn, _prepare)
            with held_back():  # what the new process inherits: its imports are not interrupted
                self._pool.submit(_policy, config, threads, sizes)  # all that takes time before the first episode

    def __enter__(self) -> "Explorer":
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool:
            self._pool.shutdown(cancel_futures=True)

    def start(self, actor: FastNetwork, *what: Sequence[int]) -> Callable[[], Explored]:
        """Begin to `explore` the episodes and scenes `what`, and return a function that waits for the outcome.

        Without a process aside, that function does the work. The actor must stay as it is until then.
        """
        here = partial(self._explore, actor, *what)
        if self._pool is None:
            return here
        weights = actor.flat.copy()
        try:
            future = self._pool.submit(_explore_aside, weights, actor.sizes, self._config, self._threads, *what)
        except BrokenProcessPool:
            self._pool = None
            return here

        def outcome() -> Explored:
            try:
                return future.result()
            except BrokenProcessPool:
                self._pool = None
                return here()

        return outcome

    def _explore(self, actor: FastNetwork, *what: Sequence[int]) -> Explored:
        if self._policy is None or self._policy.network is not actor:
            self._policy = SarlPolicy(actor, self._config, self._threads)
        return explore(self._policy, self._config, *what)


def _prepare() -> None:
    """Leave signals to the process that asked for this one, and end with it."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


@cache
def _policy(config: Config, threads: int, sizes: Sizes) -> SarlPolicy:
    return SarlPolicy(new_network(config, sizes=sizes), config, threads)


def _explore_aside(weights: np.ndarray, sizes: Sizes, config: Config, threads: int, *what: Sequence[int]) -> Explored:
    policy = _policy(config, threads, sizes)
    policy.network.flat[:] = weights
    return explore(policy, config, *what)
