"""Standing polygons as edges, prepared once for a scene.

What an agent must know of an edge does not change while the scene plays: where it runs, in which direction the outline
goes on at either end, and whether it turns outwards there. `polygon_edges` computes it; `orca_polygons.py` reads it.
Left out: polygons that move, and outlines that cross themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FIELDS = 15


@dataclass(frozen=True)
class Edges:
    """The polygons' edges of E episodes: `values` is float32 (15, S, E), NaN from each episode's last edge on.

    The first ten rows come in pairs, for an edge's start and end: x; y (m); x; y of the unit direction in which the
    outline goes on from there, away from this edge; whether the corner is convex (1 or 0). Then follow the edge's own
    unit direction x, y; the way x, y (m) from its start to its end, and the negative square of its length. Seen from
    outside, an edge starts at the left.
    """

    values: np.ndarray

    def __len__(self) -> int:
        return self.values.shape[2]

    def take(self, rows: np.ndarray) -> "Edges":
        """The edges of some of the episodes: an index array, a mask or a slice."""
        return Edges(self.values.take(np.arange(len(self))[rows], axis=2))

    def none(self) -> "Edges":
        """The same episodes without an edge."""
        return Edges(self.values[:, :0])

    @staticmethod
    def concatenate(parts: Sequence["Edges"]) -> "Edges":
        """The episodes of all parts, one after the other."""
        most = max(part.values.shape[1] for part in parts)
        values = np.full((FIELDS, most, sum(map(len, parts))), np.nan, np.float32)
        first = 0
        for part in parts:
            values[:, : part.values.shape[1], first : first + len(part)] = part.values
            first += len(part)
        return Edges(values)


def polygon_edges(polygons: np.ndarray) -> Edges:
    """Return the edges of solid polygons (E, P, V, 2) in m, given counter-clockwise; absent vertices are NaN.

    Absent vertices come last in their polygon; two vertices make a wall. Raises ValueError for other shapes, for a
    polygon that is clockwise, and for one with a single vertex or with two equal vertices in a row.
    """
    polygons = np.asarray(polygons, np.float32)
    if polygons.ndim != 4 or polygons.shape[3] != 2:
        raise ValueError(f"polygons must have shape (E, P, V, 2), not {polygons.shape}")
    present = ~np.isnan(polygons).any(axis=3)
    if (present[:, :, 1:] & ~present[:, :, :-1]).any():
        raise ValueError("polygons: absent vertices (NaN) must come after a polygon's last vertex")

    count = present.sum(axis=2)
    episode, polygon, vertex = np.nonzero(present)
    size = count[episode, polygon]
    before, start, end, after = (polygons[episode, polygon, (vertex + shift) % size].T for shift in (-1, 0, 1, 2))
    _check_outlines(start, end, polygons[episode, polygon, 0].T, size, episode * polygons.shape[1] + polygon)
    previous, own, following = _unit(start - before), _unit(end - start), _unit(after - end)
    start_convex = (_det(start - before, end - start) >= 0) | (size == 2)
    end_convex = (_det(end - start, after - end) >= 0) | (size == 2)

    per_episode = count.sum(axis=1)
    slot = np.arange(len(episode)) - (np.cumsum(per_episode) - per_episode)[episode]
    values = np.full((FIELDS, per_episode.max(initial=0), len(polygons)), np.nan, np.float32)
    ends = [start[0], end[0], start[1], end[1], -previous[0], following[0], -previous[1], following[1]]
    edge = end - start
    minus_squared = -(edge[0] * edge[0] + edge[1] * edge[1])
    values[:, slot, episode] = [*ends, start_convex, end_convex, *own, *edge, minus_squared]
    return Edges(values)


def _check_outlines(start, end, first, size, outline):
    """Raise ValueError for edges (2, K), numbered by their `outline`, that are no counter-clockwise polygons."""
    if (size == 1).any():
        raise ValueError("polygons: a polygon needs two vertices (a wall) or more, not one")
    if (start == end).all(axis=0).any():
        raise ValueError("polygons: two equal vertices in a row make an edge without a direction")
    twice_area = np.bincount(outline, _det(start - first, end - first))
    if (twice_area[outline[size > 2]] <= 0).any():
        raise ValueError("polygons: vertices must run counter-clockwise around a solid area")


def _det(a, b):
    """Two-dimensional cross product of vectors (2, ...)."""
    return a[0] * b[1] - a[1] * b[0]


def _unit(vector):
    """Vectors (2, ...) scaled to length 1."""
    return vector * (1 / np.sqrt(vector[0] * vector[0] + vector[1] * vector[1]))
