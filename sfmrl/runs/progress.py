"""How far along: a bar with rate and time left in a terminal, plain lines elsewhere, always on standard error."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

# From a title and a total to a context, whose value is called with a count to say "so many more".
Progress = Callable[[str, int], AbstractContextManager[Callable[[int], None]]]

QUIET = 2.0  # seconds of work about which nothing is said where there is no terminal
LINE_EVERY = 10.0  # seconds between plain lines


@contextmanager
def no_progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """Say nothing."""
    yield lambda count: None


def show_progress(console: Console) -> Progress:
    """Show progress on `console` (standard error): a bar if it is a terminal, else a line every ten seconds."""
    return _bar(console) if console.is_terminal and not console.is_dumb_terminal else _lines(console)


def _bar(console: Console) -> Progress:
    @contextmanager
    def progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
        )
        with Bar(*columns, console=console, transient=True, expand=True) as bar:
            task = bar.add_task(title, total=total, rate="")
            start = time.monotonic()

            def told(count: int) -> None:
                bar.advance(task, count)
                done = bar.tasks[0].completed
                bar.update(task, rate=rate_text(done, time.monotonic() - start))

            yield told

    return progress


def _lines(console: Console) -> Progress:
    @contextmanager
    def progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
        start = said = time.monotonic()
        done = 0

        def told(count: int) -> None:
            nonlocal done, said
            done += count
            now = time.monotonic()
            if now - said >= (LINE_EVERY if said > start else QUIET):
                said = now
                left = (total - done) * (now - start) / max(done, 1)
                text = f"{title}: {done} of {total}, {rate_text(done, now - start)}, {left:.0f} s left"
                console.print(text, highlight=False, soft_wrap=True)

        yield told

    return progress


def rate_text(done: float, seconds: float) -> str:
    """So many a second, for people."""
    rate = done / max(seconds, 1e-9)
    return f"{rate:.0f}/s" if rate >= 10 else f"{rate:.1f}/s"
