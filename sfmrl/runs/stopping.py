"""Turn Ctrl-C, SIGTERM and SIGHUP into a request to stop at the next checkpoint."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from sfmrl.runs.progress import Progress

SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@contextmanager
def held_back() -> Iterator[None]:
    """Block these signals until the end of the block, also in processes that are started in it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Interrupted(Exception):
    """A training was asked to stop and has kept all it needs to go on; its text says how."""


class StopSignal:
    """Turns the first Ctrl-C, SIGTERM or SIGHUP into a request that a training looks for; the second acts at once."""

    def __init__(self, say: Callable[[str], None] = lambda text: None) -> None:
        self.requested = False
        self._say = say

    def __enter__(self) -> "StopSignal":
        heard = [number for number in SIGNALS if signal.getsignal(number) != signal.SIG_IGN]  # nohup's stays ignored
        self._before = {number: signal.signal(number, self._note) for number in heard}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: object) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        with suppress(OSError):  # a terminal that has gone cannot be written to
            self._say("stopping at the next checkpoint; interrupt again to stop at once")

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
