"""The numbers beside the map: whom the robot heeds, what it thinks of its actions, what pushes and rewards it.

Pure text from a story's arrays, in a column of given size. What a policy does not have is left out; where lines are
few, the map of actions goes first, then the elements farthest down the list.
"""

import numpy as np
from rich.text import Text

from sfmrl.canvas import FAINT, ROBOT, WATCHED, arrow, fitted
from sfmrl.geometry import length
from sfmrl.sfm import resultant
from sfmrl.story import Story, number
from sfmrl.timeline import ENDS

EIGHTHS = " ▏▎▍▌▋▊▉"
SHADES = "·░▒▓█"  # a fifth of the actions each, the worst first
SHADE_STYLES = ("grey42", "color(24)", "color(31)", "color(38)", "color(45)")
TITLES = {"success": "goal reached", "collision": "collision", "timeout": "time is up"}
DISC_ROWS = (13, 11, 9, 7)  # sizes of the map of actions, the largest that fits


def panel_lines(story: Story, t: int, rows: int, columns: int) -> list[Text]:
    """The panel at moment `t`: exactly `rows` texts of `columns` columns."""
    end = _account(story, t, columns)
    free = rows - 1 - len(end)
    there = int(np.isfinite(story.gap[t]).sum())
    table_rows = min(max(there, 1), 4)
    disc: list[Text] = []
    if story.look is not None:
        fits = [size for size in DISC_ROWS if size + 3 + table_rows <= free and 2 * size + 17 <= columns]
        disc = [Text(), *_actions(story, t, fits[0], columns)] if fits else []
    table = _elements(story, t, min(there, free - len(disc) - 1), columns)
    top = [_clock(story, t, columns), *table, *disc]
    lines = [*top[: rows - len(end)], *[Text()] * (rows - len(top) - len(end)), *end]
    return [fitted(line, columns) for line in lines[:rows]]


def _clock(story: Story, t: int, columns: int) -> Text:
    """The time, and the robot's speed or how it has ended."""
    speed = Text.assemble(("speed ", FAINT), (f"{length(story.velocity[t, 0]):.2f} m/s", ROBOT))
    if t == story.last:
        speed = Text(" ".join((ENDS[story.outcome][0], TITLES[story.outcome])), ENDS[story.outcome][1])
    return fitted(Text(f"t {story.time[t]:5.2f} s", "bold"), columns, speed)


def _elements(story: Story, t: int, rows: int, columns: int) -> list[Text]:
    """A heading and the elements that get most attention; without a network, those that are nearest."""
    gap, attention = story.gap[t], None if story.attention is None else story.attention[t]
    if rows <= 0:
        return [Text("nobody else is here", FAINT)] if not np.isfinite(gap).any() else []
    order = np.argsort(gap, kind="stable") if attention is None else np.argsort(-attention, kind="stable")
    order = order[np.isfinite(gap[order])][:rows]
    title = Text("nearest" if attention is None else "attention", FAINT)
    lines = [fitted(title, columns, Text("gap", FAINT))]
    for k, element in enumerate(order):
        name = Text(f"{'■' if story.square[element + 1] else ' '}{number(element + 1)} ", "bold")
        right = Text(f"{gap[element]:5.2f} m")
        if attention is not None:
            share, style = attention[element], WATCHED if k == 0 else ""
            name += Text(_bar(share / story.attention.max(), columns - 17), style or "grey58")
            right = Text.assemble((f"{share:4.0%} ", style), right)
        lines.append(fitted(name, columns, right))
    return lines


def _bar(share: float, columns: int) -> str:
    """A bar of `share` (0 to 1) of the columns, in eighths of one."""
    eighths = round(float(np.clip(share, 0.0, 1.0)) * columns * 8)
    return "█" * (eighths // 8) + EIGHTHS[eighths % 8].strip()


def _actions(story: Story, t: int, rows: int, columns: int) -> list[Text]:
    """A heading and the map of the actions' values at moment `t`; at the end, when there is none to take, nothing."""
    if t == story.last:
        return []
    actions, values = story.look.actions[t], story.look.values[t]
    taken = int(length(actions - story.velocity[t + 1, 0]).argmin())
    lines = action_disc(actions, values, taken, rows)
    words = [
        (f"o  next {values[taken]:7.3f}", ROBOT),
        (f"{SHADES[-1]}  best {values.max():7.3f}", SHADE_STYLES[-1]),
        (f"   stay {values[length(actions).argmin()]:7.3f}", ""),
        (f"{SHADES[0]} worst {values.min():7.3f}", FAINT),
    ]
    for k, (word, style) in enumerate(words, rows // 2 - 1):
        lines[k] = fitted(lines[k], columns, Text(word, style))
    return [Text(f"value of the {len(values)} actions", FAINT), *lines]


def action_disc(actions: np.ndarray, values: np.ndarray, taken: int, rows: int) -> list[Text]:
    """Actions (A, 2) as a disc of `rows` (odd) texts, standing still in the middle and the fastest at the rim.

    Headings are those of the map. The better an action's value (A,), the denser its shade; `taken` is marked o.
    """
    speeds, ring = np.unique(np.round(length(actions), 6), return_inverse=True)
    heading = np.arctan2(actions[:, 1], actions[:, 0])
    reach = (rows // 2) * ring / max(len(speeds) - 1, 1)  # (A,) in rows
    place = reach[:, None] * np.stack((np.cos(heading), np.sin(heading)), -1)
    y, x = np.mgrid[rows // 2 : -(rows // 2) - 1 : -1, -(rows // 2) : rows // 2 : (2 * rows - 1) * 1j]
    cells = np.stack((x, y), -1)  # (rows, columns, 2)
    apart = length(cells[:, :, None] - place)  # (rows, columns, A)
    shown = apart.argmin(-1)
    level = (values.argsort().argsort() * len(SHADES)) // len(values)
    mark = np.unravel_index(apart[..., taken].argmin(), shown.shape)
    lines = []
    for r in range(rows):
        line = Text(" ")
        for c in range(shown.shape[1]):
            if (r, c) == mark:
                line.append("o", f"{ROBOT} reverse")
            elif length(cells[r, c]) > rows // 2 + 0.3:
                line.append(" ")
            else:
                line.append(SHADES[level[shown[r, c]]], SHADE_STYLES[level[shown[r, c]]])
        lines.append(line)
    return lines


def _account(story: Story, t: int, columns: int) -> list[Text]:
    """The repulsion at moment `t`, the smallest gap and the reward of the step that led here, the return so far."""
    push, each = resultant(story.force[t]), np.nan_to_num(length(story.force[t]))
    strength = Text(f"{arrow(push)} {length(push):.2f} m/s²")
    if each.any():
        strength.append(f", mostly {number(int(each.argmax()) + 1)}")
    gaps = story.separations[t - 1] if t else np.nan_to_num(story.gap[0], nan=np.inf)
    gap = Text("-")
    if np.isfinite(gaps).any():
        gap = Text(f"{gaps.min():.2f} m to {number(int(gaps.argmin()) + 1)}")
    parts = {name: values[t - 1] for name, values in story.terms.items()} if t else {}
    shown = [(name, value) for name, value in parts.items() if value and len(story.terms) > 1]
    terms = [fitted(Text(f"  {name}", FAINT), columns, _signed(value)) for name, value in shown]
    few = [] if len(story.terms) == 1 else [*terms, Text(), Text()][: max(2, len(terms))]
    return [
        fitted(Text("repulsion", FAINT), columns, strength),
        fitted(Text("smallest gap", FAINT), columns, gap),
        fitted(Text("reward of the step", FAINT), columns, _signed(sum(parts.values())) if t else Text("-")),
        *few,
        fitted(Text("return so far", FAINT), columns, _signed(story.returns[t])),
    ]


def _signed(number: float) -> Text:
    """A number with its sign and four decimals, and no "-0.0000"."""
    return Text(f"{round(float(number), 4) + 0.0:+.4f}", "bold")
