"""Scenes drawn in text: one format for the twenty built-in layouts and for maps of your own.

    ; a line that begins with a semicolon is a comment
    #############
    #.....#.....#
    #..R..#..G..#
    #.....#.....#
    #.....#..1..#
    #...........#
    #..a........#
    #############

Each character is a place of 0.6 m x 0.6 m: `#` (or `█`, `■`) a square, `R` (or `@`) the robot's start, `G` (or `★`,
`*`) its goal, `1` to `9` people, `a` to `i` their goals (`a` that of `1`), `.` (or `·`, a blank) nothing. Blanks around
the drawing do not belong to it, dots do. A person without a goal goes to the opposite place, through the middle of the
drawing. The robot is as wide as a place and may not touch a square, so a passage must be two places wide. Beyond the
drawing all is free.

Episodes differ by a little noise: each start is moved by up to 0.1 m in x and in y, as far as it has room, and the
goal by as much the other way. A robot drawn beside a square starts 0.05 m off it.

`format.py` reads a text, `draw.py` writes one. A `Drawing` is an environment; in configs and commands it goes by a
name, "map-u" for a layout and "map:" with the drawing itself, its lines joined by "/", for any other. `environment_of`
in `scenes.py` turns names into drawings, each of them once.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from sfmrl.maps.draw import draw_map, load_map, read_map, why_unsolvable
from sfmrl.maps.format import Drawing, parse
from sfmrl.placement import Builder
from sfmrl.scenes import DRAWN, Environment

__all__ = ["Drawing", "draw_map", "layouts", "load_map", "map_environment", "read_map", "why_unsolvable"]


@cache
def layouts() -> dict[str, Drawing]:
    """The drawings in layouts.txt by the names of their environments ("map-u"); in these the robot has no noise."""
    text = Path(__file__).with_name("layouts.txt").read_text(encoding="utf-8")
    drawings = {}
    for block in text.strip().split("\n\n")[1:]:  # the first is a comment
        name, _, lines = block.partition("\n")
        drawing = parse(lines, name, whole=False)
        leeway = np.append(0.0, drawing.leeway[1:])  # the robot's is 0
        drawings[f"map-{name}"] = replace(drawing, leeway=leeway, label=f"map-{name}")
    return drawings


def map_environment(name: str) -> Drawing | Environment | None:
    """The environment with a map's name, "map-u", "maps" or "map:R.#.G/..#.."; None for other names.

    Raises ConfigError on drawings that cannot be read.
    """
    if name.startswith(DRAWN):
        return parse(name.removeprefix(DRAWN).replace("/", "\n"))
    return _in_turn() if name == "maps" else layouts().get(name)


def _in_turn() -> Environment:
    """The layouts that can be solved, in turn: episode 0 has the first, episode 1 the second, and so on."""
    turn = [drawing for name, drawing in layouts().items() if name != "map-closed"]

    def place(builder: Builder, which: np.ndarray) -> None:
        whose = builder.numbers[which] % len(turn)
        for k in np.unique(whose):
            builder.place(turn[k], which[whose == k])

    return Environment("maps", place, max(drawing.elements for drawing in turn))
