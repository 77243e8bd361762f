"""SARL that values each moment once, for tests of the same episodes without and then with recovery."""

import numpy as np

from sfmrl.config import Config
from sfmrl.lookahead import SarlPolicy
from sfmrl.world import World


class RememberingPolicy(SarlPolicy):
    """SARL that stores its values of every moment, so that playing the same moment again costs nothing.

    An episode with recovery is the same as without until the robot is stuck or near a trap.
    """

    def __init__(self, network, config: Config, threads: int = 1) -> None:
        super().__init__(network, config, threads)
        self._judged: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}

    def judge(self, world: World, crowd_velocity: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As SARL's, from memory where possible; a moment's key needs no `crowd_velocity`, which follows from it."""
        numbers = zip(world.episode.tolist(), world.steps.tolist(), strict=True)
        heading = np.zeros(len(world)) if world.heading is None else world.heading
        moments = zip(numbers, world.position, world.velocity, heading, strict=True)
        keys = [(number, *(part.tobytes() for part in parts)) for number, *parts in moments]
        new = np.flatnonzero([key not in self._judged for key in keys])
        if len(new):
            judged = super().judge(world.take(new), crowd_velocity[new], actions[new])
            self._judged |= zip((keys[row] for row in new), zip(*judged, strict=True), strict=True)
        values, outcome = zip(*(self._judged[key] for key in keys), strict=True)
        return np.array(values), np.array(outcome)
