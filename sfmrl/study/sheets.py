"""Present results as sheets of texts, for the terminal and for Markdown, and a table's as lines for CSV."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import JustifyMethod
from rich.table import Table
from rich.text import Text

from sfmrl.study.statistics import CONTRASTED


@dataclass(frozen=True)
class Sheet:
    """A table of texts: lines, at least one, of cells by heading; the first column holds names."""

    title: str
    lines: list[dict[str, str]]

    def markdown(self) -> str:
        """Return the sheet as Markdown."""
        first, *others = self.lines[0]
        rows = [[first, *others], ["---"] + ["---:"] * len(others), *(line.values() for line in self.lines)]
        body = "\n".join(f"| {' | '.join(row)} |".replace("\n", " ") for row in rows)
        return f"{self.title}\n\n{body}\n"

    def table(self) -> Table:
        """Return the sheet, without its title, as a table for the terminal."""
        table = plain_table(*self.lines[0])
        for line in self.lines:
            table.add_row(*map(Text, line.values()))
        return table


def plain_table(*headings: str, first: JustifyMethod = "left", gap: int = 0, title: str | None = None) -> Table:
    """Return an empty table without an edge, its `first` column aligned as given and the others to the right.

    Columns are one space apart, and `gap` more.
    """
    above, air = None if title is None else Text(title), (0, gap, 0, 0)
    table = Table(title=above, title_justify="left", box=SIMPLE_HEAD, padding=air, pad_edge=False, show_edge=False)
    for number, heading in enumerate(headings):
        table.add_column(Text(heading), justify="right" if number else first, no_wrap=True)
    return table


def number(value: float | None, form: str = ".3f") -> str:
    """Write a number in a format; "-" for None."""
    return "-" if value is None else format(value, form)


def rate(value: float | None) -> str:
    """Write a rate with three digits and without a leading 0; "-" for None."""
    return re.sub(r"^(-?)0\.", r"\1.", number(value))


seconds, whole = partial(number, form=".2f"), partial(number, form=".0f")


def p_value(p: float) -> str:
    """Write a p-value with three digits."""
    return "<.001" if p < 0.001 else rate(p)


def interval(figure: dict[str, Any], form: Callable[[float], str] = rate) -> str:
    """Write the ends of a difference's interval; "-" for none."""
    return "-" if figure["low"] is None else f"{form(figure['low'])} to {form(figure['high'])}"


def estimate(figure: dict[str, Any] | None, form: Callable[[float], str] = rate) -> str:
    """Write a difference with its interval in brackets; "-" for none."""
    return "-" if figure is None or figure["mean"] is None else f"{form(figure['mean'])} ({interval(figure, form)})"


def rate_interval(mean: float, low: float | None, high: float | None) -> str:
    """Write a rate with its interval, if there is one."""
    return rate(mean) if low is None else f"{rate(mean)} {rate(low)}-{rate(high)}"


def sheets(summary: list[dict[str, Any]], contrasts: list[dict[str, Any]], title: str) -> list[Sheet]:
    """Return a table's statistics as sheets of up to 80 columns: rates, seeds, training, differences, contrasts."""
    seeds = sorted({seed for row in summary for seed in row["seeds"]})
    unbroken = len(seeds) > 1 and seeds == list(range(seeds[0], seeds[-1] + 1))
    named = f"{seeds[0]}-{seeds[-1]}" if unbroken else ", ".join(map(str, seeds))
    course, training = _common([_course(row) for row in summary], ("episodes", "steps", "runs"))
    pages = {
        f"{title}; 95 % intervals over seeds (Student's t)": [_rates(row) for row in summary],
        "Success of every seed; Wilson: the 95 % interval of a network with the mean success, in whole episodes": [
            _points(row, seeds, named) for row in summary
        ],
        f"Time with time-outs as 25 s, without collisions; training until validation success 0.9{training}": course,
        "Differences from SARL, paired by seed": [_difference(row) for row in summary if row["difference"]],
        "Effect of each ingredient, averaged over the other, paired by seed (95 %)": [
            _contrast(metric, contrasts) for metric in CONTRASTED if contrasts
        ],
    }
    return [Sheet(heading, lines) for heading, lines in pages.items() if lines]


def _rates(row: dict[str, Any]) -> dict[str, str]:
    figures = row["figures"]
    mean = {name: figure["mean"] for name, figure in figures.items()}
    return {
        "row": row["row"],
        "paper": "/".join(rate(value).removesuffix("0") for value in row["paper"]["success"]),
        "success": rate_interval(*(figures["success"][end] for end in ("mean", "low", "high"))),
        "hit:\npeople +\nsquares": f"{rate(mean['human_collision'])}+{rate(mean['square_collision'])}",
        "time-out": rate(mean["timeout"]),
        "nav.\ntime": seconds(mean["navigation_time"]),
        "total\nreward": number(mean["total_reward"]),
        "the paper\nis": row["verdict"],
    }


def _points(row: dict[str, Any], seeds: list[int], named: str) -> dict[str, str]:
    success = row["figures"]["success"]
    of_seed = dict(zip(row["seeds"], success["values"], strict=True))
    return {
        "row": row["row"],
        "sd": rate(success["deviation"]),
        "Wilson": "-".join(map(rate, row["wilson_of_mean"])),
        f"seeds {named}": " ".join(rate(of_seed.get(seed)) for seed in seeds),
    }


def _course(row: dict[str, Any]) -> dict[str, str]:
    figures = row["figures"]
    episodes = figures["reached_episodes"]
    return {
        "row": row["row"],
        "time, s": seconds(figures["navigation_time_charged"]["mean"]),
        "episodes": whole(episodes["mean"]),
        "steps": number(figures["reached_steps"]["mean"], ",.0f"),
        "runs": f"{sum(value is not None for value in episodes['values'])} of {len(episodes['values'])}",
    }


def _common(lines: list[dict[str, str]], names: tuple[str, ...]) -> tuple[list[dict[str, str]], str]:
    """Return lines without those of the named columns that are equal in all, and what these hold, for the title.

    A column of "-" alone, which has nothing to say, stays.
    """
    cells = {name: {line[name] for line in lines} for name in names}
    equal = [name for name in names if len(lines) > 1 and len(cells[name]) == 1 and cells[name] != {"-"}]
    said = ", ".join(f"{lines[0][name]} {name}" for name in equal)
    others = [{name: cell for name, cell in line.items() if name not in equal} for line in lines]
    return others, f" (in every row: {said})" if said else ""


def _difference(row: dict[str, Any]) -> dict[str, str]:
    gap = row["difference"]
    p, p_holm = ("-" if gap["low"] is None else p_value(gap[name]) for name in ("p", "p_holm"))
    return {
        "row": row["row"],
        "success\nminus SARL's": rate(gap["mean"]),
        "95 %": interval(gap),
        "p": p,
        "p (Holm)": p_holm,
        "paper": rate(gap["paper"]),
        "the paper is": gap["verdict"],
    }


def _contrast(metric: str, contrasts: list[dict[str, Any]]) -> dict[str, str]:
    form = {"navigation_time": seconds, "reached_episodes": whole}.get(metric, rate)
    effects = {contrast["of"]: estimate(contrast, form) for contrast in contrasts if contrast["in"] == metric}
    return {"": CONTRASTED[metric]} | effects


def csv_rows(summary: list[dict[str, Any]], contrasts: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a line per figure of each seed, and one (seed "all") for the mean, its interval and the paper's."""
    lines = []

    def add(row: str, metric: str, seed: int | str, value: float | None, **more: Any) -> None:
        others = {name: more.get(name, "") for name in ("low", "high", "paper", "p_holm")}
        lines.append({"row": row, "metric": metric, "seed": seed, "value": value} | others)

    for row in summary:
        for metric, figure in row["figures"].items():
            paper = "/".join(map(str, row["paper"].get(metric, ())))
            add(row["row"], metric, "all", figure["mean"], **figure, paper=paper)
            for seed, value in zip(row["seeds"], figure["values"], strict=True):
                add(row["row"], metric, seed, value)
        rates = row["figures"]["success"]["values"]
        for seed, (low, high), value in zip(row["seeds"], row["wilson"], rates, strict=True):
            add(row["row"], "success_wilson", seed, value, low=low, high=high)
        if gap := row["difference"]:
            add(row["row"], "success_less_sarl", "all", gap["mean"], **gap)
    for contrast in contrasts:
        add(contrast["of"], f"{contrast['in']}_difference", "all", contrast["mean"], **contrast)
    return lines


def model_sheet(cards: dict[str, dict[str, Any]]) -> Sheet:
    """Return a sheet of model cards."""
    lines = [
        {
            "model": name,
            "preset": card["preset"],
            "seed": str(card["seed"]),
            "tested on": card["environment"],
            "success alone": rate_interval(card["alone"]["success"], *card["alone"]["interval"]),
            "with recovery": rate_interval(card["with_recovery"]["success"], *card["with_recovery"]["interval"]),
            "nav.\ntime": seconds(card["with_recovery"]["navigation_time"]),
        }
        for name, card in cards.items()
    ]
    return Sheet("Models that come with sfmrl; 95 % Wilson intervals; nav. time is with recovery", lines)


def card_lines(card: dict[str, Any], indent: str = "") -> list[str]:
    """Return a model card as lines of text."""
    lines = []
    for name, value in card.items():
        if isinstance(value, dict):
            lines += [f"{indent}{name}", *card_lines(value, indent + "  ")]
        elif isinstance(value, list) and isinstance(value[0], str):
            lines += [f"{indent}{name}", *(f"{indent}  {item}" for item in value)]
        elif isinstance(value, list):
            lines.append(f"{indent}{name} {' to '.join(f'{item:.4f}' for item in value)}")
        else:
            lines.append(f"{indent}{name} {f'{value:.4f}' if isinstance(value, float) else value}")
    return lines
