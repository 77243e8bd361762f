"""Ctrl-C and SIGTERM as requests: a training ends where all is kept."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from sfmrl.progress import Progress


class Interrupted(Exception):
    """A training was asked to stop and has kept all it needs to go on."""


class StopSignal:
    """Turns the first Ctrl-C or SIGTERM into a request that a training looks for; the second acts at once."""

    def __init__(self, say: Callable[[str], None] = lambda text: None) -> None:
        self.requested = False
        self._say = say

    def __enter__(self) -> "StopSignal":
        self._before = {number: signal.signal(number, self._note) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: object) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        self._say("stopping as soon as all is kept; once more stops at once")

    def watch(self, progress: Progress) -> Progress:
        """`progress` that raises Interrupted once a stop is requested, for work of which nothing need be kept."""

        @contextmanager
        def watched(title: str, total: int) -> Iterator[Callable[[int], None]]:
            with progress(title, total) as told:

                def tell(count: int) -> None:
                    told(count)
                    if self.requested:
                        raise Interrupted

                yield tell

        return watched
