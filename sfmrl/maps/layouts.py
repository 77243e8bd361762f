"""Twenty scenes that no environment samples, drawn in text: traps, corridors, rooms, and squares at random.

In the format of maps of one's own (`format.py`), but the robot's start and goal are (0, -4) and (0, 4) where they are
not drawn, and always exactly there. All can be solved but `closed`, which is left out of the twenty.
"""

from dataclasses import replace

import numpy as np

from sfmrl.maps.format import Drawing, parse

_DRAWINGS = """
u
  #####
  #...#
  #...#

deep-u
  #####
  #...#
  #...#
  #...#
  #...#

wide-u
  #########
  #.......#
  #.......#

double-u
  #####
  #...#
  #...#
  .....
  .....
  #####
  #...#
  #...#

nested-u
  #########
  #.......#
  #.......#
  #..###..#
  #..#.#..#
  #..#.#..#

v
  ....#....
  ...#.#...
  ..#...#..
  .#.....#.
  #.......#

l
  ######
  .....#
  .....#
  .....#

s
  #######....
  ...........
  ...........
  ...........
  ....#######

zigzag
  ########...
  ...........
  ...........
  ...########
  ...........
  ...........
  ########...

narrow-corridor
  #..#
  #..#
  #..#
  #..#
  #..#
  #..#

corridor-people
  #.1.#
  #...#
  #...#
  #...#
  #...#
  #.2.#

door-people
  ...1...2...
  ...........
  ...........
  ####...####
  ...........
  ...........
  ...3....4..

room
  ...G...
  .......
  .......
  .......
  .......
  #######
  #.....#
  #.....#
  #..R..#
  #.....#
  ##...##

goal-room
  ##...##
  #.....#
  #..G..#
  #.....#
  #######
  .......
  .......
  .......
  .......
  ...R...

sparse-1
  ..1.#......
  ......#....
  .........##
  ...........
  ..#..#.....
  ..#......2.
  ...........
  #......3...
  #..#.......

sparse-2
  .......#...
  ....##....#
  .1...#.....
  ..........#
  ..#..#.....
  ..#......2.
  ...........
  ..#.....3..
  ...........

medium-1
  .#...#....#
  ...........
  ...1.#....#
  .........##
  .#....#....
  ..#........
  .........#.
  .#.2.#...#.
  ....#..#...

medium-2
  .....#..#.#
  ...#......#
  ..1...#....
  .#.....###.
  .##........
  #.#........
  ......#....
  .#.......2.
  .......#...

dense-1
  .#....##.##
  .##........
  .....#.....
  ..#.##..#..
  ..#........
  #.#.....#.#
  .#..#......
  #..#.......
  ..........#

dense-2
  .#.........
  ....#.#.###
  ...........
  .#.........
  ...........
  #.....####.
  ....#.#....
  #.#....#.#.
  ...#..#..##

closed
  ..G..
  .....
  .....
  #####
  #...#
  #.R.#
  #...#
  #####
"""


def _read() -> dict[str, Drawing]:
    """The drawings by name."""
    layouts = {}
    for block in _DRAWINGS.strip().split("\n\n"):
        name, _, text = block.partition("\n")
        drawing = parse(text, name, whole=False)
        robot = np.arange(len(drawing.start)) == 0
        layouts[name] = replace(drawing, leeway=np.where(robot, 0.0, drawing.leeway))
    return layouts


LAYOUTS = _read()
MAPS = tuple(name for name in LAYOUTS if name != "closed")
DRAWN = "map:"  # begins the name of an environment that is a drawing, its lines joined by "/"


def drawing_of(environment: str) -> Drawing | None:
    """The drawing that an environment's name stands for ("map-u", "map:R.#.G/..#.."); None where it is no such name.

    Raises ConfigError where the name is a drawing that cannot be read.
    """
    if environment.startswith(DRAWN):
        return parse(environment.removeprefix(DRAWN).replace("/", "\n"))
    return LAYOUTS.get(environment.removeprefix("map-")) if environment.startswith("map-") else None
