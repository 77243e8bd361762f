"""Twenty scenes that no environment samples, drawn in text: traps, corridors, rooms, and squares at random.

A character is a place of 0.6 m x 0.6 m about the middle of the world: `#` a square, a digit a person bound for the
opposite point (as in CRI), `R` and `G` the robot's start and goal where they are not (0, -4) and (0, 4). All can be
solved but `closed`, which is left out of the twenty.
"""

import numpy as np

CELL = 0.6  # m, the side of a square

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


def _read() -> dict[str, dict[str, np.ndarray]]:
    """By name and character, the places (n, 2) in m where a drawing has it."""
    layouts = {}
    for block in _DRAWINGS.strip().split("\n\n"):
        name, *lines = block.split("\n")
        cells = np.array([list(line.strip()) for line in lines])
        rows, columns = cells.shape
        row, column = np.nonzero(cells != ".")
        places = CELL * np.stack((column - (columns - 1) / 2, (rows - 1) / 2 - row), axis=-1)
        characters = cells[row, column]
        layouts[name] = {str(c): places[characters == c] for c in np.unique(characters)}
    return layouts


LAYOUTS = _read()
MAPS = tuple(name for name in LAYOUTS if name != "closed")


def elements_of_map(name: str) -> int:
    """How many people and squares a layout has."""
    return sum(len(places) for character, places in LAYOUTS[name].items() if character not in "RG")
