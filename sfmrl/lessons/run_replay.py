"""What a run's numbers come from, played again: its network's test episodes, or ORCA's demonstrations."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sfmrl.config import Reward, counted
from sfmrl.demonstrations import load_demonstrations
from sfmrl.episodes import Record, play_episodes
from sfmrl.evaluation import RATES, episode_rows, evaluation_record
from sfmrl.files import json_object, read_listed, read_table
from sfmrl.folders import DEMONSTRATIONS, WEIGHTS
from sfmrl.lookahead import Policy, SarlPolicy
from sfmrl.policies import orca_policy
from sfmrl.progress import Progress
from sfmrl.recovery import with_recovery
from sfmrl.runs import Run
from sfmrl.scenes import sample_scenes
from sfmrl.training import EVALUATION_SEED
from sfmrl.weights import load_weights

TIMES = 0.05  # by how much an episode's time may differ, in half of the episodes, where the bits differ


class Disagreement(Exception):
    """What does not agree, in words."""


@dataclass(frozen=True)
class Replay:
    """How to play again: at most `episodes`, of which the share `tolerance` may end otherwise, on how many threads.

    `alike` says whether this machine computes the bits of the run. If so, an episode with another number of steps ends
    otherwise, too; if not, times are held to `TIMES`. Its methods say what they found, or raise Disagreement.
    """

    episodes: int
    tolerance: float
    threads: int
    progress: Progress
    alike: bool = True

    def demonstrations(self, run: Run) -> str:
        """The demonstrations that are kept, against ORCA's own in the same scenes."""
        settings, simulation = run.config.imitation, run.config.simulation
        kept = load_demonstrations(run.folder / DEMONSTRATIONS, simulation)
        if len(kept.steps) != settings.episodes:
            raise Disagreement(
                f"it holds {counted(len(kept.steps), 'demonstration')}, config.json asks for {settings.episodes}"
            )
        count = min(self.episodes, settings.episodes)
        scenes = sample_scenes(settings.environment, count, run.config.seed, phase="imitation")
        again = play_episodes(scenes, orca_policy, Reward(), simulation)  # whose paths depend on no reward
        kept = kept.take(np.arange(count))
        differ = self._differ(kept.outcome, again.outcome, kept.steps, again.steps)
        moments = again.position.shape[1]
        exact = np.array_equal(kept.position[:, :moments], again.position, equal_nan=True)
        return self._judged(differ, exact, f"of {counted(settings.episodes, 'demonstration')}, played by ORCA again,")

    def tests(self, run: Run, weights: str = WEIGHTS, name: str = "test.csv") -> str:
        """Test episodes with the network alone, against their table; in older runs, which have none, the failures."""
        record = self._play(run, self._policy(run, weights))
        count, whole = len(record.steps), run.config.reinforcement.test_episodes
        what = f"of {counted(whole, 'test episode')}, played by {weights} alone,"
        if not (run.folder / name).exists():
            return self._against_failures(record, result_of(run), whole, what)
        kept = read_table(run.folder / name)[:count]
        again = [{key: str(value) for key, value in row.items()} for row in episode_rows(record)]
        outcome, steps = (np.array([row[key] for row in kept]) for key in ("outcome", "steps"))
        differ = self._differ(outcome, record.outcome, steps.astype(int), record.steps)
        return self._judged(differ, kept == again, what)

    def with_recovery(self, run: Run) -> str:
        """The same with recovery, of which only the failures are kept."""
        record = self._play(run, with_recovery(self._policy(run, WEIGHTS), run.config.planner))
        whole = run.config.reinforcement.test_episodes
        what = f"of {counted(whole, 'test episode')}"
        return self._against_failures(record, result_of(run)["with_recovery"], whole, what)

    def _policy(self, run: Run, weights: str) -> SarlPolicy:
        network, _ = load_weights(run.folder / weights)
        return SarlPolicy(network, run.config, self.threads)

    def _play(self, run: Run, policy: Policy) -> Record:
        """Test episodes, as a training plays them at its end."""
        settings = run.config.reinforcement
        return evaluation_record(
            policy,
            environment=settings.test_environment,
            episodes=min(self.episodes, settings.test_episodes),
            seed=EVALUATION_SEED,
            simulation=run.config.simulation,
            progress=self.progress,
        )

    def _against_failures(self, record: Record, part: dict[str, Any], whole: int, what: str) -> str:
        kept = np.array(_outcomes(part, whole))[: len(record.steps)]
        return self._judged(kept != record.outcome, False, what)

    def _differ(self, outcome: np.ndarray, outcome_again: np.ndarray, steps: np.ndarray, steps_again: np.ndarray):
        """Which episodes (n,) ended otherwise; raises Disagreement where times differ by more than `TIMES`."""
        differ = outcome != outcome_again
        if self.alike:
            return differ | (steps != steps_again)
        off = np.abs(steps_again / np.maximum(steps, 1) - 1)[~differ]
        if off.size and np.median(off) > TIMES:
            raise Disagreement(f"half of the episodes take a time that differs by more than {TIMES:.0%}")
        return differ

    def _judged(self, differ: np.ndarray, exact: bool, what: str) -> str:
        """What was found where `differ` (n,) marks the episodes that ended otherwise; raises Disagreement."""
        count, bad = len(differ), np.flatnonzero(differ)
        if not len(bad):
            return f"{count} {what} end as they did" + (", to the same numbers" if exact else "")
        listed = ", ".join(map(str, bad[:8])) + (", ..." if len(bad) > 8 else "")
        said = f"{len(bad)} of the first {count} {what} end otherwise ({listed}); {self.tolerance:.0%} of them may"
        if len(bad) > math.ceil(round(self.tolerance * count, 6)):
            raise Disagreement(said)
        return said


def result(run: Run) -> str:
    """The rates in result.json, held to the outcomes in its tables and in its lists of failures."""
    found, whole = result_of(run), run.config.reinforcement.test_episodes
    best, recovering = found.get("best_validation"), found.get("with_recovery")
    for part, name in ((found, "test.csv"), (best, "test-best.csv"), (recovering, "")):
        sources = {"its failures": _outcomes(part, whole)} if part else {}
        if part and name and (run.folder / name).exists():
            sources[name] = [row["outcome"] for row in read_table(run.folder / name)]
        for source, ends in sources.items():
            if len(ends) != whole or any(round(part[rate] * whole) != ends.count(rate) for rate in RATES):
                raise Disagreement(f"its rates are not those of {counted(whole, 'episode')} in {source}")
    return ", ".join(f"{name} {found[name]:.3f}" for name in RATES)


def _outcomes(part: dict[str, Any], episodes: int) -> list[str]:
    """The outcome of every test episode that follows from a result's list of failures."""
    ends = ["success"] * episodes
    for failure in part["failures"]:
        ends[failure["episode"]] = failure["outcome"]
    return ends


def result_of(run: Run) -> dict[str, Any]:
    """What result.json holds."""
    return json_object(read_listed(run.folder / "result.json"))
