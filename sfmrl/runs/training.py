"""Run imitation and reinforcement in a run folder: save checkpoints, stop, continue, validate and test."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sfmrl.actions import Policy
from sfmrl.config import Config, Reinforcement
from sfmrl.episodes import Record
from sfmrl.evaluation import episode_rows, evaluation_record, metrics
from sfmrl.fast import FastNetwork, new_network
from sfmrl.imitation import Fit, demonstrate, fill_memory, fit_memory, make_memory
from sfmrl.learning import Learner, Memory
from sfmrl.lookahead import SarlPolicy
from sfmrl.recovery import with_recovery
from sfmrl.recovery.remembering import RememberingPolicy
from sfmrl.reinforcement import reinforce
from sfmrl.runs.bits import machine_bits
from sfmrl.runs.demonstrations import load_demonstrations, save_demonstrations
from sfmrl.runs.explorer import Explorer
from sfmrl.runs.files import DamagedFile, append_rows, csv_text, digest_of, read_sums, write_text
from sfmrl.runs.folders import BEST, DEMONSTRATIONS, WEIGHTS
from sfmrl.runs.progress import Progress, StopSignal, no_progress
from sfmrl.runs.run import Run
from sfmrl.runs.weights import load_weights, network_from, save_weights, weights_file
from sfmrl.states import column_names

CHECKPOINT_EVERY = 20.0  # seconds; saving more or less often changes no number of a training
EVALUATION_SEED = 0  # trainings with any seed use the same validation and test episodes, so runs compare in pairs
VALIDATED = ("success", "collision", "timeout", "navigation_time", "total_reward")  # metrics in validation.csv

Say = Callable[[str], None]


def run_imitation(run: Run, progress: Progress, stop: StopSignal) -> None:
    """Start or continue an imitation run and train to its end; raises Interrupted once `stop` is requested."""
    path, memory = run.folder / DEMONSTRATIONS, make_memory(run.config)
    if not path.exists():
        with stop.watch(progress)("demonstrations", run.config.imitation.episodes) as advance:
            save_demonstrations(demonstrate(run.config, advance), path)
    fill_memory(memory, load_demonstrations(path, run.config.simulation), run.config)
    run.check_reward()
    network = fit(run, memory, run.load_checkpoint(), progress, stop)
    run.finish(weights_file(network, run.config))


def fit(run: Run, memory: Memory, saved: dict[str, Any] | None, progress: Progress, stop: StopSignal) -> FastNetwork:
    """Fit a network to the demonstrations in `memory`; starts from a checkpoint `saved`, saves one after each epoch."""
    fitted, rows = Fit(run.config), []
    if saved:
        with run.restoring():
            fitted.load_state_dict(saved["fit"])
            rows += saved["rows"]
    with progress("imitation", fitted.batches_left(memory)) as advance:
        for row in fit_memory(fitted, memory, advance):
            rows.append(row)
            if run.kind == "il":
                write_text(run.folder / "metrics.csv", csv_text(rows))
            run.save_checkpoint({"fit": fitted.state_dict(), "rows": rows})
            stop.check()
    return fitted.network


def run_reinforcement(run: Run, progress: Progress, stop: StopSignal, say: Say, *, threads: int = 1) -> dict[str, Any]:
    """Start or continue a reinforcement run and train to its end; returns the metrics of the final test.

    Raises Interrupted, with a checkpoint just written, once `stop` is requested.
    """
    config, settings = run.config, run.config.reinforcement
    learner = start_learner(run, progress, stop, say)
    for name, rows in (("metrics.csv", learner.rows), ("validation.csv", learner.validations)):
        write_text(run.folder / name, csv_text(rows))  # drop the rows that a killed run added after its checkpoint
    aside, left = settings.parallel > 1 and threads > 1, settings.episodes - learner.episode
    explorer = Explorer(config, threads - 1 if aside else threads, aside, run.facts.get("own_reward"))
    with explorer, progress("reinforcement", left) as advance:
        while True:
            if validation_due(learner, settings):
                validate(run, learner, stop, say, threads)
            if learner.episode >= settings.episodes:
                break
            train_until_validation(run, learner, explorer, advance, stop)
    run.save_checkpoint(learner.state_dict())
    result = test(run, learner, stop.watch(progress), threads)
    run.check_reward()
    written = result | {"bits": machine_bits()}  # run.json has the bits of the machine on which the run began
    write_text(run.folder / "result.json", json.dumps(written, indent=2) + "\n")
    run.finish(weights_file(learner.network, config))
    return result


def start_learner(run: Run, progress: Progress, stop: StopSignal, say: Say) -> Learner:
    """Restore the learner from the newest checkpoint, or make a new one.

    A new learner's network comes from a weights file, from an imitation run, or is drawn at random. An imitation run
    also fills the memory with its demonstrations, their returns computed with this training's reward. If `needs_fit`,
    a new network is fitted to the demonstrations first, and until that is done, checkpoints hold the fit.
    """
    config, saved = run.config, run.load_checkpoint()
    memory = make_memory(config)
    if saved and "fit" not in saved:
        with run.restoring():
            learner = Learner(network_from(saved["network"], "it", config.value_prior), memory, config)
            learner.load_state_dict(saved)
            return learner
    if weights := run.facts.get("weights"):
        path = Path(weights["file"])
        if not path.is_file() or digest_of(path) != weights["sha256"]:
            raise DamagedFile(f"{path} has changed or gone since this run began; put it back, or start a new run")
        network, _ = load_weights(path)
    elif run.imitation is None:
        network = new_network(config, config.seed)
    else:
        path = run.imitation / DEMONSTRATIONS
        if not path.exists() or read_sums(run.imitation).get(DEMONSTRATIONS) != run.facts["demonstrations"]:
            raise DamagedFile(f"{path} has changed or gone since this run began; put it back, or start a new run")
        fill_memory(memory, load_demonstrations(path, config.simulation), config)
        run.check_reward()
        network, trained = load_weights(run.imitation / WEIGHTS)
        if needs_fit(trained, config):
            state = f"reward {config.reward.reward} and {len(column_names(config.forces))} state columns"
            other = f"{run.imitation} was trained with another reward, discount, state or value prior"
            say(f"{other}: learning from its demonstrations again, with {state}")
            network = fit(run, memory, saved, progress, stop)
    return Learner(network, memory, config)


def needs_fit(trained: Config, config: Config) -> bool:
    """Whether a training under `config` must fit again the demonstrations of an imitation `trained` under another.

    It must if the state or the value prior differs and, where `refit` is on, if the reward or the discount differs.
    """
    names = ["forces", "value_prior"] + (["discount", "reward"] if config.imitation.refit else [])
    return any(getattr(trained, name) != getattr(config, name) for name in names)


def train_until_validation(
    run: Run, learner: Learner, explorer: Explorer, advance: Callable[[int], None], stop: StopSignal
) -> None:
    """Train up to the next validation, saving checkpoints; calls `advance` with each round's number of episodes."""
    settings = run.config.reinforcement
    until = min(settings.validation_interval * (learner.episode // settings.validation_interval + 1), settings.episodes)
    saved_at = time.monotonic()
    for record, loss in reinforce(learner, explorer.start, until):
        rows = [row | {"loss": loss} for row in episode_rows(record)]
        learner.rows += rows
        append_rows(run.folder / "metrics.csv", rows)
        advance(len(rows))
        if stop.requested or learner.episode == until or time.monotonic() - saved_at > CHECKPOINT_EVERY:
            run.save_checkpoint(learner.state_dict())
            saved_at = time.monotonic()
        stop.check()


def validation_due(learner: Learner, settings: Reinforcement) -> bool:
    """Whether a validation is due: one at each interval, from episode 0 on, and one at the end."""
    if learner.validations and learner.validations[-1]["episode"] == learner.episode:
        return False
    return learner.episode % settings.validation_interval == 0 or learner.episode >= settings.episodes


def validate(run: Run, learner: Learner, stop: StopSignal, say: Say, threads: int) -> None:
    """Play the validation episodes, add a row to validation.csv, and save the network if none before was better."""
    settings, policy = run.config.reinforcement, SarlPolicy(learner.network, run.config, threads)
    rates = metrics(play_evaluation(policy, "validation", settings.validation_episodes, stop.watch(no_progress)))
    run.check_reward()
    row = {"episode": learner.episode} | {name: rates[name] for name in VALIDATED}
    if row["success"] >= max((old["success"] for old in learner.validations), default=0.0):
        save_weights(learner.network, run.config, run.folder / BEST)
    learner.validations.append(row)
    append_rows(run.folder / "validation.csv", [row])
    shown = ", ".join(f"{name} {rates[name]:.3f}" for name in ("success", "collision", "timeout"))
    say(f"validation at episode {learner.episode} of {settings.episodes}: {shown}")


def test(run: Run, learner: Learner, progress: Progress, threads: int) -> dict[str, Any]:
    """Test the network alone and, if the config says so, with recovery; the metrics."""
    config, episodes = run.config, run.config.reinforcement.test_episodes
    alone = RememberingPolicy(learner.network, config, threads)
    record = play_evaluation(alone, "test", episodes, progress)
    result = metrics(record)
    write_text(run.folder / "test.csv", csv_text(episode_rows(record)))
    if config.planner.recover:
        recovering = with_recovery(alone, config.planner)
        result["with_recovery"] = metrics(play_evaluation(recovering, "test", episodes, progress), recovering)
    return result


def play_evaluation(policy: Policy, phase: str, episodes: int, progress: Progress) -> Record:
    """Play validation or test episodes (`phase`), which are the same for every training seed."""
    with progress(phase, episodes) as advance:
        return evaluation_record(policy, episodes=episodes, seed=EVALUATION_SEED, phase=phase, progress=advance)
