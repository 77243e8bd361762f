"""Play training episodes on a second process while the network learns from the previous ones."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from functools import partial
from multiprocessing.process import BaseProcess
from threading import Thread
from typing import cast

from sfmrl.config import Config
from sfmrl.exploration import Explored, explore
from sfmrl.fast import FastNetwork
from sfmrl.lookahead import SarlPolicy
from sfmrl.own_code.trust import check_unchanged
from sfmrl.runs.progress import SIGNALS, held_back


class Explorer:
    """Plays training episodes with a network, on a second process if `aside`; a context manager.

    Threads would not do: the network's operations are many and small, and between them, threads of one process wait for
    each other. If the second process is killed, this one plays. `own_reward` is the SHA-256 of the user's own reward.
    """

    def __init__(self, config: Config, threads: int, aside: bool, own_reward: str | None = None) -> None:
        self._setup = (config, threads, own_reward)
        self._pool = None
        if aside:
            spawn = multiprocessing.get_context("spawn")  # a fork would inherit locks that threads hold
            self._pool = ProcessPoolExecutor(1, spawn, _prepare)
            with held_back():  # the new process inherits this, so no signal interrupts its imports
                self._pool.submit(int)  # starts the process now: it imports all that `_explore` needs

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
        work = partial(_explore, *self._setup, actor, episodes)
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


def _explore(
    config: Config, threads: int, own_reward: str | None, actor: FastNetwork, episodes: Sequence[int]
) -> Explored:
    explored = explore(SarlPolicy(actor, config, threads), config, episodes)  # which loads the user's own reward
    check_unchanged(config.reward.reward, own_reward)
    return explored
