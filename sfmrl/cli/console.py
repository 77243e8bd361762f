"""What the commands print: results as tables on standard output, messages on standard error."""

import json
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Column, Table
from rich.text import Text

from sfmrl.config import ConfigError
from sfmrl.runs.files import regular, write_text

WIDTH = 80  # columns of a table, at least
WIDEST = 10_000  # and at most
CUT = "…"  # what Rich puts at the end of a cell that has no room
ROWS_WITH_INTERVALS = 7  # of metrics; more rows have a line each
# Names of files, and what is in them, can hold characters that a terminal would obey: controls, and marks that reverse
# the direction of writing.
OBEYED = (*range(9), *range(11, 32), *range(127, 160), 0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A))
HARMLESS = dict.fromkeys(OBEYED, "\ufffd")


class _Console(Console):
    def render(self, *arguments: Any, **options: Any) -> Iterable[Segment]:
        """Render as Rich does, with a replacement character for each control character in a text."""
        for text, style, control in super().render(*arguments, **options):
            yield Segment(text if control else text.translate(HARMLESS), style, control)

    def on_broken_pipe(self) -> None:
        """Exit with 0 if standard output is a closed pipe; go on without messages if standard error is."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), (sys.stderr if self.stderr else sys.stdout).fileno())
        if not self.stderr:
            raise typer.Exit(0)


out = _Console(highlight=False, emoji=False)
err = _Console(stderr=True, highlight=False, emoji=False)


def say(text: str) -> None:
    """Print a line on standard error."""
    err.print(text, markup=False, soft_wrap=True)


def say_result(text: str) -> None:
    """Print lines on standard output, as they are."""
    out.print(text, markup=False, soft_wrap=True)


def say_json(content: Any) -> None:
    """Print JSON on standard output."""
    say_result(json.dumps(content, indent=2))


def one_line(text: Any) -> str:
    """Return a text without line breaks, so that it cannot look like several lines of output."""
    return " ".join(str(text).splitlines())


def say_finding(finding: Any) -> None:
    """Print a `lessons.Finding` as a line on standard output, with the remedy unless all is well."""
    word, style = {True: ("ok", "green"), False: ("not ok", "bold red"), None: ("-", "dim")}[finding.ok]
    said = one_line(f"{finding.said}; {finding.remedy}" if finding.remedy and not finding.ok else finding.said)
    out.print(Text.assemble((f"{word:7}", style), (f"{one_line(finding.what):15} ", "bold"), said), soft_wrap=True)


def print_metrics(result: dict[str, Any], title: str) -> None:
    """Print metrics as a table: a row in all, and one for each environment."""
    if "recovered" in result:
        title += f", with recovery (stuck in {result['recovered']:.3f} of the episodes)"
    rows = {"all": result, **{f"env. {name}": row for name, row in result.get("environments", {}).items()}}
    table = _table_of_many(rows, title) if len(rows) > ROWS_WITH_INTERVALS else _metrics_table(rows, title)
    print_table(table)


def print_social(values: dict[str, float | None]) -> None:
    """Print social metrics as a table: name, value, and what it is."""
    from sfmrl.study.social import SOCIAL_METRICS

    table = Table("metric", Column("value", justify="right"), "what it is", box=SIMPLE_HEAD)
    for name, value in values.items():
        table.add_row(name, "-" if value is None else f"{value:.3f}", SOCIAL_METRICS[name])
    print_table(table)


def _metrics_table(rows: dict[str, dict[str, Any]], title: str) -> Table:
    """Return metrics with the interval of each rate."""
    table = Table(title=Text(title), title_justify="left")
    for heading in ("", "success", "collision", "time-out", "nav. time", "total reward", "episodes"):
        table.add_column(heading, justify="right" if heading else "left")
    for name, row in rows.items():
        rates = [f"{row[rate]:.3f} [dim]{low:.2f}-{high:.2f}[/dim]" for rate, (low, high) in row["intervals"].items()]
        table.add_row(name, *rates, _seconds(row), f"{row['total_reward']:.4f}", str(row["episodes"]))
    return table


def _table_of_many(rows: dict[str, dict[str, Any]], title: str) -> Table:
    """Return metrics of many rows, such as the maps, in one line per row, with the interval of success only."""
    from sfmrl.study.sheets import plain_table

    heads = ("", "success", "95 %", "collision", "time-out", "nav. time", "total\nreward")
    table = plain_table(*heads, gap=1, title=title)
    for name, row in rows.items():
        low, high = row["intervals"]["success"]
        success, *others = (f"{row[rate]:.3f}" for rate in ("success", "collision", "timeout"))
        cells = (success, f"[dim]{low:.2f}-{high:.2f}[/dim]", *others, _seconds(row), f"{row['total_reward']:.4f}")
        table.add_row(name.removeprefix("env. map-"), *cells)
    return table


def _seconds(row: dict[str, Any]) -> str:
    return "-" if row["navigation_time"] is None else f"{row['navigation_time']:.2f} s"


def print_table(table: Table) -> None:
    """Print a table, wider than the terminal where Rich would cut off a cell: then its lines wrap."""
    # Not `out`, which prints no table wider than the terminal.
    wide = _Console(highlight=False, emoji=False, width=max(out.width, WIDTH))
    if any(CUT in segment.text for segment in wide.render(table)):
        wide.width = Measurement.get(wide, wide.options.update_width(WIDEST), table).maximum
    wide.print(table, crop=False)


def print_sheet(sheet: Any) -> None:
    """Print a `sheets.Sheet` as a table under its title, and an empty line."""
    out.print(Text(sheet.title, "italic"))
    print_table(sheet.table())
    out.print()


def check_new_files(overwrite: bool, **paths: Path | None) -> None:
    """Check the files that options name; None is an option that is not given.

    Raises ConfigError or DamagedFile if one cannot be written, exists and `overwrite` is False, or is named twice.
    """
    named: dict[Path, str] = {}
    for flag, path in ((flag, path) for flag, path in paths.items() if path):
        if regular(path).exists() and not overwrite:
            raise ConfigError(f"{path} already exists; name another --{flag}, or replace it with --overwrite")
        folder = Path(os.path.realpath(path) if path.is_symlink() else path).parent
        if not folder.is_dir():
            raise ConfigError(f"there is no folder {folder} for --{flag}; make it, or name another --{flag}")
        if not os.access(folder, os.W_OK):
            raise ConfigError(f"cannot write to folder {folder}; name another --{flag}")
        if (other := named.setdefault(Path(os.path.realpath(path)), flag)) != flag:
            raise ConfigError(f"--{other} and --{flag} name the same file; each needs its own")


@contextmanager
def saving(text: str, path: Path | None) -> Iterator[None]:
    """Write a text to a file, if one is given, after the block, which prints the result.

    So the result is printed even if the disk is full, and the file is written even if a reader (head) stops early.
    """
    try:
        yield
    finally:
        if path:
            write_text(path, text)
