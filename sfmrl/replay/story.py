"""One episode as arrays over its moments: all that the replay draws and `sfmrl explain` lists.

An episode of T steps has T + 1 moments; step t leads from moment t to moment t + 1. The reward, separations and events
of a moment are those of the step that led to it; its action values are those of the step that starts there, as the
policy noted them in play. Attention is computed here, for all moments at once, because the last moment needs it, too.
"""

from dataclasses import dataclass
from string import ascii_letters, digits
from typing import cast

import numpy as np

from sfmrl.actions import Policy
from sfmrl.config import Reward
from sfmrl.episodes import Record
from sfmrl.geometry import length
from sfmrl.lookahead import Lookahead, SarlPolicy, step_discount
from sfmrl.rewards import OwnReward, reward_terms, too_close, total
from sfmrl.sfm import repulsive_forces

ELEMENT_GLYPHS = digits[1:] + ascii_letters
LOOKAHEAD_NOTES = {"actions", "values", "best"}  # the notes of a `SarlPolicy`


@dataclass(frozen=True)
class Story:
    """The T + 1 moments of one episode of N agents and K = N - 1 elements; absent elements are NaN."""

    name: str  # environment and episode
    time: np.ndarray  # (T + 1,) s
    time_limit: float  # s
    position: np.ndarray  # (T + 1, N, 2) m
    velocity: np.ndarray  # (T + 1, N, 2) m/s
    goal: np.ndarray  # (N, 2) m
    radius: np.ndarray  # (N,) m; half a square's side
    square: np.ndarray  # (N,) bool
    gap: np.ndarray  # (T + 1, K) m, between the robot's edge and the element's
    force: np.ndarray  # (T + 1, K, 2) m/s^2, repulsion of each element on the robot
    separations: np.ndarray  # (T, K) m, smallest gap during each step; +inf where absent
    terms: dict[str, np.ndarray]  # terms of the reward by name, (T,) each
    returns: np.ndarray  # (T + 1,) discounted sum of the rewards up to the moment
    outcome: str  # "success", "collision" or "timeout"
    close: tuple[tuple[int, int], ...]  # first and last moment of each stretch in which the robot is too close
    attention: np.ndarray | None  # (T + 1, K); None for a policy without attention
    look: Lookahead | None  # of the T steps; None for a policy that does not look ahead
    stuck: np.ndarray  # (T,) bool, the steps in which recovery chose the action
    heading: np.ndarray | None = None  # (T + 1,) rad, where a unicycle robot points; None for a holonomic one

    @property
    def last(self) -> int:
        """The last moment, T."""
        return len(self.time) - 1

    @property
    def hit(self) -> np.ndarray:
        """Rows of the elements that the robot collided with; empty without a collision."""
        return 1 + np.flatnonzero((self.separations[-1] < 0) & (self.outcome == "collision"))

    @property
    def taken(self) -> np.ndarray:
        """Which of the actions in `look` was taken in each step, (T,)."""
        return length(cast(Lookahead, self.look).actions - self.velocity[1:, 0, None]).argmin(1)

    def called(self, row: int | np.integer) -> str:
        """An element's name: "person 3", "square 8"."""
        return f"{'square' if self.square[row] else 'person'} {glyph_of(row)}"


def glyph_of(row: int | np.integer) -> str:
    """The one character that stands for the element in a row: 1 to 9, then letters, then "+"."""
    return ELEMENT_GLYPHS[row - 1] if row <= len(ELEMENT_GLYPHS) else "+"


def scene_name(environment: str, episode: int) -> str:
    """Environment and episode in words."""
    named = {"own": "own scene", "map": "map"}.get(environment, f"environment {environment}")
    return f"{named} · episode {episode}"


def make_story(record: Record, policy: Policy | None, reward: Reward | OwnReward, discount: float) -> Story:
    """The story of the first episode of a record of `policy`; returns have the `discount` per second at 1 m/s.

    It has attention, values and stuck steps if the record has notes (`play_episodes(keep=True)`).
    """
    record = record.take([0])
    scenes, steps = record.scenes, int(record.steps[0])
    moments = record.world_at(np.zeros(steps + 1, dtype=int), np.arange(steps + 1))
    step = record.transition[0, :steps]
    terms = reward_terms(reward)(step)
    factors = step_discount(discount, scenes.v_pref[0, 0], record.simulation) ** np.arange(steps)
    close = too_close(step, reward if isinstance(reward, Reward) else Reward())
    notes = {name: array[0, :steps] for name, array in record.notes.items()}
    looks = notes.keys() >= LOOKAHEAD_NOTES and hasattr(policy, "attention") and len(scenes.radius[0]) > 1
    return Story(
        name=scene_name(scenes.environment[0], scenes.episode[0]),
        time=moments.time,
        time_limit=max(record.simulation.time_limit, moments.time[-1]),
        position=moments.position,
        velocity=moments.velocity,
        goal=scenes.goal[0],
        radius=scenes.radius[0],
        square=scenes.square[0],
        gap=moments.gap,
        force=repulsive_forces(moments.position[:, :1] - moments.position[:, 1:]),
        separations=step.separations,
        terms=terms,
        returns=np.concatenate(([0.0], np.cumsum(total(terms) * factors))),
        outcome=str(record.outcome[0]),
        close=_stretches(1 + np.flatnonzero(close)),
        attention=cast(SarlPolicy, policy).attention(moments) if looks else None,
        look=Lookahead(notes["actions"], notes["values"], notes["best"]) if looks else None,
        stuck=notes.get("stuck", np.zeros(steps, dtype=bool)),
        heading=moments.heading,
    )


def _stretches(numbers: np.ndarray) -> tuple[tuple[int, int], ...]:
    """First and last number of each run of consecutive ones among increasing integers."""
    runs = np.split(numbers, 1 + np.flatnonzero(np.diff(numbers) > 1)) if len(numbers) else []
    return tuple((int(run[0]), int(run[-1])) for run in runs)
