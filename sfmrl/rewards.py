"""Rewards as pure functions: a transition's arrays in, the reward's named terms out.

`crowd` is CRI's sparse reward, `sfm` the paper's dense one, `sfm-discount` the same with a cost for arriving late.
The episode's end is judged by the simulator (`outcome`), in CRI's order: time-out, collision, goal, too close;
the paper's formulas are silent on time-outs (worth 0, as in CRI) and list the goal after discomfort.
"""

import hashlib
import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from sfmrl.config import ConfigError, Reward, suggest
from sfmrl.geometry import length

RUNNING, SUCCESS, COLLISION, TIMEOUT = range(4)
OUTCOMES = np.array(["running", "success", "collision", "timeout"])


@dataclass(frozen=True)
class Transition:
    """What a reward may look at: one step of the robot, any leading axes (...), e.g. (E,), (E, A) or (E, T)."""

    time: np.ndarray  # (...) s, at the end of the step
    velocity: np.ndarray  # (..., 2) m/s, the robot's during the step (its action)
    preferred_velocity: np.ndarray  # (..., 2) m/s, of length v_pref, from the start of the step towards the goal
    goal_distance: np.ndarray  # (...) m, at the end of the step
    separations: np.ndarray  # (..., K) m, smallest gap to each element's disc during the step; +inf where absent
    outcome: np.ndarray  # (...) RUNNING, SUCCESS, COLLISION or TIMEOUT

    @property
    def separation(self) -> np.ndarray:
        """Smallest gap to any element during the step, m (...); +inf with no elements."""
        return self.separations.min(axis=-1, initial=np.inf)

    def __getitem__(self, index) -> "Transition":
        """The transition of some of the leading axes' entries."""
        return Transition(*(getattr(self, item.name)[index] for item in fields(self)))


Terms = dict[str, np.ndarray]


def crowd_terms(transition: Transition, p: Reward) -> Terms:
    """CRI's reward, the paper's first formula: terms by name, each (...)."""
    end, close = _cases(transition, p)
    discomfort = p.discomfort_slope * (transition.separation - p.discomfort_distance)
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


REWARDS: dict[str, Callable[[Transition, Reward], Terms]] = {
    "crowd": crowd_terms,
    "sfm": sfm_terms,
    "sfm-discount": sfm_discount_terms,
}


def reward_terms(settings: Reward) -> Callable[[Transition], Terms]:
    """The reward that `settings` names, as a function from a transition to terms by name that add up to the reward.

    A student's own (`package.module:function` or `file.py:function`) takes (transition, settings) and returns an
    array (...), which becomes the one term "reward". Raises ConfigError where there is no such reward, and where an
    own reward returns another shape or numbers that are not finite.
    """
    name = settings.reward
    if name in REWARDS:
        return lambda transition: REWARDS[name](transition, settings)
    own = _load(name)

    def checked(transition: Transition) -> Terms:
        shape = np.shape(transition.outcome)
        try:
            reward = np.asarray(own(transition, settings), dtype=float)
        except Exception as error:
            raise ConfigError(f"reward {name} failed: {type(error).__name__}: {error}") from error
        if reward.shape != shape:
            raise ConfigError(
                f"reward {name} returned shape {reward.shape}; it must be {shape}, one number a transition"
            )
        if not np.isfinite(reward).all():
            raise ConfigError(f"reward {name} returned NaN or infinity; every transition needs a finite number")
        return {"reward": reward}

    return checked


def reward_digest(settings: Reward) -> str | None:
    """SHA-256 of the file that an own reward is in; None for one that is no file's."""
    place, _, _ = settings.reward.rpartition(":")
    return hashlib.sha256(Path(place).read_bytes()).hexdigest() if place.endswith(".py") else None


def total(terms: Terms) -> np.ndarray:
    """The reward that terms add up to, (...), summed in their order."""
    return sum(terms.values())


def _load(name: str) -> Callable[[Transition, Reward], np.ndarray]:
    """The function that "package.module:function" or "path/to/file.py:function" names."""
    place, colon, function = name.rpartition(":")
    if not colon:
        raise ConfigError(
            f"there is no reward {name!r}; choose {', '.join(REWARDS)}, or your own as file.py:function"
            f"{suggest(name, REWARDS)}"
        )
    try:
        if place.endswith(".py"):
            if not Path(place).is_file():
                raise ConfigError(
                    f"reward {name}: there is no file {place}; put it there, or write its path as seen from here"
                )
            spec = importlib.util.spec_from_file_location(Path(place).stem, place)
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
        else:
            module = importlib.import_module(place)
    except ConfigError:
        raise
    except (Exception, SystemExit) as error:
        raise ConfigError(f"reward {name}: {place} cannot be imported: {type(error).__name__}: {error}") from error
    own = getattr(module, function, None)
    if not callable(own):
        raise ConfigError(f"reward {name}: {place} has no function {function!r}{suggest(function, dir(module))}")
    return own
