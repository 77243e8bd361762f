"""The numbers beside the plane: elements by attention, values of the actions, repulsion on the robot, reward.

All functions return texts of a given size. Parts that a policy does not have are left out.
"""

import numpy as np
from rich.text import Text

from sfmrl.geometry import length, unit_at
from sfmrl.replay.canvas import FORCE_ARROWS, Style, fitted, octant, styled
from sfmrl.replay.story import Story, glyph_of
from sfmrl.replay.timeline import OUTCOMES
from sfmrl.sfm import resultant

EIGHTHS = " ▏▎▍▌▋▊▉"
SHADES = "·░▒▓█"  # a fifth of the actions each, the worst first
SHADE_STYLES = ("grey42", "color(24)", "color(31)", "color(38)", "color(45)")
DISC_CELLS = (*zip(SHADES, SHADE_STYLES, strict=True), (" ", ""), ("o", f"{Style.ROBOT} reverse"))
OUTSIDE, TAKEN = len(SHADES), len(SHADES) + 1  # the last two of these: outside the disc, the action that was taken
DISC_ROWS = (13, 11, 9, 7)  # sizes of the disc of actions
DISC_WORDS = 17  # columns beside it
FIRST_ELEMENTS, FIRST_TERMS = 4, 2  # elements, and terms of the reward, that come before the disc
LISTED_REPULSIONS = 3


def panel_lines(story: Story, t: int, rows: int, columns: int) -> list[Text]:
    """The panel at moment `t`: exactly `rows` texts of `columns` columns."""
    disc_rows, terms, repulsions = _share_lines(story, t, rows, columns)
    account = _account(story, t, columns, terms, repulsions)
    disc = [Text(), *_actions(story, t, disc_rows, columns)] if disc_rows else []
    table = _elements(story, t, rows - 2 - len(account) - len(disc), columns)
    speed = Text.assemble(("speed ", Style.DIM), (f"{length(story.velocity[t, 0]):.2f} m/s", Style.ROBOT))
    top = [_clock(story, t, columns, speed), *table, *disc][: rows - len(account)]
    lines = [*top, *[Text()] * (rows - len(top) - len(account)), *account]
    return [fitted(line, columns) for line in lines[:rows]]


def _share_lines(story: Story, t: int, rows: int, columns: int) -> tuple[int, int, int]:
    """Lines of a panel for the disc of actions, for terms of the reward, and for repulsions of single elements.

    The elements get the lines that remain. Parts get the lines they want in turn: first the disc in its smallest size,
    then the elements, all terms, the repulsions, then larger sizes of the disc.
    """
    present = int(np.isfinite(story.gap[t]).sum())
    terms = len(story.terms) if len(story.terms) > 1 else 0  # a single one is the reward itself
    first_terms = min(terms, FIRST_TERMS)
    free = rows - 6 - first_terms - min(max(present, 1), FIRST_ELEMENTS)  # 6: clock, heading, and four of the account
    sizes = [size for size in DISC_ROWS if 2 * size + DISC_WORDS <= columns] if story.look is not None else []
    smallest = sizes[-1] if sizes and free >= sizes[-1] + 2 else 0  # 2: a blank line and a heading
    wanted = (
        smallest + 2 if smallest else 0,
        max(present - FIRST_ELEMENTS, 0),
        terms - first_terms,
        0 if _table_has_repulsions(story, columns) else min(present, LISTED_REPULSIONS),
    )
    granted = np.diff(np.cumsum(wanted).clip(0, max(free, 0)), prepend=0).tolist()
    disc_rows = next(size for size in sizes if size <= smallest + free - sum(granted)) if smallest else 0
    return disc_rows, first_terms + granted[2], granted[3]


def facts_lines(story: Story, t: int, rows: int, columns: int) -> list[Text]:
    """The most important facts at moment `t`, in place of a panel: exactly `rows` texts of `columns` columns."""
    push = Text.assemble(("repulsion ", Style.DIM), _force(resultant(story.force[t])))
    paid = Text.assemble(("return ", Style.DIM), _signed(story.returns[t]))
    lines = [_clock(story, t, columns, _gap(story, t)), fitted(push, columns, paid)]
    if story.attention is not None:
        shares = Text.assemble(("attention", Style.DIM))
        for element in _order(story, t):
            share = Text(f" {_label(story, element)} {story.attention[t, element]:.0%}")
            if shares.cell_len + share.cell_len <= columns:
                shares += share
        lines.append(shares)
    lines += [Text()] * rows
    return [fitted(line, columns) for line in lines[:rows]]


def _clock(story: Story, t: int, columns: int, right: Text) -> Text:
    """The time, and at the right edge the outcome if the episode has ended, else `right`."""
    if t == story.last:
        mark, style, words = OUTCOMES[story.outcome]
        right = Text(f"{mark} {words}", style)
    return fitted(Text(f"t {story.time[t]:5.2f} s", "bold"), columns, right)


def _order(story: Story, t: int) -> np.ndarray:
    """Indices of the elements that are present, by attention, largest first, or without attention by their gaps."""
    key = story.gap[t] if story.attention is None else -story.attention[t]
    order = np.argsort(key, kind="stable")
    return order[np.isfinite(story.gap[t, order])]


def _label(story: Story, element: int) -> str:
    return f"{'■' if story.square[element + 1] else ''}{glyph_of(element + 1)}"


def _force(force: np.ndarray) -> Text:
    """Direction and magnitude of a force (2,)."""
    size = length(np.nan_to_num(force))
    return Text(f"{FORCE_ARROWS[octant(force)] if size > 1e-3 else '·'} {size:.2f}", Style.FORCE)


def _table_has_repulsions(story: Story, columns: int) -> bool:
    """Whether a table of this width shows each element's repulsion, beside its attention if there is any."""
    return columns >= (28 if story.attention is None else 40)


def _elements(story: Story, t: int, rows: int, columns: int) -> list[Text]:
    """A heading and at most `rows` elements in the order of `_order`."""
    order, attention = _order(story, t), story.attention
    if not len(order):
        return [Text("no people or squares", Style.DIM)]
    if rows <= 0:
        return []
    with_repulsions = _table_has_repulsions(story, columns)
    title = Text("nearest" if attention is None else "attention", Style.DIM)
    lines = [fitted(title, columns, Text("repulsion     gap" if with_repulsions else "gap", Style.DIM))]
    for element in order[:rows]:
        left = Text(f"{_label(story, element):>2} ", "bold")
        right = Text(f" {story.gap[t, element]:5.2f} m")
        if with_repulsions:
            right = Text.assemble(" ", _force(story.force[t, element]), right)
        if attention is not None:
            share = attention[t, element]
            style = Style.MOST_ATTENTION if share and element == order[0] else ""
            left.append(_bar(share / (attention.max() or 1.0), columns - 9 - right.cell_len), style or "grey58")
            right = Text.assemble((f"{share:4.0%}", style), right)
        lines.append(fitted(left, columns, right))
    return lines


def _bar(share: float, columns: int) -> str:
    """A bar of `share` (0 to 1) of the columns, to an eighth of a column."""
    eighths = round(share * columns * 8)
    return "█" * (eighths // 8) + EIGHTHS[eighths % 8].strip()


def _actions(story: Story, t: int, rows: int, columns: int) -> list[Text]:
    """A heading and the disc of the actions' values at moment `t`; nothing at the end, where no action follows."""
    if t == story.last or story.look is None:
        return []
    actions, values = story.look.actions[t], story.look.values[t]
    taken = int(story.taken[t])
    lines = action_disc(actions, values, taken, rows)
    legend = [
        (f"o  next {values[taken]:7.3f}", Style.ROBOT),
        (f"{SHADES[-1]}  best {values.max():7.3f}", SHADE_STYLES[-1]),
        (f"   stay {values[length(actions).argmin()]:7.3f}", ""),
        (f"{SHADES[0]} worst {values.min():7.3f}", Style.DIM),
    ]
    for k, (words, style) in enumerate(legend, rows // 2 - 1):
        lines[k] = fitted(lines[k], columns, Text(words, style))
    return [Text(f"value of the {len(values)} actions", Style.DIM), *lines]


def action_disc(actions: np.ndarray, values: np.ndarray, taken: int, rows: int) -> list[Text]:
    """Draw actions (A, 2) as a disc in `rows` (odd) texts: zero velocity at the centre, the highest speed at the rim.

    Directions are as on the plane; what is far from all actions, as behind a unicycle, is empty. The higher the value
    (A,) of an action, the denser its shade; `taken`, the index of the action that was taken, is marked "o".
    """
    radius = rows // 2
    speeds, ring = np.unique(np.round(length(actions), 6), return_inverse=True)
    heading = np.arctan2(actions[:, 1], actions[:, 0])
    reach = radius * ring / max(len(speeds) - 1, 1)  # (A,) in rows
    place = reach[:, None] * unit_at(heading)  # (A, 2)
    y, x = np.mgrid[radius : -radius - 1 : -1, -radius : radius : (2 * rows - 1) * 1j]
    cells = np.stack((x, y), -1)  # (rows, columns, 2)
    distance = length(cells[:, :, None] - place)  # (rows, columns, A)
    rank = values.argsort().argsort() * len(SHADES) // len(values)  # (A,)
    outside = (length(cells) > radius + 0.3) | (distance.min(-1) > 0.23 * radius + 0.15)
    shown = np.where(outside, OUTSIDE, rank[distance.argmin(-1)])
    shown[np.unravel_index(distance[..., taken].argmin(), shown.shape)] = TAKEN
    return [styled([(" ", ""), *(DISC_CELLS[k] for k in row)]) for row in shown]


def _account(story: Story, t: int, columns: int, terms: int, repulsions: int) -> list[Text]:
    """The repulsion at moment `t`, the smallest gap and the reward of the step that led to it, the return so far.

    The strongest repulsions of single elements have `repulsions` lines, the reward's terms `terms` lines; if these are
    too few for all terms, the terms that are not zero are shown, in as many lines as they need.
    """
    each = np.nan_to_num(length(story.force[t]))
    strongest = np.argsort(-each, kind="stable").tolist()
    push = _force(resultant(story.force[t])) + Text(" m/s²")
    if each.any() and not repulsions:
        push.append(f", mostly {glyph_of(strongest[0] + 1)}")
    paid = {name: values[t - 1] if t else 0.0 for name, values in story.terms.items()}
    shown = [name for name, value in paid.items() if value or terms == len(paid)] if len(paid) > 1 else []
    rows = [
        ("repulsion", push),
        *((f"  of {story.called(k + 1)}", _force(story.force[t, k]) + Text(" m/s²")) for k in strongest[:repulsions]),
        ("smallest gap", _gap(story, t)),
        ("reward of the step", _signed(sum(paid.values())) if t else Text("-")),
        *((f"  {name}", _signed(paid[name])) for name in shown),
        *[("", Text())] * (terms - len(shown)),
        ("return so far", _signed(story.returns[t])),
    ]
    return [fitted(Text(label, Style.DIM), columns, value) for label, value in rows]


def _gap(story: Story, t: int) -> Text:
    """The smallest gap of the step that led to moment `t`, and to which element."""
    gaps = story.separations[t - 1] if t else np.nan_to_num(story.gap[0], nan=np.inf)
    nearest = int(gaps.argmin()) if len(gaps) else 0
    return Text(f"{gaps[nearest]:.2f} m to {glyph_of(nearest + 1)}" if np.isfinite(gaps).any() else "-")


def _signed(number: float) -> Text:
    """A number with its sign and four decimals; zero is never "-0.0000"."""
    value = round(float(number), 4) + 0.0
    return Text(f"{value:+.4f}", "bold" if value else Style.DIM)
