"""How good is a policy: the paper's metrics over test episodes, with intervals, in all and by environment."""

from typing import Any

import numpy as np

from sfmrl.config import EPISODES, Config, Reward, Simulation, in_range
from sfmrl.episodes import Record, play_episodes
from sfmrl.intervals import wilson
from sfmrl.lookahead import Policy
from sfmrl.policies import find_policy
from sfmrl.rewards import OwnReward, as_reward
from sfmrl.runs.progress import Progress, no_progress
from sfmrl.scenes import sample_scenes

RATES = ("success", "collision", "timeout")


def evaluate(policy: str | Policy, **how: Any) -> dict[str, Any]:
    """The metrics (see `metrics`) of a policy over test episodes; arguments as for `evaluation_record`."""
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
    phase: str = "test",
    people: int | None = None,
    people_speed: float | None = None,
    progress: Progress = no_progress,
) -> Record:
    """Test episodes played with a policy, among other `people` than the environment's if asked (see `sample_scenes`).

    `environment`, `simulation` and `reward` (for the total reward) are by default those that the policy was trained to
    be tested in; for a policy that was not trained, table 1's mix and CrowdNav's. Raises ConfigError on unknown names
    and on less than one episode.
    """
    in_range("episodes", episodes, 1, EPISODES)
    chosen = find_policy(policy, reward)
    own = getattr(chosen, "config", Config())
    settings = own.reward if reward is None else as_reward(reward)
    environment = own.reinforcement.test_environment if environment is None else environment
    simulation = own.simulation if simulation is None else simulation
    scenes = sample_scenes(environment, episodes, seed, phase=phase, people=people, people_speed=people_speed)
    with progress(phase, episodes) as told:
        return play_episodes(scenes, chosen, settings, simulation, discount=own.discount, progress=told)


def metrics(record: Record, policy: Policy | None = None) -> dict[str, Any]:
    """The paper's metrics of a record, and the same by environment where there are several.

    `success`, `collision`, `timeout` are rates, each with its 95 % Wilson interval under `intervals`;
    `navigation_time` is the successes' mean time in s (None without any); `total_reward` the mean discounted return.
    `failures` are the episodes that did not succeed, and whether their squares leave a way to the goal. Of a `policy`
    with recovery that has just played them, `recovered` is the rate of episodes in which it was stuck.
    """
    from sfmrl.recovery import RecoveringPolicy, solvable

    result = _summary(record)
    if isinstance(policy, RecoveringPolicy):
        result["recovered"] = float(policy.helped.mean())
    names = np.unique(record.scenes.environment)
    if len(names) > 1:
        result["environments"] = {str(n): _summary(record.take(record.scenes.environment == n)) for n in names}
    failed = np.flatnonzero(record.outcome != "success")
    result["failures"] = [
        {
            "episode": int(record.scenes.episode[e]),
            "environment": str(record.scenes.environment[e]),
            "outcome": str(record.outcome[e]),
            "solvable": bool(possible),
        }
        for e, possible in zip(failed, solvable(record.scenes.take(failed)), strict=True)
    ]
    return result


def episode_rows(record: Record) -> list[dict[str, Any]]:
    """A row of plain values for each episode, for a CSV file; `hit` is what a collision was with: human or square."""
    hit = collided_with(record)
    return [
        {
            "episode": int(record.scenes.episode[e]),
            "environment": str(record.scenes.environment[e]),
            "outcome": str(record.outcome[e]),
            "hit": str(hit[e]),
            "steps": int(record.steps[e]),
            "time": float(record.time[e]),
            "total_reward": float(record.discounted_return[e]),
            "smallest_separation": float(record.transition.separation[e, : record.steps[e]].min()),
        }
        for e in range(len(record.steps))
    ]


def collided_with(record: Record) -> np.ndarray:
    """What the robot ran into in each episode, (E,): "human", "square", or "" where it did not collide."""
    episode = np.arange(len(record.steps))
    nearest = record.transition.separations[episode, record.steps - 1].argmin(axis=1)
    struck = np.where(record.scenes.square[episode, 1 + nearest], "square", "human")
    return np.where(record.outcome == "collision", struck, "")


def _summary(record: Record) -> dict[str, Any]:
    outcome, count = record.outcome, len(record.steps)
    hits = {name: int((outcome == name).sum()) for name in RATES}
    succeeded = outcome == "success"
    return {
        "episodes": count,
        **{name: hits[name] / count for name in RATES},
        "navigation_time": float(record.time[succeeded].mean()) if succeeded.any() else None,
        "total_reward": float(record.discounted_return.mean()),
        "intervals": {name: list(wilson(hits[name], count)) for name in RATES},
    }
