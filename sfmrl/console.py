"""What the commands print: results as tables on standard output, messages on standard error."""

import os
import shlex
import sys
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sfmrl.config import ConfigError

WIDTH = 80  # columns of the metrics' table, at least


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """The reader of a pipe has seen enough: that is no failure."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(0)


out = _Console(highlight=False)
err = _Console(stderr=True, highlight=False)


def say(text: str) -> None:
    """A line on standard error."""
    err.print(text, markup=False, soft_wrap=True)


def say_result(text: str) -> None:
    """Lines on standard output, as they are."""
    out.print(text, markup=False, soft_wrap=True)


def say_finding(finding: Any) -> None:
    """Print a `lessons.Finding` on standard output, and what helps unless all is well.

    A line each where a program reads it; in a terminal, long ones are broken within their column.
    """
    word, style = {True: ("ok", "green"), False: ("not ok", "bold red"), None: ("-", "dim")}[finding.ok]
    said = f"{finding.said}; {finding.remedy}" if finding.remedy and not finding.ok else finding.said
    if not out.is_terminal:
        say_result(f"{word:7}{finding.what:15} {said}")
        return
    table = Table.grid(padding=(0, 1, 0, 0))
    for width in (6, 15, None):
        table.add_column(width=width)
    table.add_row(Text(word, style), Text(finding.what, "bold"), Text(said))
    out.print(table)


def replay_command(
    policy: str | None,
    place: tuple[str, Any] | None,
    seed: int,
    episode: int,
    settings: dict[str, Any],
    versus: str | None = None,
    trust_reward: bool = False,
) -> str:
    """What to type to see a test episode; `place` is --environment or --map and its value, None if the policy's."""
    words = ["sfmrl", "ascii-render", *([policy] if policy else []), *(["--versus", versus] if versus else [])]
    words += [*(place or ()), "--seed", seed, "--episode", episode, *as_options(settings)]
    words += ["--trust-reward"] if trust_reward else []
    return shlex.join(map(str, words))


def as_options(settings: dict[str, Any]) -> list[str]:
    """Settings, nested as `config.override` takes them, as the words to type."""
    words = []
    for name, value in settings.items():
        flag = name.replace("_", "-")
        if isinstance(value, dict):
            words += as_options(value)
        elif isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            words += [f"--{flag}", str(value)]
    return words


def print_metrics(result: dict[str, Any], title: str) -> None:
    """Metrics as a table: a row in all, and one for each environment."""
    if "recovered" in result:
        title += f", with recovery (stuck in {result['recovered']:.3f} of the episodes)"
    table = Table(title=Text(title), title_justify="left")
    for heading in ("", "success", "collision", "time-out", "nav. time", "total reward", "episodes"):
        table.add_column(heading, justify="right" if heading else "left")
    rows = {"all": result, **{f"env. {name}": row for name, row in result.get("environments", {}).items()}}
    if len(rows) > 7:  # as of maps, whose names are longer, too
        _print_many({name.removeprefix("env. map-"): row for name, row in rows.items()}, title)
        return
    for name, row in rows.items():
        rates = [f"{row[rate]:.3f} [dim]{low:.2f}-{high:.2f}[/dim]" for rate, (low, high) in row["intervals"].items()]
        table.add_row(name, *rates, *_rest(row))
    print_table(table)


def _print_many(rows: dict[str, dict[str, Any]], title: str) -> None:
    """Print a line a row, with the interval of success alone."""
    from sfmrl.study.sheets import plain_table

    heads = ("", "success", "95 %", "collision", "time-out", "nav. time", "total\nreward")
    table = plain_table(*heads, gap=1, title=title)
    for name, row in rows.items():
        low, high = row["intervals"]["success"]
        interval = f"[dim]{low:.2f}-{high:.2f}[/dim]"
        rates = [f"{row[rate]:.3f}" for rate in ("success", "collision", "timeout")]
        table.add_row(name, rates[0], interval, *rates[1:], *_rest(row)[:2])
    print_table(table)


def _rest(row: dict[str, Any]) -> tuple[str, str, str]:
    """What follows the rates: navigation time, total reward, episodes."""
    time = "-" if row["navigation_time"] is None else f"{row['navigation_time']:.2f} s"
    return time, f"{row['total_reward']:.4f}", str(row["episodes"])


def print_table(table: Table) -> None:
    """Print a table; in a narrow terminal its lines wrap, but no number is cut."""
    out.print(table, width=max(out.width, WIDTH), crop=False)


def print_sheet(sheet: Any) -> None:
    """A `reports.Sheet` as a table under its title, and an empty line."""
    out.print(Text(sheet.title, "italic"))
    print_table(sheet.table())
    out.print()


def new_file(path: Path | None, flag: str, overwrite: bool) -> None:
    """Raises ConfigError where a file that an option names cannot be written, or is there already."""
    if path is None:
        return
    if path.exists() and not path.is_file():
        what = "a folder" if path.is_dir() else "not a regular file"
        raise ConfigError(f"--{flag} {path} is {what}; name a file")
    if path.exists() and not overwrite:
        raise ConfigError(f"{path} is there already; name another --{flag}, or replace it with --overwrite")
    if not path.parent.is_dir():
        raise ConfigError(f"there is no folder {path.parent} for --{flag} {path.name}")
    if not os.access(path.parent, os.W_OK):
        raise ConfigError(f"nothing can be written to folder {path.parent}; name another --{flag}")
