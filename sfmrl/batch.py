"""Batches of episodes: dataclasses of arrays whose leading axis is the episode."""

from typing import Any, Self

import numpy as np


class Batch:
    """A dataclass of arrays (E, ...), of parts with a `take` of their own, and of settings that all episodes share."""

    def __len__(self) -> int:
        return len(next(iter(vars(self).values())))  # of the first field

    def take(self, rows: int | np.ndarray | slice | list[int]) -> Self:
        """The same for some of the episodes, chosen by an index, an index array, a mask or a slice."""
        index = np.atleast_1d(np.arange(len(self))[rows])
        return type(self)(**{name: _taken(part, index) for name, part in vars(self).items()})


def _taken(part: Any, index: np.ndarray) -> Any:
    """The rows `index` of an array, of each array in a dictionary, or of a part with `take`; settings as they are."""
    if isinstance(part, np.ndarray):
        return part.take(index, axis=0)  # two to three times as fast as part[index]
    if isinstance(part, dict):
        return {name: _taken(array, index) for name, array in part.items()}
    return part.take(index) if hasattr(part, "take") else part
