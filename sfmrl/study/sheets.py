"""Present a table's findings: sheets for the terminal and for Markdown, lines for CSV."""

from dataclasses import dataclass
from functools import partial
from typing import Any

from sfmrl.study.statistics import CONTRASTED

PAPERS = ("success", "navigation_time", "total_reward")  # metrics that the paper reports under the same name


@dataclass(frozen=True)
class Sheet:
    """A table of texts; the first column holds names."""

    title: str
    headings: tuple[str, ...]
    rows: list[tuple[str, ...]]

    def markdown(self) -> str:
        """Return the sheet as Markdown."""
        lines = [self.headings, ("---",) + ("---:",) * (len(self.headings) - 1), *self.rows]
        body = "\n".join(f"| {' | '.join(line)} |".replace("\n", " ") for line in lines)
        return f"{self.title}\n\n{body}\n"


def sheets(found: list[dict[str, Any]], contrasts: list[dict[str, Any]], title: str) -> list[Sheet]:
    """Return the findings as sheets of up to 80 columns: rates, seeds, training, differences from SARL, contrasts."""
    made = [
        Sheet(
            f"{title}; 95 % intervals over seeds (Student's t)",
            (
                "row",
                "paper",
                "success",
                "people +\nsquares",
                "time-out",
                "nav.\ntime",
                "total\nreward",
                "the paper\nis",
            ),
            [_rates(row) for row in found],
        ),
        Sheet(
            "Success of every seed; Wilson: the 95 % interval of one network over test episodes",
            ("row", "sd", "Wilson", "seeds " + _seeds(found)),
            [_points(row) for row in found],
        ),
        Sheet(
            "Weights of the best validation; time with time-outs as 25 s; training until validation success 0.9",
            ("row", "best", "time, s", "episodes", "steps", "runs"),
            [_course(row) for row in found],
        ),
    ]
    compared = [row for row in found if row["difference"]]
    if compared:
        heads = ("row", "success\nless SARL's", "95 %", "p", "p (Holm)", "paper", "the paper is")
        made.append(Sheet("Differences from SARL, paired by seed", heads, [_difference(row) for row in compared]))
    if contrasts:
        names = tuple(dict.fromkeys(contrast["of"] for contrast in contrasts))
        changes = [_contrast(metric, contrasts) for metric in CONTRASTED]
        made.append(
            Sheet("Effect of each ingredient, with and without the other, paired by seed", ("", *names), changes)
        )
    return made


def _seeds(found: list[dict[str, Any]]) -> str:
    every = sorted({seed for row in found for seed in row["seeds"]})
    runs = every == list(range(every[0], every[-1] + 1))
    return f"{every[0]}-{every[-1]}" if runs and len(every) > 1 else ", ".join(map(str, every))


def rate(value: float | None) -> str:
    """Write a rate with three digits and without a leading 0."""
    if value is None:
        return "-"
    text = f"{value:.3f}"
    return text[1:] if text.startswith("0") else "-" + text[2:] if text.startswith("-0") else text


def p_value(p: float) -> str:
    """Write a p-value with three digits."""
    return "<.001" if p < 0.001 else rate(p)


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


seconds = partial(_number, form=".2f")


def between(low: float | None, high: float | None, form: Any = rate) -> str:
    """Write an interval's ends by `form`, or "-" for none."""
    return "-" if low is None else f"{form(low)} to {form(high)}"


def estimate(figure: dict[str, Any] | None, form: Any = rate) -> str:
    """Write a difference by `form`, with its interval in brackets; "-" for none."""
    return "-" if figure is None else f"{form(figure['mean'])} ({between(figure['low'], figure['high'], form)})"


def _with_interval(figure: dict[str, Any]) -> str:
    interval = "" if figure["low"] is None else f" {rate(figure['low'])}-{rate(figure['high'])}"
    return rate(figure["mean"]) + interval


def _rates(row: dict[str, Any]) -> tuple[str, ...]:
    mean = {name: figure["mean"] for name, figure in row["figures"].items()}
    success = row["figures"]["success"]
    return (
        row["row"],
        "/".join(rate(value).removesuffix("0") for value in row["paper"]["success"]),
        _with_interval(success),
        f"{rate(mean['human_collision'])}+{rate(mean['square_collision'])}",
        rate(mean["timeout"]),
        seconds(mean["navigation_time"]),
        _number(mean["total_reward"], ".3f"),
        row["verdict"],
    )


def _points(row: dict[str, Any]) -> tuple[str, ...]:
    low, high = row["wilson_of_mean"]
    success = row["figures"]["success"]
    return row["row"], rate(success["deviation"]), f"{rate(low)}-{rate(high)}", " ".join(map(rate, success["values"]))


def _course(row: dict[str, Any]) -> tuple[str, ...]:
    figures = row["figures"]
    best, episodes = figures["best_success"], figures["reached_episodes"]
    return (
        row["row"],
        _with_interval(best),
        seconds(figures["navigation_time_charged"]["mean"]),
        _number(episodes["mean"], ".0f"),
        _number(figures["reached_steps"]["mean"], ",.0f"),
        f"{sum(value is not None for value in episodes['values'])} of {len(episodes['values'])}",
    )


def _difference(row: dict[str, Any]) -> tuple[str, ...]:
    found = row["difference"]
    sure = (p_value(found["p"]), p_value(found["p_holm"])) if found["low"] is not None else ("-", "-")
    numbers = rate(found["mean"]), between(found["low"], found["high"]), *sure
    return row["row"], *numbers, rate(found["paper"]), found["verdict"]


def _contrast(metric: str, contrasts: list[dict[str, Any]]) -> tuple[str, ...]:
    form = {"navigation_time": seconds, "reached_episodes": partial(_number, form=".0f")}.get(metric, rate)
    found = [c for c in contrasts if c["in"] == metric]
    return CONTRASTED[metric], *(estimate(contrast, form) for contrast in found)


def csv_rows(found: list[dict[str, Any]], contrasts: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a line per figure of each seed, and one (seed "all") for the mean, its interval and the paper's."""
    lines = []

    def line(row: str, metric: str, seed: Any, value: Any, **more: Any) -> None:
        empty = dict.fromkeys(("low", "high", "paper", "p_holm"), "")
        lines.append({"row": row, "metric": metric, "seed": seed, "value": value} | empty | more)

    for row in found:
        for metric, figure in row["figures"].items():
            paper = "/".join(map(str, row["paper"][metric])) if metric in PAPERS else ""
            line(row["row"], metric, "all", figure["mean"], low=figure["low"], high=figure["high"], paper=paper)
            for seed, value in zip(row["seeds"], figure["values"], strict=True):
                line(row["row"], metric, seed, value)
        for seed, (low, high), value in zip(
            row["seeds"], row["wilson"], row["figures"]["success"]["values"], strict=True
        ):
            line(row["row"], "success_wilson", seed, value, low=low, high=high)
        if row["difference"]:
            gap = {name: row["difference"][name] for name in ("low", "high", "paper", "p_holm")}
            line(row["row"], "success_less_sarl", "all", row["difference"]["mean"], **gap)
    for contrast in contrasts:
        gap = {name: contrast[name] for name in ("low", "high")}
        line(contrast["of"], f"{contrast['in']}_difference", "all", contrast["mean"], **gap)
    return lines


def model_sheet(cards: dict[str, dict[str, Any]]) -> Sheet:
    """List model cards."""
    heads = ("model", "preset", "seed", "tested on", "success alone", "with recovery", "nav.\ntime")
    rows = []
    for name, card in cards.items():
        tests = card["alone"], card["with_recovery"]
        rates = (f"{rate(t['success'])} {'-'.join(map(rate, t['interval']))}" for t in tests)
        time = f"{tests[1]['navigation_time']:.2f}"
        rows.append((name, card["preset"], str(card["seed"]), card["environment"], *rates, time))
    return Sheet("Models that come with sfmrl; 95 % Wilson intervals", heads, rows)


def card_lines(card: dict[str, Any], indent: str = "") -> list[str]:
    """Write a model card as lines of text."""
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
