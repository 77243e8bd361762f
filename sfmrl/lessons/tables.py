"""An explanation as tables on standard output: the steps, and what each reward pays in all; 80 columns are enough."""

from typing import Any

from rich.table import Table
from rich.text import Text

from sfmrl.config import counted
from sfmrl.console import WIDTH, out, plain_table, print_table, say_result
from sfmrl.lessons.explain import Explanation, mark

MANY_DIGITS, FEW_DIGITS = 5, 4  # decimals of rewards, where there is room and where there is not
HEADS = {
    "collision": "colli-\nsion",
    "discomfort": "dis-\ncomfort",
    "velocity": "velo-\ncity",
    "distance": "dis-\ntance",
    "discount": "dis-\ncount",
}
LEGEND = {
    "!": "too close",
    "~": "stuck, or free again",
    "^": "best action passed over, it may lead into a trap",
    "*": "goal reached",
    "X": "collision",
    "T": "time is up",
}


def print_explanation(explanation: Explanation, shown: list[dict[str, Any]], title: str) -> None:
    """The steps to show, what the marks mean, and the accounts."""
    steps = explanation.steps
    say_result(f"{title}, {explanation.name}: {steps[-1]['event'].split('; ')[0]} after {steps[-1]['time']:.2f} s")
    print_table(_steps_table(explanation, shown))
    marks = [mark(row["event"]) for row in shown]
    meant = [f"{sign} {words}" for sign, words in LEGEND.items() if sign in marks]
    say_result("; ".join([f"{len(shown)} of {counted(len(steps), 'step')}", *meant]))
    say_result("gap: smallest in the step, m; push: resultant repulsion, m/s^2")
    if "value" in steps[0]:
        say_result("value: of the action taken; next: of the best of the other 80")
    say_result("")
    print_table(_accounts_table(explanation))
    say_result("plain: sums; below: discounted to the start; *: the reward of the steps above")


def _steps_table(explanation: Explanation, shown: list[dict[str, Any]]) -> Table:
    """A line a step; terms that the whole episode never pays are left out."""
    valued = "value" in shown[0]
    terms = [term for term in explanation.terms if len(explanation.terms) > 1 and explanation.own.any_of(term)]
    taken = 21 + 14 * valued + (MANY_DIGITS + 4) * (1 + len(terms))
    digits = MANY_DIGITS if taken <= max(out.width, WIDTH) else FEW_DIGITS
    heads = ("step", "time", "gap", "push", *("value", "next") * valued, *(HEADS.get(name, name) for name in terms))
    table = plain_table(*heads, "reward", first="right")
    for row in shown:
        gap = "-" if row["gap"] is None else f"{row['gap']:.2f}" if row["gap"] < 10 else f"{row['gap']:.1f}"
        cells = [f"{row['step']}{mark(row['event']) or ' '}", f"{row['time']:.2f}", gap, f"{row['repulsion']:.2f}"]
        cells += [f"{row[name]:.3f}" for name in ("value", "runner_up") if valued]
        table.add_row(*cells, *(_signed(row[name], digits) for name in (*terms, "reward")))
    return table


def _accounts_table(explanation: Explanation) -> Table:
    """What each reward pays in all: a line each, and before them the own reward's plain sums."""
    accounts = explanation.accounts
    names = dict.fromkeys(term for account in accounts for term in account.plain)
    terms = [term for term in names if any(account.any_of(term) for account in accounts)]
    table = plain_table("", *(HEADS.get(name, name) for name in terms), "return")
    own = explanation.own
    rows = [("plain*", own.plain, sum(own.plain.values()))]
    for account in accounts:
        rows.append((account.name + "*" * (account is own), account.discounted, account.discounted_return))
    for name, paid, whole in rows:
        cells = [_signed(paid[term], MANY_DIGITS) if term in paid else Text("-", "dim") for term in terms]
        table.add_row(name, *cells, _signed(whole, MANY_DIGITS), end_section=name == "plain*")
    return table


def _signed(number: float, digits: int) -> Text:
    """A number with its sign, nothing but a 0 where there is nothing, and no "-0.0000"."""
    if not number:
        return Text("0", "dim")
    return Text(f"{round(float(number), digits) + 0.0:+.{digits}f}")
