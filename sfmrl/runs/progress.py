"""Report the progress of long work on standard error, and stop it at the next checkpoint on Ctrl-C."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

# Takes a title and a total; returns a context manager for a function to call with the number of steps just done.
Progress = Callable[[str, int], AbstractContextManager[Callable[[int], None]]]

FIRST_LINE_AFTER = 2.0  # seconds
LINE_EVERY = 10.0  # seconds
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


class Interrupted(Exception):
    """A training has stopped on request, and can be resumed from its last checkpoint; the text says how."""


@contextmanager
def no_progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show nothing."""
    yield lambda count: None


def show_progress(console: Console) -> Progress:
    """Show progress on `console` (standard error): a bar if it is a terminal, otherwise a line every ten seconds."""
    live = console.file.isatty() and console.is_terminal and not console.is_dumb_terminal  # FORCE_COLOR makes no bar
    return partial(_bar if live else _lines, console)


@contextmanager
def _bar(console: Console, title: str, total: int) -> Iterator[Callable[[int], None]]:
    title_and_bar = TextColumn("{task.description}"), BarColumn(bar_width=None)
    columns = (*title_and_bar, MofNCompleteColumn(), TextColumn("{task.fields[rate]}"), TimeRemainingColumn())
    with Bar(*columns, console=console, transient=True, expand=True) as bar:
        task = bar.add_task(title, total=total, rate="")
        start = time.monotonic()

        def advance(count: int) -> None:
            bar.advance(task, count)
            bar.update(task, rate=_rate(bar.tasks[0].completed, time.monotonic() - start))

        yield advance


@contextmanager
def _lines(console: Console, title: str, total: int) -> Iterator[Callable[[int], None]]:
    start = printed = time.monotonic()
    done = 0

    def advance(count: int) -> None:
        nonlocal done, printed
        done += count
        now = time.monotonic()
        if now - printed >= (LINE_EVERY if printed > start else FIRST_LINE_AFTER):
            printed = now
            line = f"{title}: {done} of {total}"
            if done:  # else nothing is known about the rate
                line += f", {_rate(done, now - start)}, {(total - done) * (now - start) / done:.0f} s left"
            console.print(line, highlight=False, soft_wrap=True)

    yield advance


def _rate(done: float, seconds: float) -> str:
    rate = done / max(seconds, 1e-9)
    return f"{rate:.0f}/s" if rate >= 10 else f"{rate:.1f}/s"


class StopSignal:
    """Turn the first Ctrl-C, SIGTERM or SIGHUP into a request, which a training checks; a second acts at once."""

    def __init__(self, say: Callable[[str], None] = lambda text: None) -> None:
        self.requested = False
        self._say = say

    def __enter__(self) -> "StopSignal":
        caught = [number for number in SIGNALS if signal.getsignal(number) != signal.SIG_IGN]  # nohup ignores SIGHUP
        self._before = {number: signal.signal(number, self._request) for number in caught}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _request(self, number: int, frame: object) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        with suppress(OSError):  # the terminal may be closed
            self._say("stopping at the next checkpoint; interrupt again to stop at once")

    def check(self) -> None:
        """Raise Interrupted once a stop is requested."""
        if self.requested:
            raise Interrupted

    def watch(self, progress: Progress) -> Progress:
        """`progress` that checks for a stop at every step, for work of which nothing need be saved."""
        return partial(self._watched, progress)

    @contextmanager
    def _watched(self, progress: Progress, title: str, total: int) -> Iterator[Callable[[int], None]]:
        with progress(title, total) as advance:

            def advance_or_stop(count: int) -> None:
                advance(count)
                self.check()

            yield advance_or_stop


@contextmanager
def held_back() -> Iterator[None]:
    """Block SIGNALS until the end of the block; processes that are started in it inherit this."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
