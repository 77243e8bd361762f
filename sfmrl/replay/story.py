"""What there is to tell of one episode, moment by moment: numbers only, computed for all moments at once.

An episode of T steps has T + 1 moments; step t leads from moment t to moment t + 1. A moment's reward, separation
and events are those of the step that has led to it; its actions' values are those of the step to come.
"""

from dataclasses import dataclass, replace

import numpy as np

from sfmrl.config import Config, Reward
from sfmrl.crowd import reset
from sfmrl.episodes import Record
from sfmrl.lookahead import Lookahead
from sfmrl.recovery import RecoveringPolicy
from sfmrl.rewards import RUNNING, reward_terms, total
from sfmrl.sfm import repulsive_forces

NUMBERS = "123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"


@dataclass(frozen=True)
class Story:
    """One episode's T + 1 moments, of N agents and K = N - 1 elements; absent elements are NaN.

    `terms` are the reward's by name, each (T,). `attention` and `look` are there for policies that have them.
    """

    name: str  # environment and episode, in words
    time: np.ndarray  # (T + 1,) s
    time_limit: float  # s
    position: np.ndarray  # (T + 1, N, 2) m
    velocity: np.ndarray  # (T + 1, N, 2) m/s
    start: np.ndarray  # (N, 2) m
    goal: np.ndarray  # (N, 2) m
    radius: np.ndarray  # (N,) m
    square: np.ndarray  # (N,) bool
    gap: np.ndarray  # (T + 1, K) m, from the robot's edge to the element's at the moment
    force: np.ndarray  # (T + 1, K, 2) m/s^2, each element's repulsion on the robot
    separations: np.ndarray  # (T, K) m, the smallest gaps in each step; +inf where absent
    terms: dict[str, np.ndarray]  # (T,) each
    returns: np.ndarray  # (T + 1,) discounted sum of the rewards so far
    outcome: str
    goal_distance: float  # m, in the end
    close: tuple[tuple[int, int], ...]  # first and last moment of every stretch at which the robot was too close
    attention: np.ndarray | None  # (T + 1, K)
    look: Lookahead | None  # of T steps
    stuck: np.ndarray  # (T,) bool, the steps in which recovery chose

    @property
    def last(self) -> int:
        """The last moment, T."""
        return len(self.time) - 1

    @property
    def hit(self) -> np.ndarray:
        """The elements (their rows) that the robot ran into, none if it did not."""
        return 1 + np.flatnonzero(self.separations[-1] < 0) if self.outcome == "collision" else np.zeros(0, dtype=int)

    def called(self, row: int) -> str:
        """What an agent's row is called: "person 3", "square 8"."""
        return f"{'square' if self.square[row] else 'person'} {number(row)}"


def number(row: int) -> str:
    """The one character that stands for an element's row: 1 to 9, then letters, "+" when those are used up."""
    return NUMBERS[row - 1] if row <= len(NUMBERS) else "+"


def scene_name(environment: str, episode: int) -> str:
    """Environment and episode in words."""
    named = {"own": "own scene", "map": "map"}.get(environment, f"environment {environment}")
    return f"{named} · episode {episode}"


def tell(record: Record, row: int, policy=None, reward: Reward | None = None, discount: float | None = None) -> Story:
    """The story of the episode in one row of a record, as `policy` sees it.

    `reward` and `discount` default to those that the policy looks ahead with; without either, the record's reward is
    one term and the discount the config's.
    """
    config = getattr(policy, "config", None)
    reward = getattr(config, "reward", None) if reward is None else reward
    discount = getattr(config, "discount", Config.discount) if discount is None else discount
    one = record.take(np.array([row]))
    scenes, steps = one.scenes, int(one.steps[0])
    position, velocity = one.position[0, : steps + 1], one.velocity[0, : steps + 1]
    step = one.transition[0, :steps]
    terms = {"reward": one.reward[0, :steps]} if reward is None else reward_terms(reward)(step)
    factor = discount ** (one.simulation.time_step * scenes.v_pref[0, 0])
    returns = np.concatenate(([0.0], np.cumsum(total(terms) * factor ** np.arange(steps))))
    offset = position[:, :1] - position[:, 1:]  # from the elements to the robot
    moments = replace(reset(scenes, one.simulation).take(np.zeros(steps + 1, dtype=int)), position=position)
    distance = Reward.discomfort_distance if reward is None else reward.discomfort_distance
    near = np.concatenate(([False], (step.outcome == RUNNING) & (step.separation < distance)))
    attention = look = None
    stuck = np.zeros(steps, dtype=bool)
    if isinstance(policy, RecoveringPolicy):
        stuck = policy.watch_all(one.worlds(policy.planner))
    if hasattr(policy, "lookahead") and offset.shape[1]:
        worlds = one.worlds(getattr(policy, "planner", None))
        end = replace(worlds.take(np.array([steps - 1])), position=position[-1:], velocity=velocity[-1:])
        look = policy.lookahead(worlds, velocity[1:])
        attention = np.concatenate((policy.attention(worlds), policy.attention(end)))
    return Story(
        name=scene_name(scenes.environment[0], scenes.episode[0]),
        time=np.arange(steps + 1) * one.simulation.time_step,
        time_limit=max(one.simulation.time_limit, steps * one.simulation.time_step),
        position=position,
        velocity=velocity,
        start=scenes.start[0],
        goal=scenes.goal[0],
        radius=scenes.radius[0],
        square=scenes.square[0],
        gap=moments.gap,
        force=repulsive_forces(offset),
        separations=step.separations,
        terms=terms,
        returns=returns,
        outcome=str(one.outcome[0]),
        goal_distance=float(step.goal_distance[-1]),
        close=_stretches(near),
        attention=attention,
        look=look,
        stuck=stuck,
    )


def _stretches(near: np.ndarray) -> tuple[tuple[int, int], ...]:
    """First and last moment of the stretches that are True, of (T + 1,)."""
    edges = np.diff(np.concatenate(([0], near.astype(int), [0])))
    first, beyond = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    return tuple((int(a), int(b) - 1) for a, b in zip(first, beyond, strict=True))
