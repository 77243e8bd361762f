"""What happened when: the time of an episode as a line of marks, and its latest event as a sentence."""

from rich.text import Text

from sfmrl.geometry import length
from sfmrl.replay.canvas import Style, first_fitting, fitted, shortened
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
        (mark, style, _), wordings = OUTCOMES[story.outcome], _endings(story)
    elif story.stuck[t]:
        led = "stuck: led around the squares"
        mark, style, wordings = "~", Style.DELAY, [f"{led} until the straight way is free", led, "stuck"]
    elif close:
        mark, style, wordings = "!", Style.DANGER, _approaches(story, *close[-1])
    else:
        words = "no step too close so far" if t else "at the start"
        return Text(first_fitting([f" {words}", " nobody close"], columns), Style.DIM)
    words, semicolon, more = first_fitting(wordings, columns - 3).partition(";")
    return Text.assemble((f" {mark} ", style), (words, "bold" if t == story.last else ""), semicolon, more)


def _approaches(story: Story, first: int, last: int) -> list[str]:
    """Wordings of when in the moments `first` to `last` the robot was too close to which element, the longest first."""
    gaps = story.separations[first - 1 : last].min(0)  # of the steps that led to these moments
    row, gap = int(gaps.argmin()) + 1, f"{gaps.min():.2f} m"
    when = " to ".join(f"{story.time[moment]:.2f}" for moment in sorted({first, last}))
    return [f"too close {when} s ({story.called(row)}, {gap})", *shortened(f"{gap} to {glyph_of(row)}, {when} s", ", ")]


def _endings(story: Story) -> list[str]:
    """Wordings of the outcome and of how long the robot was too close or stuck, the longest first."""
    time, distance = f"{story.time[-1]:.2f} s", f"{length(story.goal[0] - story.position[-1, 0]):.2f} m"
    names, glyphs = " and ".join(map(story.called, story.hit)), " and ".join(map(glyph_of, story.hit))
    words, fewer = {
        "success": (f"goal reached after {time}", "goal reached"),
        "collision": (f"collision at {time}: hit {names}", f"collision at {time}: hit {glyphs}"),
        "timeout": (f"time is up at {time}, {distance} from the goal", f"time is up, {distance} to go"),
    }[story.outcome]
    close = sum(last - first + 1 for first, last in story.close) * story.time[1]  # s
    stuck = story.stuck.sum() * story.time[1]  # s
    words += f"; too close for {close:.2f} s" if close else "; never too close"
    words += f"; stuck for {stuck:.2f} s" if stuck else ""
    return [*shortened(words, "; "), fewer, OUTCOMES[story.outcome][2]]
