"""When it happened, and in words: an episode's time as a line of marks, and its latest event as a sentence."""

from rich.text import Text

from sfmrl.replay.canvas import BAD, FAINT, GOAL, LATE, ROBOT, fitted
from sfmrl.replay.story import Story, number

ENDS = {"success": ("★", GOAL), "collision": ("X", BAD), "timeout": ("T", LATE)}  # an outcome's mark and its style


def timeline(story: Story, t: int, columns: int) -> Text:
    """The time from 0 to the limit at moment `t`: what has passed, where the robot is too close (!) or stuck (~)."""
    left, right = " 0 s ", f" {story.time_limit:g} s "
    width = max(columns - len(left) - len(right), 1)
    at = (story.time / story.time_limit * (width - 1)).round().astype(int)  # a moment's column
    cells = [("━", "") if k <= at[t] else ("─", FAINT) for k in range(width)]
    for first, last in story.close:
        cells[at[first] : at[last] + 1] = [("!", BAD)] * (at[last] + 1 - at[first])
    for step in story.stuck.nonzero()[0]:
        cells[at[step] : at[step + 1]] = [("~", LATE)] * (at[step + 1] - at[step])
    cells[at[t]] = ("●", ROBOT)
    cells[at[-1]] = ENDS[story.outcome]
    return fitted(Text.assemble((left, FAINT), *cells, (right, FAINT)), columns)


def sentence(story: Story, t: int, columns: int = 80) -> Text:
    """How it has ended or, before, that the robot is stuck, or when it was last too close and to whom.

    In few `columns` the same in fewer words.
    """
    close = [(first, min(last, t)) for first, last in story.close if first <= t]
    if t == story.last:
        return _ending(story, sum(last - first + 1 for first, last in close), int(story.stuck.sum()), columns)
    if story.stuck[t]:
        words = ("stuck: led around the squares until the straight way is free", "stuck: led around the squares")
        return _longest(columns, *(Text.assemble((" ~", LATE), f" {text}") for text in words))
    if not close:
        return Text(" too close to nobody so far" if t else " at the start", FAINT)
    first, last = close[-1]
    gaps = story.separations[first - 1 : last].min(0)  # of the steps that led to these moments
    when = f"{story.time[first]:.2f}" if first == last else f"{story.time[first]:.2f} to {story.time[last]:.2f}"
    row = int(gaps.argmin()) + 1
    words = (
        f"too close {when} s ({story.called(row)}, {gaps.min():.2f} m)",
        f"{gaps.min():.2f} m to {number(row)}, {when} s",
    )
    return _longest(columns, *(Text.assemble((" !", BAD), f" {text}") for text in words))


def _ending(story: Story, close: int, stuck: int, columns: int) -> Text:
    """The outcome in words, and for how many steps the robot was too close or stuck."""
    mark, style = ENDS[story.outcome]
    end = f"{story.time[-1]:.2f} s"
    words, fewer = {
        "success": (f"goal reached after {end}",) * 2,
        "collision": (
            f"collision at {end}: hit {' and '.join(map(story.called, story.hit))}",
            f"collision at {end}: hit {' and '.join(map(number, story.hit))}",
        ),
        "timeout": (
            f"time is up at {end}, {story.goal_distance:.2f} m from the goal",
            f"time is up, {story.goal_distance:.2f} m to go",
        ),
    }[story.outcome]
    before = f"; too close for {close * story.time[1]:.2f} s" if close else "; never too close"
    led = f"; stuck for {stuck * story.time[1]:.2f} s" if stuck else ""
    told = ((words, before + led), (words, before), (words, ""), (fewer, ""))
    return _longest(columns, *(Text.assemble((f" {mark} ", style), (head, "bold"), rest) for head, rest in told))


def _longest(columns: int, *texts: Text) -> Text:
    """The first of some texts, from the longest to the shortest, that fits; else the last."""
    return next((text for text in texts if text.cell_len <= columns), texts[-1])
