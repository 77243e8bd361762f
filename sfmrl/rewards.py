"""Rewards as pure functions: a transition's arrays in, the reward's named terms out.

`crowd` is CrowdNav's sparse reward, `sfm` the paper's dense one, `sfm-discount` the same with a cost for arriving late.
The episode's end is judged by the simulator (`outcome`), in CrowdNav's order: time-out, collision, goal, too close;
the paper's formulas are silent on time-outs (worth 0, as in CrowdNav) and list the goal after discomfort.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from sfmrl.batch import Batch
from sfmrl.config import ConfigError, Reward, suggest
from sfmrl.geometry import length
from sfmrl.own_code import checked_array, fault, kind, load, name_of, read_only

RUNNING, SUCCESS, COLLISION, TIMEOUT = range(4)
OUTCOMES = np.array(["running", "success", "collision", "timeout"])


@dataclass(frozen=True)
class Transition(Batch):
    """What a reward is given: one step of the robot, with any leading axes (...), as (E,), (E, A) or (E, T).

    time (...): s, at the end of the step
    time_step (...): s, how long the step takes
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
    velocity: np.ndarray
    preferred_velocity: np.ndarray
    goal_distance_before: np.ndarray
    goal_distance: np.ndarray
    separations: np.ndarray
    outcome: np.ndarray

    @property
    def separation(self) -> np.ndarray:
        """Smallest gap to any element during the step, m (...); +inf with no elements."""
        return self.separations.min(axis=-1, initial=np.inf)

    def __getitem__(self, index) -> "Transition":
        """The transition of some of the leading axes' entries."""
        return Transition(*(getattr(self, item.name)[index] for item in fields(self)))


Terms = dict[str, np.ndarray]


def crowd_terms(transition: Transition, p: Reward) -> Terms:
    """CrowdNav's reward, the paper's first formula; its slope is for a step of 0.25 s: terms by name, each (...)."""
    end, close = _cases(transition, p)
    discomfort = p.discomfort_slope * (transition.separation - p.discomfort_distance) * (transition.time_step / 0.25)
    return {
        "collision": np.where(end == COLLISION, p.collision, 0.0),
        "goal": np.where(end == SUCCESS, p.success, 0.0),
        "discomfort": np.where(close, discomfort, 0.0),
    }


def sfm_terms(transition: Transition, p: Reward) -> Terms:
    """The paper's Social Force Model reward, its second formula: terms by name, each (...).

    v is the robot's velocity in the step, v_pref leads to the goal from where the step starts, d_g is where it ends.
    """
    end, close = _cases(transition, p)
    free = (end == RUNNING) & ~close
    # A gap of +inf (nobody there) or of a deep overlap is never "close"; keep exp away from both.
    gap = np.clip(transition.separation, 0.0, p.discomfort_distance)
    off = length(p.k * (transition.velocity - transition.preferred_velocity))
    return {
        "collision": np.where(end == COLLISION, p.collision, 0.0),
        "goal": np.where(end == SUCCESS, p.success, 0.0),
        "discomfort": np.where(close, p.discomfort_amplitude * np.exp(-p.discomfort_decay * gap), 0.0),
        "velocity": np.where(free, p.k - off / 2, 0.0),
        "distance": np.where(free, -p.distance_weight * transition.goal_distance, 0.0),
    }


def sfm_discount_terms(transition: Transition, p: Reward) -> Terms:
    """`sfm_terms`, less 0.02 (t - 10) on arrival at t >= 10 s, the paper's temporal discount."""
    late = np.maximum(transition.time - p.discount_start, 0.0)
    arrived = transition.outcome == SUCCESS
    return sfm_terms(transition, p) | {"discount": np.where(arrived, -p.discount_rate * late, 0.0)}


def _cases(transition: Transition, p: Reward) -> tuple[np.ndarray, np.ndarray]:
    end = np.asarray(transition.outcome)
    return end, (end == RUNNING) & (transition.separation < p.discomfort_distance)


OwnReward = Callable[[Transition, Reward], np.ndarray]
REWARDS: dict[str, Callable[[Transition, Reward], Terms]] = {
    "crowd": crowd_terms,
    "sfm": sfm_terms,
    "sfm-discount": sfm_discount_terms,
}


def as_reward(reward: str | Reward | OwnReward) -> Reward | OwnReward:
    """What `reward_terms` takes, from a reward's name too; raises ConfigError for anything else."""
    if isinstance(reward, str):
        return Reward(reward=reward)
    if isinstance(reward, Reward) or callable(reward):
        return reward
    raise ConfigError(f"reward is {kind(reward)}; it takes a name, a Reward, or a function of (transition, settings)")


def reward_terms(reward: Reward | OwnReward) -> Callable[[Transition], Terms]:
    """The reward that `reward` is or names, as a function from a transition to terms by name that add up to the reward.

    A user's own (a function, or the name `file.py:function` or `package.module:function`) takes (transition, settings)
    and returns an array (...), which becomes the one term "reward". Its arrays are copies, and read-only; a function's
    settings are `Reward()`. Raises ConfigError where there is no such reward, and where an own one fails or returns
    another shape or numbers that are not finite; UntrustedReward where a file has named it and not the user.
    """
    if not isinstance(reward, Reward):
        return _own_terms(reward, Reward(), name_of(reward))
    name = reward.reward
    if name in REWARDS:
        return lambda transition: REWARDS[name](transition, reward)
    if ":" not in name:
        raise ConfigError(
            f"there is no reward {name!r}; choose {', '.join(REWARDS)}, or your own as file.py:function"
            f"{suggest(name, REWARDS)}"
        )
    return _own_terms(load(name), reward, name)


def total(terms: Terms) -> np.ndarray:
    """The reward that terms add up to, (...), summed in their order."""
    return sum(terms.values())


def _own_terms(own: OwnReward, settings: Reward, name: str) -> Callable[[Transition], Terms]:
    """The terms of a user's own reward, called `name` in errors: what it returns for a copy that it cannot write to."""

    def terms(transition: Transition) -> Terms:
        try:
            paid = own(read_only(transition), settings)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            raise fault(f"reward {name}", own, error, "(transition, settings)") from error
        shape = np.shape(transition.outcome)
        return {"reward": checked_array(f"reward {name}", own, paid, shape, "one number a transition")}

    return terms
