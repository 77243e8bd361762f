"""The legend of a replay: what its symbols, colours and keys mean, shown over a frame."""

from itertools import zip_longest

from rich.text import Text

from sfmrl.replay.canvas import Style, fitted
from sfmrl.replay.panel import SHADES

COLUMNS, SYMBOL_COLUMNS = 40, 8  # of the legend, and of the symbols in it
ENTRIES = (
    ("@", Style.ROBOT, "robot, and where it was"),
    ("★", Style.GOAL, "robot's goal; goal reached"),
    ("1 2 a", Style.PERSON, "people, and where they were"),
    ("█", Style.SQUARE, "square, with its number"),
    ("→", "", "velocity"),
    ("⇒", Style.FORCE, "repulsion on the robot"),
    ("magenta", Style.MOST_ATTENTION, "gets the most attention"),
    (f"{SHADES} o", "", "values of actions; o is next"),
    ("━●─", "", "timeline; ● is now"),
    ("!", Style.DANGER, "too close to an element"),
    ("~", Style.DELAY, "stuck: led around squares"),
    ("X", Style.DANGER, "collision"),
    ("T", Style.DELAY, "time is up"),
    ("space", Style.PERSON, "pause, resume"),
    (", .", Style.PERSON, "one step back, ahead"),
    ("+ -", Style.PERSON, "faster, slower"),
    ("q", Style.PERSON, "quit"),
)


def with_legend(picture: Text, columns: int, lines: int) -> Text:
    """The picture with the legend over its upper left corner, in at most `columns` x `lines`."""
    entries = [Text.assemble(fitted(Text(symbol, style), SYMBOL_COLUMNS), words) for symbol, style, words in ENTRIES]
    box = [
        Text("╭─ legend ".ljust(COLUMNS - 1, "─") + "╮", Style.DIM),
        *(Text.assemble(("│ ", Style.DIM), fitted(entry, COLUMNS - 4), (" │", Style.DIM)) for entry in entries),
        Text("╰".ljust(COLUMNS - 1, "─") + "╯", Style.DIM),
    ]
    box = [fitted(line, min(columns, COLUMNS)) for line in box[:lines]]
    both = zip_longest(box, picture.split(allow_blank=True), fillvalue=Text())
    return Text("\n", no_wrap=True).join(Text.assemble(over, under[len(over) :]) for over, under in both)
