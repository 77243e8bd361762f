"""When it happened, and in words: an episode's time as a line of marks, and its latest event as a sentence."""

from rich.text import Text

from sfmrl.canvas import BAD, FAINT, GOAL, LATE, ROBOT, fitted
from sfmrl.story import Story

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


def sentence(story: Story, t: int) -> Text:
    """How it has ended or, before, that the robot is stuck, or when it was last too close and to whom."""
    close = [(first, min(last, t)) for first, last in story.close if first <= t]
    if t == story.last:
        return _ending(story, sum(last - first + 1 for first, last in close), int(story.stuck.sum()))
    if story.stuck[t]:
        return Text.assemble((" ~", LATE), " stuck: led around the squares until the straight way is free")
    if not close:
        return Text(" too close to nobody so far" if t else " at the start", FAINT)
    first, last = close[-1]
    gaps = story.separations[first - 1 : last].min(0)  # of the steps that led to these moments
    when = f"{story.time[first]:.2f}" if first == last else f"{story.time[first]:.2f} to {story.time[last]:.2f}"
    whom = story.called(int(gaps.argmin()) + 1)
    return Text.assemble((" !", BAD), f" too close {when} s ({whom}, {gaps.min():.2f} m)")


def _ending(story: Story, close: int, stuck: int) -> Text:
    """The outcome in words, and for how many steps the robot was too close or stuck."""
    mark, style = ENDS[story.outcome]
    words = {
        "success": f"goal reached after {story.time[-1]:.2f} s",
        "collision": f"collision at {story.time[-1]:.2f} s: hit {' and '.join(map(story.called, story.hit))}",
        "timeout": f"time is up at {story.time[-1]:.2f} s, {story.goal_distance:.2f} m from the goal",
    }[story.outcome]
    before = f"; too close for {close * story.time[1]:.2f} s" if close else "; never too close"
    led = f"; stuck for {stuck * story.time[1]:.2f} s" if stuck else ""
    return Text.assemble((f" {mark} ", style), (words, "bold"), before, led)
