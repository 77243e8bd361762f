"""Play again the episodes behind a run's numbers: its network's test episodes, or ORCA's demonstrations."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sfmrl.config import Reward, counted, json_object
from sfmrl.episodes import Record
from sfmrl.evaluation import episode_rows
from sfmrl.imitation import demonstrate
from sfmrl.lookahead import SarlPolicy
from sfmrl.recovery import with_recovery
from sfmrl.runs.demonstrations import load_demonstrations
from sfmrl.runs.files import read_listed, read_table
from sfmrl.runs.folders import DEMONSTRATIONS, WEIGHTS
from sfmrl.runs.progress import Progress
from sfmrl.runs.run import Run
from sfmrl.runs.training import play_evaluation
from sfmrl.runs.weights import load_weights

TIME_TOLERANCE = 0.05  # where the bits differ, the largest median difference of the episodes' times, as a share
REWARD_TOLERANCE = 1e-6  # where they are alike, of each total reward, absolute or as a share


class Disagreement(Exception):
    """Numbers on file and numbers played again do not agree; the text says which."""


@dataclass(frozen=True)
class Rerun:
    """Plays at most `episodes` of a run's episodes again, of which a share of `tolerance` may end differently.

    `alike` says whether this machine computes the bits of the run. If so, an episode with another number of steps or
    another total reward counts as ending differently; if not, times are held to `TIME_TOLERANCE`. The methods return a
    sentence on what agrees, or raise Disagreement.
    """

    episodes: int
    tolerance: float
    threads: int
    progress: Progress
    alike: bool = True

    def demonstrations(self, run: Run) -> str:
        """Compare the demonstrations on file with ORCA's own in the same scenes."""
        settings = run.config.imitation
        stored = load_demonstrations(run.folder / DEMONSTRATIONS, run.config.simulation)
        whole = counted(len(stored.steps), "demonstration")
        if len(stored.steps) != settings.episodes:
            raise Disagreement(f"it holds {whole}, config.json asks for {settings.episodes}")
        count = min(self.episodes, settings.episodes)
        # Any reward: ORCA's paths do not depend on it, and the run's own may be code that is not to be run.
        config = replace(run.config, reward=Reward(), imitation=replace(settings, episodes=count))
        with self.progress("demonstrations", count) as advance:
            again = demonstrate(config, advance)
        stored = stored.take(np.arange(count))
        exact = np.array_equal(stored.position[:, : again.position.shape[1]], again.position, equal_nan=True)
        return self.judged(f"of {whole}, played by ORCA again,", again, stored.outcome, stored.steps, exact)

    def tests(self, run: Run) -> str:
        """Compare test episodes of the network alone with their table."""
        record = self._play(run)
        stored = read_table(run.folder / "test.csv")[: len(record.steps)]
        again = [{key: str(value) for key, value in row.items()} for row in episode_rows(record)]
        outcome, steps = (np.array([row[key] for row in stored]) for key in ("outcome", "steps"))
        reward = np.array([row["total_reward"] for row in stored]).astype(float)
        whole = counted(run.config.reinforcement.test_episodes, "test episode")
        what = f"of {whole}, played by {WEIGHTS} alone,"
        return self.judged(what, record, outcome, steps.astype(int), stored == again, reward)

    def recovery(self, run: Run) -> str:
        """Compare test episodes with recovery with the list of their failures, the only record of them."""
        record, whole = self._play(run, recover=True), run.config.reinforcement.test_episodes
        stored = outcomes(result_of(run)["with_recovery"], whole)
        return self.judged(f"of {counted(whole, 'test episode')}", record, np.array(stored))

    def _play(self, run: Run, recover: bool = False) -> Record:
        """Play test episodes as a training plays them at its end."""
        network, config = load_weights(run.folder / WEIGHTS)[0], run.config
        alone = SarlPolicy(network, config, self.threads)
        policy = with_recovery(alone, config.planner) if recover else alone
        return play_evaluation(policy, "test", min(self.episodes, config.reinforcement.test_episodes), self.progress)

    def judged(
        self,
        what: str,
        again: Record,
        outcome: np.ndarray,
        steps: np.ndarray | None = None,
        exact: bool = False,
        reward: np.ndarray | None = None,
    ) -> str:
        """Compare episodes played again with the outcomes, steps and total rewards on file, (n,).

        `exact` says that all numbers on file are equal, not only these.
        """
        differ = outcome != again.outcome
        if steps is not None and self.alike:
            differ |= steps != again.steps
            if reward is not None:
                differ |= ~np.isclose(reward, again.discounted_return, rtol=REWARD_TOLERANCE, atol=REWARD_TOLERANCE)
        elif steps is not None:
            off = np.abs(again.steps / np.maximum(steps, 1) - 1)[~differ]
            if off.size and np.median(off) > TIME_TOLERANCE:
                raise Disagreement(f"half of the episodes take a time that differs by more than {TIME_TOLERANCE:.0%}")
        count, bad = len(differ), np.flatnonzero(differ)
        if not len(bad):
            return f"{count} {what} end as they did" + (", with the same numbers" if exact else "")
        listed = ", ".join(map(str, bad[:8])) + (", ..." if len(bad) > 8 else "")
        said = f"{len(bad)} of the first {count} {what} end differently ({listed}); allowed: {self.tolerance:.0%}"
        if len(bad) > math.ceil(round(self.tolerance * count, 6)):
            raise Disagreement(said)
        return said


def result_of(run: Run) -> dict[str, Any]:
    """Return the contents of result.json."""
    return json_object(read_listed(run.folder / "result.json"))


def outcomes(part: dict[str, Any], episodes: int) -> list[str]:
    """Return the outcome of every test episode that follows from a result's list of failures."""
    ends = ["success"] * episodes
    for failure in part["failures"]:
        ends[failure["episode"]] = failure["outcome"]
    return ends
