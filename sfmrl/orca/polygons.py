"""Standing polygons as edges, prepared once for a scene, and the origin from which ORCA's coordinates are taken.

Where an edge runs, how the outline goes on at either end, and whether it turns outwards there do not change while the
scene plays. `polygon_edges` computes them; `edges.py` reads them. Left out: polygons that move, and outlines that cross
themselves.
"""

from dataclasses import dataclass

import numpy as np

from sfmrl.geometry import numbers
from sfmrl.orca.vectors import det, unit

FIELDS = 12
SPACING = 64.0  # m between possible origins; a power of two, so that subtracting one does not round
ON_LINE = np.float32(1e-5)  # m^2, twice the area between a line and an edge that lies on it


@dataclass(frozen=True)
class Edges:
    """The polygons' edges of E episodes: `values` is float32 (12, S, E), NaN from each episode's last edge on.

    The first ten rows come in pairs, for an edge's start and end: x; y (m); x; y of the unit direction in which the
    outline goes on from there, away from this edge; whether the corner is convex (1 or 0). The last two are the edge's
    own unit direction. Seen from outside, an edge starts at the left. Places are relative to the episode's `origin`,
    float64 (E, 2) in m.
    """

    values: np.ndarray
    origin: np.ndarray

    def __len__(self) -> int:
        return self.values.shape[2]

    def take(self, rows: np.ndarray) -> "Edges":
        """The edges of some of the episodes: an index array, a mask or a slice."""
        return Edges(self.values.take(np.arange(len(self))[rows], axis=2), self.origin[rows])

    def none(self) -> "Edges":
        """The same episodes without an edge."""
        return Edges(self.values[:, :0], self.origin)


def polygon_edges(polygons: np.ndarray, position: np.ndarray) -> Edges:
    """Return the edges of solid polygons (E, P, V, 2) in m, given counter-clockwise; two vertices make a wall.

    Absent vertices are NaN and come last in their polygon. `position` (E, N, 2) in m is where the agents are who will
    see them, or where they start. Raises ValueError, which names what is wrong with the polygons.
    """
    polygons = numbers("polygons", polygons)
    if polygons.ndim != 4 or polygons.shape[3] != 2:
        raise ValueError(f"polygons must have shape (E, P, V, 2), not {polygons.shape}")
    if len(polygons) != len(position):
        raise ValueError(f"polygons must belong to {len(position)} episodes, not to {len(polygons)}")
    origin = _origin_among(position)
    present = ~np.isnan(polygons).any(axis=3)
    with np.errstate(over="ignore", invalid="ignore"):
        polygons = (polygons - origin[:, None, None]).astype(np.float32)
    if not np.isfinite(polygons[present]).all():
        raise ValueError("polygons: vertices must be finite, or NaN where they are absent")
    if (present[:, :, 1:] & ~present[:, :, :-1]).any():
        raise ValueError("polygons: absent vertices (NaN) must come after a polygon's last vertex")

    episode, polygon, vertex = np.nonzero(present)
    size = present.sum(axis=2)[episode, polygon]
    before, start, end, after = (polygons[episode, polygon, (vertex + shift) % size].T for shift in (-1, 0, 1, 2))
    first = polygons[episode, polygon, 0 * vertex].T  # no vertex 0 need exist: V may be 0
    _check_outlines(start, end, first, size, episode * polygons.shape[1] + polygon)
    previous, own, following = unit(start - before), unit(end - start), unit(after - end)
    convex = [(det(a, b) >= 0) | (size == 2) for a, b in ((start - before, end - start), (end - start, after - end))]
    ends = [start[0], end[0], start[1], end[1], -previous[0], following[0], -previous[1], following[1]]
    rows = np.stack([*ends, *convex, *own])

    last = present.sum(axis=(1, 2)).cumsum()
    values = np.full((FIELDS, np.diff(last, prepend=0).max(initial=0), len(polygons)), np.nan, np.float32)
    for e, edges in enumerate(np.split(rows, last, axis=1)[:-1]):
        values[:, : edges.shape[1], e] = edges[:, _tree_order(edges[:4])]
    return Edges(values, origin)


def _origin_among(points: np.ndarray) -> np.ndarray:
    """Return the median of points (E, n, 2) in m, rounded to a multiple of 64 m, (E, 2); absent points are NaN.

    float32 has 7 digits, too few to tell people apart in map coordinates. Scenes near (0, 0) have it as their origin.
    """
    if not points.shape[1]:
        return np.zeros((len(points), 2))
    ordered = np.sort(points, axis=1)  # absent ones last
    middle = np.maximum((~np.isnan(ordered)).sum(axis=1, keepdims=True) - 1, 0) // 2
    origin = np.round(np.take_along_axis(ordered, middle, axis=1)[:, 0] / SPACING) * SPACING
    return np.nan_to_num(origin) + 0.0  # no -0, which would change the sign of a 0 when it is subtracted


def _check_outlines(start, end, first, size, outline):
    """Raise ValueError for edges (2, K), numbered by their `outline`, that are no counter-clockwise polygons."""
    if (size == 1).any():
        raise ValueError("polygons: a polygon needs two vertices (a wall) or more, not one")
    if (start == end).all(axis=0).any():
        raise ValueError("polygons: two equal vertices in a row make an edge without a direction")
    twice_area = np.bincount(outline, det(start - first, end - first))
    if (twice_area[outline[size > 2]] <= 0).any():
        raise ValueError("polygons: vertices must run counter-clockwise around a solid area")


def _tree_order(ends):
    """Return the indices of one episode's edges (4, S) in the order of RVO2's search tree.

    The root is the edge whose line divides the others most evenly, of several the first. After it come the edges on
    the left of its line, as a tree of their own, and then those on its right. An edge that the line crosses, which RVO2
    splits, stays whole on the left.
    """
    start, way = ends[::2], ends[1::2] - ends[::2]
    # For each edge's line (rows), twice the areas that it spans with every edge's start and end: > 0 on its left.
    from_line = start[:, None] - start[:, :, None]
    areas = [det(way[:, :, None], to) for to in (from_line, from_line + way[:, None])]
    right = np.minimum(*areas) < -ON_LINE
    left = ~right | (np.maximum(*areas) > ON_LINE)
    np.fill_diagonal(left, False)
    order, trees = [], [np.arange(ends.shape[1])]
    while trees:
        tree = trees.pop()
        if len(tree) > 1:
            lefts, rights = (side[tree].take(tree, axis=1).sum(axis=1) for side in (left, right))
            root = tree[(np.maximum(lefts, rights) * len(tree) + np.minimum(lefts, rights)).argmin()]
            trees += [tree[right[root, tree] & ~left[root, tree]], tree[left[root, tree]]]
            tree = [root]
        order.extend(tree)
    return order
