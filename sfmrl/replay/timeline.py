"""What happened when: the time of an episode as a line of marks, and its latest event as a sentence."""

from rich.text import Text

from sfmrl.replay.canvas import DANGER, DELAY, DIM, GOAL, ROBOT, fitted
from sfmrl.replay.story import Story, glyph_of

OUTCOMES = {  # mark, style of the mark, words
    "success": ("★", GOAL, "goal reached"),
    "collision": ("X", DANGER, "collision"),
    "timeout": ("T", DELAY, "time is up"),
}


def timeline(story: Story, t: int, columns: int) -> Text:
    """The time from 0 to the limit as a line: where the robot is too close (!) or stuck (~), now (●), the outcome."""
    left, right = " 0 s ", f" {story.time_limit:g} s "
    width = max(columns - len(left) - len(right), 1)
    at = (story.time / story.time_limit * (width - 1)).round().astype(int)  # (T + 1,) column of each moment
    cells = [("━", "") if k <= at[t] else ("─", DIM) for k in range(width)]
    for first, last in story.close:
        cells[at[first] : at[last] + 1] = [("!", DANGER)] * (at[last] + 1 - at[first])
    for step in story.stuck.nonzero()[0]:
        cells[at[step] : at[step + 1]] = [("~", DELAY)] * (at[step + 1] - at[step])
    cells[at[t]] = ("●", ROBOT)
    cells[at[-1]] = OUTCOMES[story.outcome][:2]
    return fitted(Text.assemble((left, DIM), *cells, (right, DIM)), columns)


def sentence(story: Story, t: int, columns: int = 80) -> Text:
    """The outcome at the end; before, that the robot is stuck, or when it was last too close and to which element.

    If the longest wording does not fit into `columns`, it is the next shorter one.
    """
    close = [(first, min(last, t)) for first, last in story.close if first <= t]
    if t == story.last:
        (mark, style, _), wordings = OUTCOMES[story.outcome], _endings(story)
        texts = [Text.assemble((f" {mark} ", style), (head, "bold"), rest) for head, rest in wordings]
    elif story.stuck[t]:
        wordings = ("stuck: led around the squares until the straight way is free", "stuck: led around the squares")
        texts = [Text.assemble((" ~", DELAY), f" {words}") for words in wordings]
    elif close:
        first, last = close[-1]
        gaps = story.separations[first - 1 : last].min(0)  # of the steps that led to these moments
        row, gap = int(gaps.argmin()) + 1, f"{gaps.min():.2f} m"
        when = " to ".join(f"{story.time[moment]:.2f}" for moment in sorted({first, last}))
        wordings = (f"too close {when} s ({story.called(row)}, {gap})", f"{gap} to {glyph_of(row)}, {when} s")
        texts = [Text.assemble((" !", DANGER), f" {words}") for words in wordings]
    else:
        texts = [Text(" too close to nobody so far" if t else " at the start", DIM)]
    return next((text for text in texts if text.cell_len <= columns), texts[-1])


def _endings(story: Story) -> list[tuple[str, str]]:
    """The outcome in words and how long the robot was too close or stuck, from the longest wording to the shortest."""
    time, distance = f"{story.time[-1]:.2f} s", f"{story.goal_distance:.2f} m"
    names, glyphs = " and ".join(map(story.called, story.hit)), " and ".join(map(glyph_of, story.hit))
    words, fewer = {
        "success": (f"goal reached after {time}",) * 2,
        "collision": (f"collision at {time}: hit {names}", f"collision at {time}: hit {glyphs}"),
        "timeout": (f"time is up at {time}, {distance} from the goal", f"time is up, {distance} to go"),
    }[story.outcome]
    close = sum(last - first + 1 for first, last in story.close) * story.time[1]  # s
    stuck = story.stuck.sum() * story.time[1]  # s
    before = f"; too close for {close:.2f} s" if close else "; never too close"
    led = f"; stuck for {stuck:.2f} s" if stuck else ""
    return [(words, before + led), (words, before), (words, ""), (fewer, "")]
