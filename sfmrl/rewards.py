"""Rewards as pure functions: the arrays of a transition in, the named terms of the reward out.

`crowd` is CrowdNav's sparse reward, `sfm` the paper's dense one, `sfm-discount` the same with a cost for arriving late.
The simulator judges the episode's end (`outcome`) in CrowdNav's order: time-out, collision, goal, too close. In the
paper's formulas, time-outs have no case (they are worth 0, as in CrowdNav), and discomfort comes before the goal.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import cast

import numpy as np

from sfmrl.batch import Batch
from sfmrl.config import ConfigError, Reward, suggest
from sfmrl.geometry import length
from sfmrl.own_code import checked_array, described, guarded, load, name_of, read_only, source

RUNNING, SUCCESS, COLLISION, TIMEOUT = range(4)
OUTCOMES = np.array(["running", "success", "collision", "timeout"])
REFERENCE_STEP = 0.25  # s, the step for which the terms on the way are defined


@dataclass(frozen=True)
class Transition(Batch):
    """One step of the robot, the input of a reward, with any leading axes (...), e.g. (E,), (E, A) or (E, T).

    time (...): s, at the end of the step
    time_step (...): s, how long the step takes
    velocity_before (..., 2): m/s, the robot's before the step
    velocity (..., 2): m/s, the robot's during the step (its action)
    preferred_velocity (..., 2): m/s, of length v_pref, from the start of the step towards the goal
    goal_distance_before (...): m, from the robot to its goal at the start of the step
    goal_distance (...): m, the same at the end of the step
    separations (..., K): m, smallest gap to each element during the step; +inf where absent
    separation (...): m, the smallest of these; +inf with no elements
    outcome (...): RUNNING, SUCCESS, COLLISION or TIMEOUT
    """

    time: np.ndarray
    time_step: np.ndarray
    velocity_before: np.ndarray
    velocity: np.ndarray
    preferred_velocity: np.ndarray
    goal_distance_before: np.ndarray
    goal_distance: np.ndarray
    separations: np.ndarray
    outcome: np.ndarray

    @property
    def separation(self) -> np.ndarray:
        """Smallest gap to any element during the step, m (...); +inf without elements.

        Raises ValueError unless `separations` has the axes of `outcome` and one more.
        """
        gaps, steps = np.shape(self.separations), np.shape(self.outcome)
        if gaps[:-1] != steps or not gaps:
            raise ValueError(f"separations has shape {gaps}; it must have that of outcome, {steps}, and one more axis")
        return np.min(self.separations, axis=-1, initial=np.inf)

    def __getitem__(self, index) -> "Transition":
        """The same with all arrays indexed along their leading axes."""
        return Transition(*(getattr(self, item.name)[index] for item in fields(self)))


Terms = dict[str, np.ndarray]
OwnReward = Callable[[Transition, Reward], np.ndarray]


def crowd_terms(transition: Transition, p: Reward) -> Terms:
    """CrowdNav's reward, the paper's equation 6, with the numbers in `p`: terms by name, each (...).

    The discomfort is for a step of 0.25 s; other steps pay in proportion.
    """
    end, close = np.asarray(transition.outcome), too_close(transition, p)
    gap = np.minimum(transition.separation, p.discomfort_distance)  # a slope of 0 times +inf would be NaN
    discomfort = p.discomfort_slope * (gap - p.discomfort_distance) * (transition.time_step / REFERENCE_STEP)
    return {
        "collision": np.where(end == COLLISION, p.collision, 0.0),
        "goal": np.where(end == SUCCESS, p.success, 0.0),
        "discomfort": np.where(close, discomfort, 0.0),
    }


def sfm_terms(transition: Transition, p: Reward) -> Terms:
    """The paper's Social Force Model reward, its equation 7: terms by name, each (...).

    In the paper's symbols, v is the robot's velocity during the step, v_pref its preferred velocity at the step's
    start, and d_g the distance to the goal at the step's end. The terms on the way are for a step of 0.25 s; others pay
    in proportion.
    """
    end, close = np.asarray(transition.outcome), too_close(transition, p)
    free, scale = (end == RUNNING) & ~close, transition.time_step / REFERENCE_STEP
    gap = np.clip(transition.separation, 0.0, p.discomfort_distance)  # exp must not overflow where it does not count
    deviation = length(p.k * (transition.velocity - transition.preferred_velocity))
    return {
        "collision": np.where(end == COLLISION, p.collision, 0.0),
        "goal": np.where(end == SUCCESS, p.success, 0.0),
        "discomfort": np.where(close, p.discomfort_amplitude * np.exp(-p.discomfort_decay * gap) * scale, 0.0),
        "velocity": np.where(free, (p.k - deviation / 2) * scale, 0.0),
        "distance": np.where(free, -p.distance_weight * transition.goal_distance * scale, 0.0),
    }


def sfm_discount_terms(transition: Transition, p: Reward) -> Terms:
    """`sfm_terms`, minus 0.02 (t - 10) on arrival at t >= 10 s, the paper's temporal discount."""
    late = np.maximum(transition.time - p.discount_start, 0.0)
    arrived = np.asarray(transition.outcome) == SUCCESS
    return sfm_terms(transition, p) | {"discount": np.where(arrived, -p.discount_rate * late, 0.0)}


def too_close(transition: Transition, p: Reward) -> np.ndarray:
    """Which steps (...) come closer to an element than the discomfort distance and do not end the episode."""
    return (np.asarray(transition.outcome) == RUNNING) & (transition.separation < p.discomfort_distance)


REWARDS = {"crowd": crowd_terms, "sfm": sfm_terms, "sfm-discount": sfm_discount_terms}


def reward_terms(reward: str | Reward | OwnReward) -> Callable[[Transition], Terms]:
    """The reward as a function from a transition to terms by name, which add up to the reward.

    A user's own reward (a function, or its name `file.py:function` or `package.module:function`) takes (transition,
    settings) and returns an array (...), which becomes the one term "reward". It gets read-only copies of the arrays;
    one given as a function gets the settings `Reward()`. Each number may depend on its own transition alone, since the
    transitions in a call vary, for instance with the number of threads; several threads may call it at once. Raises
    ConfigError if there is no such reward, and if a user's own fails or returns another shape or numbers that are not
    finite; UntrustedReward if only a file names it.
    """
    if callable(reward):
        return partial(_own_terms, reward, Reward(), name_of(reward))
    if not isinstance(reward, (str, Reward)):
        raise ConfigError(
            f"reward is {described(reward)}; it takes a name, a Reward, or a function of (transition, settings)"
        )
    settings = Reward(reward=reward) if isinstance(reward, str) else reward
    name = settings.reward
    if name in REWARDS:
        return partial(REWARDS[name], p=settings)  # a lambda could not be pickled
    if ":" not in name:
        known = ", ".join(REWARDS)
        raise ConfigError(
            f"there is no reward {name!r}; choose {known}, or your own as file.py:function{suggest(name, REWARDS)}"
        )
    return partial(_own_terms, load(name), settings, name)


def total(terms: Terms) -> np.ndarray:
    """The sum of a reward's terms, (...), added in their order."""
    return cast(np.ndarray, sum(terms.values()))  # there is always a term


def _own_terms(own: OwnReward, settings: Reward, name: str, transition: Transition) -> Terms:
    who = f"reward {name}"
    paid = guarded(who, "failed", source(own), lambda: own(read_only(transition), settings))
    return {"reward": checked_array(who, own, paid, np.shape(transition.outcome), "one number per transition")}
