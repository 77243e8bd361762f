"""An explanation as tables and lines of text: the steps, and what each reward pays in all; 80 columns are enough."""

from typing import Any

from rich.table import Table
from rich.text import Text

from sfmrl.config import counted
from sfmrl.lessons.explain import MARKS, Explanation, mark
from sfmrl.study.sheets import plain_table

DIGITS, FEWER_DIGITS = 5, 4  # decimals of rewards, and where there is no room for these
HEADS = {
    "collision": "colli-\nsion",
    "discomfort": "dis-\ncomfort",
    "velocity": "velo-\ncity",
    "distance": "dis-\ntance",
    "discount": "dis-\ncount",
}


def explanation_parts(
    explanation: Explanation, shown: list[dict[str, Any]], title: str, columns: int
) -> list[str | Table]:
    """Return what to print in `columns`: the steps in `shown`, what their marks mean, and the sums."""
    steps = explanation.steps
    signs = {mark(row["event"]) for row in shown}
    legend = [f"{sign} {words}" for sign, (_, words) in MARKS.items() if sign in signs]
    notes = ["; ".join([f"{len(shown)} of {counted(len(steps), 'step')}", *legend])]
    notes.append("gap: smallest in the step, m; push: resultant repulsion, m/s^2")
    if "turn" in steps[0]:
        notes.append("turn: to the left, before the robot drives")
    if "value" in steps[0]:
        notes.append("value: of the action taken; other: of the best of the other 80")
    return [
        f"{title}, {explanation.name}: {steps[-1]['event'].split('; ')[0]} after {steps[-1]['time']:.2f} s",
        _steps_table(explanation, shown, columns),
        "\n".join([*notes, ""]),
        _sums_table(explanation),
        "plain: sums; below: discounted to the start; *: the reward of the steps above",
    ]


def _steps_table(explanation: Explanation, shown: list[dict[str, Any]], columns: int) -> Table:
    """Return a line per step; terms that the whole episode never pays are left out."""
    valued, turning = "value" in shown[0], "turn" in shown[0]
    terms = [term for term, paid in explanation.plain.items() if paid and len(explanation.plain) > 1]
    width = 21 + 6 * turning + 14 * valued + (DIGITS + 4) * (1 + len(terms))
    digits = DIGITS if width <= columns else FEWER_DIGITS
    heads = ["step", "time", *(["turn"] if turning else []), "gap", "push", *(["value", "other"] if valued else [])]
    heads += [HEADS.get(name, name) for name in terms]
    table = plain_table(*heads, "reward", first="right")
    for row in shown:
        gap = "-" if row["gap"] is None else f"{row['gap']:.2f}" if row["gap"] < 10 else f"{row['gap']:.1f}"
        cells = [f"{row['step']}{mark(row['event']) or ' '}", f"{row['time']:.2f}"]
        cells += [f"{round(row['turn']):+}°"] if turning else []
        cells += [gap, f"{row['repulsion']:.2f}"]
        cells += [f"{row[name]:.3f}" for name in ("value", "runner_up") if valued]
        table.add_row(*cells, *(_signed(row[name], digits) for name in (*terms, "reward")))
    return table


def _sums_table(explanation: Explanation) -> Table:
    """Return a line for the own reward's plain sums, and one for each reward's discounted sums."""
    rewards = explanation.discounted
    terms = list(dict.fromkeys(term for paid in rewards.values() for term in paid))
    terms = [term for term in terms if any(paid.get(term) for paid in rewards.values())]
    table = plain_table("", *(HEADS.get(name, name) for name in terms), "return")
    lines = {"plain*": explanation.plain}
    lines |= {f"{name}*" if name == explanation.own else name: paid for name, paid in rewards.items()}
    for name, paid in lines.items():
        cells = [_signed(paid[term]) if term in paid else Text("-", "dim") for term in terms]
        table.add_row(name, *cells, _signed(sum(paid.values())), end_section=name == "plain*")
    return table


def _signed(number: float, digits: int = DIGITS) -> Text:
    """Return a number with its sign; "0" for exactly 0, and no "-0.0000"."""
    return Text(f"{number:+z.{digits}f}") if number else Text("0", "dim")
