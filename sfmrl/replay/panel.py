"""The numbers beside the plane: whom the robot heeds, what it thinks of its actions, what pushes and rewards it.

Pure text from a story's arrays, in a column of given size. What a policy does not have is left out; where lines are
few, the map of actions goes first, then the elements farthest down the list. Where there are more, the panel shows all
elements, then all terms of the reward, then whose repulsion is strongest, then a larger map of actions.
"""

import numpy as np
from rich.text import Text

from sfmrl.geometry import length
from sfmrl.replay.canvas import FAINT, PUSH, PUSHES, ROBOT, WATCHED, arrow, fitted
from sfmrl.replay.story import Story, number
from sfmrl.replay.timeline import ENDS
from sfmrl.sfm import resultant

EIGHTHS = " ▏▎▍▌▋▊▉"
SHADES = "·░▒▓█"  # a fifth of the actions each, the worst first
SHADE_STYLES = ("grey42", "color(24)", "color(31)", "color(38)", "color(45)")
TITLES = {"success": "goal reached", "collision": "collision", "timeout": "time is up"}
DISC_ROWS = (13, 11, 9, 7)  # sizes of the map of actions, the largest that fits
FEW = 4  # elements that come before the map of actions
PUSHED = (28, 40)  # columns from which a table without and with attention shows each element's repulsion


def panel_lines(story: Story, t: int, rows: int, columns: int) -> list[Text]:
    """The panel at moment `t`: exactly `rows` texts of `columns` columns."""
    there = int(np.isfinite(story.gap[t]).sum())
    several = len(story.terms) > 1
    few = 2 if several else 0
    left = rows - 6 - few - min(max(there, 1), FEW)  # of clock, heading and account

    def take(wanted: int) -> int:
        nonlocal left
        taken = min(max(left, 0), wanted)
        left -= taken
        return taken

    drawn = story.look is not None and left >= DISC_ROWS[-1] + 2 and 2 * DISC_ROWS[-1] + 17 <= columns
    disc_rows = take(DISC_ROWS[-1] + 2) - 2 if drawn else 0
    take(max(there - FEW, 0))  # the table has what the rest leaves
    terms = few + take(len(story.terms) - few if several else 0)
    pushes = 0 if _pushed(story, columns) else take(min(there, 3))
    if drawn:
        disc_rows = next(size for size in DISC_ROWS if size <= disc_rows + left and 2 * size + 17 <= columns)

    end = _account(story, t, columns, terms, pushes)
    disc = [Text(), *_actions(story, t, disc_rows, columns)] if drawn else []
    table = _elements(story, t, min(there, rows - 2 - len(end) - len(disc)), columns)
    top = [_clock(story, t, columns), *table, *disc]
    lines = [*top[: rows - len(end)], *[Text()] * (rows - len(top) - len(end)), *end]
    return [fitted(line, columns) for line in lines[:rows]]


def facts_lines(story: Story, t: int, rows: int, columns: int) -> list[Text]:
    """The most needed of it at moment `t`, where there is no room for the panel: `rows` texts of `columns` columns."""
    clock = _clock(story, t, columns) if t == story.last else fitted(_now(story, t), columns, _gap(story, t))
    push = Text.assemble(("repulsion ", FAINT), _strength(resultant(story.force[t])))
    lines = [clock, fitted(push, columns, Text.assemble(("return ", FAINT), _signed(story.returns[t])))]
    if story.attention is not None:
        heeded = Text.assemble(("attention", FAINT))
        for element in _order(story, t):
            share = Text(f" {_name(story, element)} {story.attention[t, element]:.0%}")
            if heeded.cell_len + share.cell_len <= columns:
                heeded += share
        lines.append(heeded)
    lines += [Text()] * rows
    return [fitted(line, columns) for line in lines[:rows]]


def _now(story: Story, t: int) -> Text:
    return Text(f"t {story.time[t]:5.2f} s", "bold")


def _clock(story: Story, t: int, columns: int) -> Text:
    """The time, and the robot's speed or how it has ended."""
    speed = Text.assemble(("speed ", FAINT), (f"{length(story.velocity[t, 0]):.2f} m/s", ROBOT))
    if t == story.last:
        speed = Text(" ".join((ENDS[story.outcome][0], TITLES[story.outcome])), ENDS[story.outcome][1])
    return fitted(_now(story, t), columns, speed)


def _order(story: Story, t: int) -> np.ndarray:
    """The elements that are there, those with most attention first; without a network, the nearest."""
    first = story.gap[t] if story.attention is None else -story.attention[t]
    order = np.argsort(first, kind="stable")
    return order[np.isfinite(story.gap[t][order])]


def _name(story: Story, element: int) -> str:
    return f"{'■' if story.square[element + 1] else ''}{number(element + 1)}"


def _strength(force: np.ndarray) -> Text:
    return Text(f"{arrow(force, PUSHES)} {length(np.nan_to_num(force)):.2f}", PUSH)


def _pushed(story: Story, columns: int) -> bool:
    """Whether a table of so many columns has one for the elements' repulsion."""
    return columns >= PUSHED[story.attention is not None]


def _elements(story: Story, t: int, rows: int, columns: int) -> list[Text]:
    """A heading and the elements that get most attention; without a network, those that are nearest."""
    gap, attention = story.gap[t], None if story.attention is None else story.attention[t]
    if rows <= 0:
        return [Text("nobody else is here", FAINT)] if not np.isfinite(gap).any() else []
    pushed = _pushed(story, columns)
    title = Text("nearest" if attention is None else "attention", FAINT)
    lines = [fitted(title, columns, Text("repulsion     gap" if pushed else "gap", FAINT))]
    for k, element in enumerate(_order(story, t)[:rows]):
        name = Text(f"{_name(story, element):>2} ", "bold")
        right = Text(f" {gap[element]:5.2f} m")
        if pushed:
            right = Text.assemble(" ", _strength(story.force[t, element]), right)
        if attention is not None:
            share, style = attention[element], WATCHED if k == 0 else ""
            bar = columns - 9 - right.cell_len
            name += Text(_bar(share / story.attention.max(), bar), style or "grey58")
            right = Text.assemble((f"{share:4.0%}", style), right)
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


def _account(story: Story, t: int, columns: int, terms: int, pushes: int) -> list[Text]:
    """The repulsion at moment `t`, the smallest gap and the reward of the step that led here, the return so far.

    With the strongest repulsions in `pushes` lines and the reward's terms in `terms`: those that count where there are
    fewer lines than terms.
    """
    push, each = resultant(story.force[t]), np.nan_to_num(length(story.force[t]))
    strongest = np.argsort(-each, kind="stable")
    strength = _strength(push) + Text(" m/s²")
    if each.any() and not pushes:
        strength.append(f", mostly {number(int(strongest[0]) + 1)}")
    repelled = [
        fitted(Text(f"  of {story.called(int(k) + 1)}", FAINT), columns, _strength(story.force[t, k]) + Text(" m/s²"))
        for k in strongest[:pushes]
    ]
    parts = {name: values[t - 1] for name, values in story.terms.items()} if t else dict.fromkeys(story.terms, 0.0)
    shown = [(name, value) for name, value in parts.items() if value or terms >= len(parts)]
    listed = [fitted(Text(f"  {name}", FAINT), columns, _signed(value)) for name, value in shown if len(parts) > 1]
    return [
        fitted(Text("repulsion", FAINT), columns, strength),
        *repelled,
        fitted(Text("smallest gap", FAINT), columns, _gap(story, t)),
        fitted(Text("reward of the step", FAINT), columns, _signed(sum(parts.values())) if t else Text("-")),
        *[*listed, *[Text()] * terms][: max(terms, len(listed))],
        fitted(Text("return so far", FAINT), columns, _signed(story.returns[t])),
    ]


def _gap(story: Story, t: int) -> Text:
    """The smallest gap of the step that led to moment `t`, and to whom."""
    gaps = story.separations[t - 1] if t else np.nan_to_num(story.gap[0], nan=np.inf)
    nearest = int(gaps.argmin()) if len(gaps) else 0
    return Text(f"{gaps[nearest]:.2f} m to {number(nearest + 1)}" if np.isfinite(gaps).any() else "-")


def _signed(number: float) -> Text:
    """A number with its sign and four decimals, and no "-0.0000"."""
    value = round(float(number), 4) + 0.0
    return Text(f"{value:+.4f}", "bold" if value else FAINT)
