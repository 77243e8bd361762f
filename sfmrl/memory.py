"""A bounded store of states and the values to learn for them, the oldest replaced first."""

from typing import Any

import numpy as np

from sfmrl.states import OWN, column_names, mirrored_columns


class Memory:
    """At most `capacity` states (K, F) with a value each; those of fewer elements are filled up with absent ones.

    With `mirror`, every other state that is taken out is mirrored left to right: it is worth as much.
    """

    def __init__(self, capacity: int, elements: int, *, forces: bool = False, mirror: bool = False) -> None:
        columns, own = len(column_names(forces)), len(OWN) + 2 * forces
        self.mirror = mirrored_columns(forces) if mirror else None
        self.states = np.empty((capacity, elements, columns), dtype=np.float32)
        self.values = np.empty(capacity, dtype=np.float32)
        self.own = own  # the columns from here on are the element's, and NaN where it is absent
        self.size = self.next = 0

    def __len__(self) -> int:
        return self.size

    def push(self, states: np.ndarray, values: np.ndarray) -> None:
        """Add states (S, k, F) with k <= K, and their values (S,), in order."""
        capacity, elements = self.states.shape[:2]
        states, values = states[-capacity:], values[-capacity:]
        where = (self.next + np.arange(len(states))) % capacity
        present = states.shape[1]
        self.states[where, :present] = states
        if present < elements:
            self.states[where, present:, : self.own] = states[:, :1, : self.own]
            self.states[where, present:, self.own :] = np.nan
        self.values[where] = values
        self.next = int((self.next + len(states)) % capacity)
        self.size = min(self.size + len(states), capacity)

    def take(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The states (B, K, F) and values (B,) at some indices."""
        states = self.states[rows]
        if self.mirror is not None:
            states[::2] *= self.mirror
        return states, self.values[rows]

    def state_dict(self) -> dict[str, Any]:
        """All that is stored, for a checkpoint."""
        return {"states": self.states[: self.size], "values": self.values[: self.size], "next": self.next}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Take back what `state_dict` gave."""
        self.size, self.next = len(saved["values"]), saved["next"]
        self.states[: self.size], self.values[: self.size] = saved["states"], saved["values"]
