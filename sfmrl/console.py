"""What the commands print: results as tables on standard output, messages on standard error."""

import os
import shlex
import sys
from typing import Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

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


def replay_command(policy: str | None, environment: str, seed: int, episode: int, settings: dict[str, Any]) -> str:
    """What to type to see a test episode."""
    words = [
        "sfmrl ascii-render",
        shlex.quote(policy) if policy else "",
        f"--environment {environment} --seed {seed} --episode {episode}",
    ]
    for section in settings.values():
        words += [
            f"--{name.replace('_', '-')} {value}" for name, value in section.items() if not isinstance(value, bool)
        ]
        words += [
            f"--{'' if on else 'no-'}{name.replace('_', '-')}" for name, on in section.items() if isinstance(on, bool)
        ]
    return " ".join(word for word in words if word)


def print_metrics(result: dict[str, Any], title: str) -> None:
    """Metrics as a table: a row in all, and one for each environment."""
    if "recovered" in result:
        title += f", with recovery (stuck in {result['recovered']:.3f} of the episodes)"
    table = Table(title=Text(title), title_justify="left")
    for heading in ("", "success", "collision", "time-out", "nav. time", "total reward", "episodes"):
        table.add_column(heading, justify="right" if heading else "left")
    rows = {"all": result, **{f"env. {name}": row for name, row in result.get("environments", {}).items()}}
    for name, row in rows.items():
        rates = [f"{row[rate]:.3f} [dim]{low:.2f}-{high:.2f}[/dim]" for rate, (low, high) in row["intervals"].items()]
        time = "-" if row["navigation_time"] is None else f"{row['navigation_time']:.2f} s"
        table.add_row(name, *rates, time, f"{row['total_reward']:.4f}", str(row["episodes"]))
    out.print(table, width=max(out.width, WIDTH), crop=False)  # in a narrow terminal lines wrap, but no number is cut
