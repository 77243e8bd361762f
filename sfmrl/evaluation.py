"""The paper's metrics of a policy over test episodes, with intervals, overall and by environment."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sfmrl.actions import Policy
from sfmrl.config import MOST_EPISODES, Reward, Simulation, in_range
from sfmrl.episodes import Record, play_episodes
from sfmrl.policies import config_of, find_policy
from sfmrl.rewards import OwnReward
from sfmrl.scenes import sample_scenes

RATES = ("success", "collision", "timeout")
Z = 1.959964  # quantile of the normal distribution for a two-sided 95 % interval


class Metrics(dict[str, Any]):
    """Metrics by name; a notebook shows them as a table."""

    def _repr_html_(self) -> str:
        from sfmrl.replay.picture import metrics_html

        return metrics_html(self)


def evaluate(policy: str | Policy, **how: Any) -> dict[str, Any]:
    """The `metrics` of a policy over test episodes; arguments as for `evaluation_record`."""
    policy = find_policy(policy, how.get("reward"))
    return metrics(evaluation_record(policy, **how), policy)


def evaluation_record(
    policy: str | Policy,
    *,
    environment: str | None = None,
    episodes: int = 500,
    seed: int = 0,
    reward: str | Reward | OwnReward | None = None,
    simulation: Simulation | None = None,
    discount: float | None = None,
    phase: str = "test",
    people: int | None = None,
    people_speed: float | None = None,
    progress: Callable[[int], None] = lambda ended: None,
) -> Record:
    """Play test episodes with a policy; `people` and `people_speed` as in `sample_scenes`.

    `environment`, `simulation`, `reward` and `discount` (the last two for the total reward) default to those of the
    policy's training or, for a policy that was not trained, to table 1's mix and CrowdNav's. A `simulation` replaces
    the policy's whole simulation: to change one setting of it, pass
    `dataclasses.replace(policy.config.simulation, time_limit=40)`. `progress` is called with the number of episodes
    that have just ended. Raises ConfigError on unknown names, on fewer than one episode and on a discount out of range.
    """
    in_range("episodes", episodes, 1, MOST_EPISODES)
    chosen = find_policy(policy, reward)
    own = config_of(chosen)
    settings = own.reward if reward is None else reward
    environment = own.reinforcement.test_environment if environment is None else environment
    simulation = own.simulation if simulation is None else simulation
    discount = own.discount if discount is None else discount
    crowd: dict[str, Any] = {"people": people, "people_speed": people_speed}
    crowd["random_attributes"] = simulation.random_attributes
    scenes = sample_scenes(environment, episodes, seed, phase=phase, **crowd)
    return play_episodes(scenes, chosen, settings, simulation, discount=discount, progress=progress)


def metrics(record: Record, policy: Policy | None = None) -> Metrics:
    """The paper's metrics of a record, and the same by environment if there are several.

    `success`, `collision`, `timeout` are rates, each with its 95 % Wilson interval under `intervals`;
    `navigation_time` is the mean time of the successes in s (None without any); `total_reward` the mean discounted
    return. `failures` lists the episodes without success, and says whether each is solvable: whether its squares leave
    a path to the goal. If `policy` has recovery and has just played the record, `recovered` is the rate of episodes in
    which it was stuck. For a record without episodes, rates and means are None, and intervals are from 0 to 1. Raises
    ValueError if `policy` has just played another number of episodes.
    """
    from sfmrl.recovery import RecoveringPolicy, solvable

    result = Metrics(_summary(record))
    if isinstance(policy, RecoveringPolicy):
        if len(policy.helped) != len(record):
            counts = f"the policy has just played {len(policy.helped)} episodes, the record has {len(record)}"
            raise ValueError(f"{counts}; give the record that the policy has just played")
        result["recovered"] = _mean(policy.helped)
    names = np.unique(record.scenes.environment)
    if len(names) > 1:
        result["environments"] = {str(n): _summary(record.take(record.scenes.environment == n)) for n in names}
    failed = record.take(record.outcome != "success")
    result["failures"] = [
        {name: row[name] for name in ("episode", "environment", "outcome")} | {"solvable": bool(possible)}
        for row, possible in zip(episode_rows(failed), solvable(failed.scenes), strict=True)
    ]
    return result


def episode_rows(record: Record) -> list[dict[str, Any]]:
    """A row of plain values for each episode, for a CSV file; `hit` names what the robot ran into: human or square."""
    columns = {
        "episode": record.scenes.episode,
        "environment": record.scenes.environment,
        "outcome": record.outcome,
        "hit": collided_with(record),
        "steps": record.steps,
        "time": record.time,
        "total_reward": record.discounted_return,
        "smallest_separation": np.fmin.reduce(record.transition.separation, axis=1, initial=np.inf),
    }
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows]


def collided_with(record: Record) -> np.ndarray:
    """What the robot ran into in each episode, (E,): "human", "square", or "" without a collision."""
    gaps = record.transition.separations[np.arange(len(record.steps)), record.steps - 1]  # (E, K) m, in the last step
    square = record.scenes.square[:, 1:]
    to_square, to_human = (gaps.min(axis=1, initial=np.inf, where=rows) for rows in (square, ~square))
    return np.where(record.outcome != "collision", "", np.where(to_square < to_human, "square", "human"))


def _summary(record: Record) -> dict[str, Any]:
    """The metrics of all episodes of a record together, as plain values."""
    outcome, episodes = record.outcome, len(record.steps)
    counts = {name: int((outcome == name).sum()) for name in RATES}
    succeeded = outcome == "success"
    return {
        "episodes": episodes,
        **{name: counts[name] / episodes if episodes else None for name in RATES},
        "navigation_time": _mean(record.time[succeeded]),
        "total_reward": _mean(record.discounted_return),
        "intervals": {name: list(wilson(counts[name], episodes)) for name in RATES},
    }


def _mean(values: np.ndarray) -> float | None:
    """The mean of values (E,); None without any."""
    return float(values.mean()) if len(values) else None


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % Wilson score interval of the rate `successes` / `trials` (Wilson, 1927).

    Raises ValueError unless both are whole numbers and 0 <= successes <= trials.
    """
    if not (0 <= successes <= trials < math.inf and successes % 1 == trials % 1 == 0):
        raise ValueError(f"wilson takes counts, not {successes} of {trials}: whole numbers, successes at most trials")
    if trials == 0:
        return 0.0, 1.0
    rate, spread = successes / trials, Z * Z / trials
    centre = (rate + spread / 2) / (1 + spread)
    half = Z * math.sqrt(rate * (1 - rate) / trials + spread / (4 * trials)) / (1 + spread)
    return 0.0 if successes == 0 else centre - half, 1.0 if successes == trials else centre + half
