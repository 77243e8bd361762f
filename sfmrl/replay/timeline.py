"""What happened when: the time of an episode as a line of marks, and its latest event as a sentence."""

from rich.text import Text

from sfmrl.geometry import length
from sfmrl.replay.canvas import Style, first_fitting, fitted, without_last
from sfmrl.replay.story import Story, glyph_of

OUTCOMES = {  # mark, style of the mark, words
    "success": ("★", Style.GOAL, "goal reached"),
    "collision": ("X", Style.DANGER, "collision"),
    "timeout": ("T", Style.DELAY, "time is up"),
}


def timeline(story: Story, t: int, columns: int) -> Text:
    """The time from 0 to the limit as a line: where the robot is too close (!) or stuck (~), now (●), the outcome."""
    left, right = " 0 s ", f" {story.time_limit:g} s "
    width = max(columns - len(left) - len(right), 1)
    at = (story.time / story.time_limit * (width - 1)).round().astype(int)  # (T + 1,) column of each moment
    cells = [("━", "") if k <= at[t] else ("─", Style.DIM) for k in range(width)]
    for first, last in story.close:
        cells[at[first] : at[last] + 1] = [("!", Style.DANGER)] * (at[last] + 1 - at[first])
    for step in story.stuck.nonzero()[0]:
        cells[at[step] : at[step + 1]] = [("~", Style.DELAY)] * (at[step + 1] - at[step])
    cells[at[t]] = ("●", Style.ROBOT)
    cells[at[-1]] = OUTCOMES[story.outcome][:2]
    return fitted(Text.assemble((left, Style.DIM), *cells, (right, Style.DIM)), columns)


def sentence(story: Story, t: int, columns: int = 80) -> Text:
    """The outcome at the end; before, that the robot is stuck, or when it was last too close and to which element.

    It is the longest wording that fits into `columns`.
    """
    close = [(first, min(last, t)) for first, last in story.close if first <= t]
    if t == story.last:
        mark, style, _ = OUTCOMES[story.outcome]
        outcome, semicolon, more = first_fitting(_endings(story), columns - 3).partition(";")
        return Text.assemble((f" {mark} ", style), (outcome, "bold"), semicolon, more)
    if story.stuck[t]:
        wordings = ["stuck: led around the squares until the straight way is free", "stuck: led around the squares"]
        return Text.assemble((" ~ ", Style.DELAY), first_fitting([*wordings, "stuck"], columns - 3))
    if close:
        first, last = close[-1]
        gaps = story.separations[first - 1 : last].min(0)  # of the steps that led to these moments
        row, gap = int(gaps.argmin()) + 1, f"{gaps.min():.2f} m"
        when = " to ".join(f"{story.time[moment]:.2f}" for moment in sorted({first, last}))
        brief = f"{gap} to {glyph_of(row)}"
        wordings = [f"too close {when} s ({story.called(row)}, {gap})", f"{brief}, {when} s", brief]
        return Text.assemble((" ! ", Style.DANGER), first_fitting(wordings, columns - 3))
    return Text(
        first_fitting([" too close to nobody so far", " nobody close"] if t else [" at the start"], columns), Style.DIM
    )


def _endings(story: Story) -> list[str]:
    """Wordings of the outcome and of how long the robot was too close or stuck, from the longest to the shortest."""
    words = OUTCOMES[story.outcome][2]
    time = f"{story.time[-1]:.2f} s"
    if story.outcome == "success":
        long = short = f"{words} after {time}"
    elif story.outcome == "collision":
        long, short = (
            f"{words} at {time}: hit {' and '.join(map(name, story.hit))}" for name in (story.called, glyph_of)
        )
    else:
        distance = f"{length(story.goal[0] - story.position[-1, 0]):.2f} m"
        long, short = f"{words} at {time}, {distance} from the goal", f"{words}, {distance} to go"
    close = sum(last - first + 1 for first, last in story.close) * story.time[1]  # s
    stuck = story.stuck.sum() * story.time[1]  # s
    parts = [long, f"too close for {close:.2f} s" if close else "never too close"]
    if stuck:
        parts.append(f"stuck for {stuck:.2f} s")
    return [*without_last(parts, "; "), short, words]
