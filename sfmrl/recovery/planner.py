"""Geodesic distances to the goal, around the squares, on a grid, for many scenes at once.

A cell's distance is the length of the shortest path over the grid. Its steps go in 24 directions, so a path is at most
1.4 % longer than the shortest one through the same cells; but a passage less than 1.5 cells wider than the robot may be
closed by the grid, and then the path leads around. Sweeps over the rows and columns in both directions compute it, and
are repeated until no distance changes (fast sweeping: Zhao, 2005). Cells in which the robot would touch a square count
10,000 times their length, cells within `inflation` of one 10 times, so every place has a finite distance, even inside a
square. People are left out, since they move on. Squares beyond the robot's reach are ignored, and the path to a goal
beyond its reach leads around squares to the point where the straight line to the goal leaves the reach.
"""

import math
from dataclasses import dataclass

import numpy as np

from sfmrl.config import ConfigError, Planner, counted
from sfmrl.geometry import length
from sfmrl.scenes import Scenes

BLOCK = 64  # scenes at a time: few enough for their grids to stay in the cache
REACH = 60.0  # m: the least reach around the robot's start; no map is wider
MOST_ACROSS, MOST_CELLS = 4096, 2**29  # cells of a grid in x and in y, and of all grids together (2 GiB)
AT_ONCE = 2**22  # cells of all grids in a block
MARGIN = 1.0  # m that a grid reaches beyond the robot's start, its goal and the squares
# Oblique steps as (cells ahead, cells aside); those of a group have the same length.
STEPS = (((1, 1),), ((1, 2), (2, 1)), ((1, 3), (3, 1)))
PAD = 3  # the most cells that a step goes aside
NARROW = 10.0  # cost of a metre on which the robot is closer to a square than `inflation`
SOLID = 1e4  # ... and of a metre on which it touches one
UNREACHABLE = 500.0  # m: longer than any detour, shorter than a cell of a square
FARTHEST = 150.0  # m from the robot's start to squares that `shortest_path` heeds, for which a grid has room
TOGETHER = MOST_CELLS // MOST_ACROSS**2  # scenes whose grids together are never too large
NO_INFLATION = Planner(inflation=0.0)  # no cost beside squares; touching one is SOLID
GRID_ERROR = 1.015  # a path that is less than this much longer than the straight line counts as straight


@dataclass(frozen=True)
class Geodesics:
    """Distances to the goal over the grids of E scenes; a metre near a square counts as 10 m, one inside as 10,000 m.

    values (E, Y, X): m, float32, +inf beyond a scene's own grid
    corner (E, 2): m, where the first cell's centre is
    size (E, 2): how many cells a grid has in x and y
    beyond (E,): m, how far the goal lies beyond the robot's reach; 0 for goals within reach
    resolution: m, side of a cell
    """

    values: np.ndarray
    corner: np.ndarray
    size: np.ndarray
    beyond: np.ndarray
    resolution: float

    def at(self, scene: np.ndarray, position: np.ndarray) -> np.ndarray:
        """Weighted distances in m, (e, ...), from positions (e, ..., 2), whose first axis has the scenes (e,).

        Interpolated between the centres of four free cells. If one of the four is not free, the path goes straight to
        the one from which it is shortest. From outside a grid, it first goes straight to the grid's edge.
        """
        axes = (slice(None),) + (None,) * (position.ndim - 2)
        place = (position - self.corner[scene][*axes, :]) / self.resolution
        inside = np.clip(place, 0.0, (self.size[scene] - 1)[*axes, :])
        cell = np.minimum(inside.astype(int), (self.size[scene] - 2)[*axes, :])
        share, off = inside - cell, place - inside
        x, y, scene = cell[..., 0], cell[..., 1], scene[axes]
        mixed, shortest, least, most = 0.0, np.inf, np.inf, 0.0
        for dx in (0, 1):
            for dy in (0, 1):
                value = self.values[scene, y + dy, x + dx].astype(float)
                away = np.abs(share - (dx, dy))
                mixed = mixed + value * (1 - away[..., 0]) * (1 - away[..., 1])
                shortest = np.minimum(shortest, value + length(away) * self.resolution)
                least, most = np.minimum(least, value), np.maximum(most, value)
        free = most - least < 1.5 * self.resolution  # a diagonal step is the longest between free cells
        return np.where(free, mixed, shortest) + length(off) * self.resolution + self.beyond[scene]


def plan(scenes: Scenes, planner: Planner = Planner(), reach: np.ndarray | None = None) -> Geodesics:
    """The distances to the robot's goal in every scene, around its squares.

    `reach` (E,) is how far the robot can go, in m; by default, as far as its goal. Raises ConfigError where the grids
    would be too large, or too coarse for the squares.
    """
    robot, goal = scenes.start[:, 0], scenes.goal[:, 0]
    way = length(goal - robot)
    reach = np.maximum(REACH, way if reach is None else reach)
    beyond = way > reach
    goal = np.where(beyond[:, None], robot + (goal - robot) * (reach / np.where(beyond, way, 1.0))[:, None], goal)
    apart = np.abs(scenes.start - robot[:, None]).max(-1)
    square = scenes.square & (apart - scenes.radius <= reach[:, None])
    least = 1.25 * planner.resolution  # with less, an oblique step could lead through a square
    if (square & (scenes.radius + scenes.radius[:, :1] < least)).any():
        raise ConfigError(
            f"paths around squares need a robot and squares whose radii add up to {least:g} m or more, for a grid of "
            "this resolution; choose larger ones or a finer --resolution"
        )
    places = np.where(square[..., None], scenes.start, np.nan)
    places[:, 0] = robot
    places = np.concatenate((places, goal[:, None]), axis=1)
    # A path around a square keeps the robot's radius from the outline, which can be farther out than MARGIN.
    around = scenes.radius + scenes.radius[:, :1] + planner.inflation + 2 * planner.resolution
    margin = np.where(square, np.maximum(around, MARGIN), MARGIN)
    margin = np.concatenate((margin, np.full((len(scenes), 1), MARGIN)), axis=1)[..., None]
    corner = np.floor(np.nanmin(places - margin, axis=1) / planner.resolution) * planner.resolution
    size = np.ceil((np.nanmax(places + margin, axis=1) - corner) / planner.resolution) + 1
    columns, rows = size.max(axis=0, initial=0)
    if max(columns, rows) > MOST_ACROSS or len(scenes) * rows * columns > MOST_CELLS:
        raise ConfigError(
            f"paths around squares need {counted(len(scenes), 'grid')} of {columns:.0f} x {rows:.0f} cells, too many; "
            "choose nearer goals, a shorter time limit, a coarser resolution, fewer episodes, or play without recovery"
        )
    size = size.astype(int)
    values = np.full((len(scenes), int(rows), int(columns)), np.inf, dtype=np.float32)
    block = max(1, min(BLOCK, AT_ONCE // max(1, values[:1].size)))
    for e in range(0, len(scenes), block):
        part = slice(e, e + block)
        grid = _distances(scenes.take(part), goal[part], square[part], corner[part], size[part], planner)
        values[part, : grid.shape[1], : grid.shape[2]] = grid
    return Geodesics(values, corner, size, np.where(beyond, way - reach, 0.0), planner.resolution)


def solvable(scenes: Scenes) -> np.ndarray:
    """Whether a path leads from the robot's start to its goal without touching a square's outline, (E,).

    A passage may count as closed if it is less than 0.15 m wider than the robot.
    """
    return np.isfinite(shortest_path(scenes))


def shortest_path(scenes: Scenes) -> np.ndarray:
    """Length in m of the shortest path from the robot's start to its goal around the squares' outlines, (E,).

    Around squares, a grid's path is up to 2 % too long on ways of 8 m, and up to 5 % on ways of 2 to 4 m. It is inf
    where the squares leave no path, and straight where there are none; those more than `FARTHEST` from the start are
    ignored. Narrow passages may be closed, as for `solvable`. Outlines count also where gaps are to the discs
    inside (`squares`). Raises ConfigError where a grid would be too large or too coarse.
    """
    straight = length(scenes.goal[:, 0] - scenes.start[:, 0])
    around = straight.copy()
    among_squares = np.flatnonzero((scenes.square & ~np.isnan(scenes.start[..., 0])).any(1))
    for e in range(0, len(among_squares), TOGETHER):
        rows = among_squares[e : e + TOGETHER]
        some, reach = scenes.take(rows), np.minimum(straight[rows], FARTHEST)
        around[rows] = plan(some, NO_INFLATION, reach).at(np.arange(len(rows)), some.start[:, 0])
    around = np.where(around < GRID_ERROR * straight, straight, around)  # straight lines are exact
    return np.where(around - straight < UNREACHABLE, around, np.inf)


def _distances(
    scenes: Scenes, goal: np.ndarray, square: np.ndarray, corner: np.ndarray, size: np.ndarray, planner: Planner
) -> np.ndarray:
    """Distances (E, Y, X) to goals (E, 2) around squares (E, N), on grids as in `Geodesics`, of a few scenes."""
    resolution, episode = planner.resolution, np.arange(len(scenes))
    columns, rows = size.max(axis=0)
    x = corner[:, 0] + resolution * np.arange(columns)[:, None]  # (X, E)
    y = corner[:, 1] + resolution * np.arange(rows)[:, None]  # (Y, E)

    room = np.full((rows, len(scenes), columns), np.inf, dtype=np.float32)  # m from the robot's edge to a square
    for k in np.flatnonzero(square.any(0)):
        side_x, side_y = (np.abs(at - scenes.start[:, k, axis]) - scenes.radius[:, k] for axis, at in enumerate((x, y)))
        dx = np.where(square[:, k], np.maximum(side_x, 0.0), np.inf).T.astype(np.float32)
        dy = np.where(square[:, k], np.maximum(side_y, 0.0), np.inf).astype(np.float32)
        apart = np.sqrt((dx * dx)[None] + (dy * dy)[..., None])
        np.minimum(room, apart - scenes.radius[:, :1].astype(np.float32), out=room)
    cost = np.where(room < resolution / 4, SOLID, np.where(room < planner.inflation, NARROW, 1.0))
    beyond = (np.arange(columns) >= size[:, :1]) | (np.arange(rows)[:, None, None] >= size[:, 1:])
    cost = np.where(beyond, np.inf, resolution * cost).astype(np.float32)

    distance = np.full_like(cost, np.inf)
    goal = (goal - corner) / resolution
    for shift in ((0, 0), (0, 1), (1, 0), (1, 1)):  # the four cells around the goal
        cell = goal.astype(int) + shift
        distance[cell[:, 1], episode, cell[:, 0]] = resolution * length(cell - goal)
    return _shortest(distance, cost).transpose(1, 0, 2)


def _shortest(distance: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Path lengths (Y, E, X) from the cells where `distance` is finite; the `cost` of a step's last cell weights it."""
    turned, cost = _widened(cost.transpose(2, 1, 0)), _widened(cost)
    before: np.ndarray | None = None
    while before is None or not np.array_equal(distance, before):
        before = distance
        distance = _sweep(distance, cost)
        distance = _sweep(distance.transpose(2, 1, 0), turned).transpose(2, 1, 0)
    return distance


def _widened(grid: np.ndarray) -> np.ndarray:
    """A grid (Y, E, X) as (Y, W): the rows of all scenes end to end, between cells of +inf that no step crosses."""
    rows, scenes, columns = grid.shape
    wide = np.full((rows, scenes + 1, PAD + columns), np.inf, dtype=np.float32)
    wide[:, :scenes, PAD:] = grid
    return wide.reshape(rows, -1)


def _sweep(distance: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """`distance` (Y, E, X), shortened by steps from row to row, first upwards and then downwards."""
    rows, scenes, columns = distance.shape
    wide = _widened(distance)
    reached, nearest = np.empty((2, wide.shape[1]), dtype=np.float32)
    for order in (range(1, rows), range(rows - 2, -1, -1)):
        for row in order:
            here = wide[row]
            np.minimum(here, np.add(wide[row - order.step], cost[row], out=reached), out=here)
            for steps in STEPS:
                nearest.fill(np.inf)
                for back, aside in steps:
                    start = row - back * order.step
                    if 0 <= start < rows:
                        inner = nearest[aside:-aside]
                        np.minimum(inner, wide[start, 2 * aside :], out=inner)
                        np.minimum(inner, wide[start, : -2 * aside], out=inner)
                np.multiply(cost[row], np.float32(math.hypot(*steps[0])), out=reached)
                np.minimum(here, np.add(reached, nearest, out=reached), out=here)
    return wide.reshape(rows, scenes + 1, PAD + columns)[:, :scenes, PAD:]
