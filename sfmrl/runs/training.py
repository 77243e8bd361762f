"""Run the algorithms of imitation.py and reinforcement.py in run folders: save, stop, continue, validate and test."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sfmrl.config import Config, Reinforcement
from sfmrl.episodes import Record
from sfmrl.evaluation import episode_rows, evaluation_record, metrics
from sfmrl.fast import FastNetwork
from sfmrl.imitation import Fit, demonstrate, fill_memory, fit_memory, make_memory
from sfmrl.learning import Learner, Memory
from sfmrl.lookahead import Policy, SarlPolicy
from sfmrl.recovery import with_recovery
from sfmrl.recovery.remembering import RememberingPolicy
from sfmrl.reinforcement import reinforce
from sfmrl.runs.bits import machine_bits
from sfmrl.runs.demonstrations import load_demonstrations, save_demonstrations
from sfmrl.runs.explorer import Explorer
from sfmrl.runs.files import DamagedFile, digest_of, read_sums
from sfmrl.runs.folders import BEST, DEMONSTRATIONS, WEIGHTS
from sfmrl.runs.progress import Interrupted, Progress, StopSignal, no_progress
from sfmrl.runs.run import Run
from sfmrl.runs.weights import load_weights, network_from, save_weights
from sfmrl.states import column_names

CHECKPOINT_EVERY = 20.0  # seconds; saving more or less often changes no number of a training
EVALUATION_SEED = 0  # every training seed validates and tests on the same episodes, so that runs compare in pairs
VALIDATED = ("success", "collision", "timeout", "navigation_time", "total_reward")


def run_imitation(run: Run, progress: Progress, stop: StopSignal) -> FastNetwork:
    """Start or continue an imitation run and train to its end; raises Interrupted once `stop` has been requested."""
    config = run.config
    path = run.folder / DEMONSTRATIONS
    if not path.exists():
        with stop.watch(progress)("demonstrations", config.imitation.episodes) as advance:
            save_demonstrations(demonstrate(config, advance), path)
    memory = make_memory(config)
    fill_memory(memory, load_demonstrations(path, config.simulation), config)
    fit = Fit(config)
    saved = run.load_checkpoint()
    rows = []
    if saved:
        with run.restoring():
            rows = [*saved["rows"]]
            fit.load_state_dict(saved["fit"])

    def save_epoch(row: dict[str, Any]) -> None:
        rows.append(row)
        run.append_rows("metrics.csv", [row])
        run.save_checkpoint({"fit": fit.state_dict(), "rows": rows})
        if stop.requested:
            raise Interrupted

    run.write_table("metrics.csv", rows)  # a killed run has appended rows since its checkpoint
    with progress("imitation", fit.batches_left(memory)) as advance:
        fit_memory(fit, memory, save_epoch, advance)
    run.finish(fit.network)
    return fit.network


def run_reinforcement(
    run: Run, progress: Progress, stop: StopSignal, say: Callable[[str], None], *, threads: int = 1
) -> dict[str, Any]:
    """Start or continue a reinforcement run and train to its end; returns the metrics of the final test.

    Raises Interrupted, with a checkpoint just written, once `stop` has been requested.
    """
    config, settings = run.config, run.config.reinforcement
    learner = begin(run, progress, stop, say)
    run.write_table("metrics.csv", learner.rows)  # a killed run has appended rows since its checkpoint
    run.write_table("validation.csv", learner.validations)
    aside = settings.parallel > 1 and threads > 1
    sizes, left = learner.network.sizes, settings.episodes - learner.episode
    with Explorer(config, threads - aside, aside, sizes) as explorer, progress("reinforcement", left) as advance:
        while True:
            if due(learner, settings):
                validate(run, learner, stop, say, threads)
            if learner.episode >= settings.episodes:
                break
            train_stretch(run, learner, explorer, advance, stop)
    run.save_checkpoint(learner.state_dict())
    result = test(run, learner, stop.watch(progress), threads)
    run.write_json("result.json", result | {"bits": machine_bits()})  # run.json has those of the machine it began on
    run.finish(learner.tested)
    return result


def begin(run: Run, progress: Progress, stop: StopSignal, say: Callable[[str], None]) -> Learner:
    """Restore the learner from the newest checkpoint, or make it from what the training starts from.

    That is a weights file, a random network, or an imitation run: its demonstrations, with the returns that this
    training's reward gives them, and its network. If that has learnt something else (`needs_fit`), a network is fitted
    to the demonstrations again; until that is done, checkpoints hold the fit.
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
            raise DamagedFile(f"{path} is not what this run began with any more; put it back, or start a new run")
        parameters = load_weights(path)[0].state_dict()
        return Learner(network_from(parameters, str(path), config.value_prior), memory, config)
    if run.imitation is None:
        return Learner(Fit(config).network, memory, config)
    fill_memory(memory, load_demonstrations(_demonstrations_of(run), config.simulation), config)
    network, trained = load_weights(run.imitation / WEIGHTS)
    if needs_fit(trained, config):
        network = _fit_again(run, memory, saved, progress, stop, say)
    elif saved:
        with run.restoring():
            raise ValueError("it is one of a fit, which this run does without")
    return Learner(network, memory, config)


def needs_fit(trained: Config, config: Config) -> bool:
    """Whether imitation under one config leaves to be fitted what a training with another starts from.

    Another state always does; another reward, discount or fit only if the preset has every row fitted to its own.
    """
    state, task = ("forces", "value_prior"), ("discount", "reward", "imitation")
    names = state + task * config.imitation.refit
    return any(getattr(trained, name) != getattr(config, name) for name in names)


def _demonstrations_of(run: Run) -> Path:
    """The demonstrations that a reinforcement run starts from; raises DamagedFile if they have gone or changed."""
    path = run.imitation / DEMONSTRATIONS
    if not path.exists():
        raise DamagedFile(f"{path} is not there any more; put the imitation run back, or start a new run")
    if read_sums(run.imitation).get(DEMONSTRATIONS) != run.facts["demonstrations"]:
        raise DamagedFile(f"{path} is not the one this run began with; start a new run from it")
    return path


def _fit_again(
    run: Run,
    memory: Memory,
    saved: dict[str, Any] | None,
    progress: Progress,
    stop: StopSignal,
    say: Callable[[str], None],
) -> FastNetwork:
    """Fit a network with this run's state to the demonstrations in `memory`, from checkpoint `saved` if any."""
    fit = Fit(run.config)
    if saved:
        with run.restoring():
            fit.load_state_dict(saved["fit"])
    reward, columns = run.config.reward.reward, len(column_names(run.config.forces))
    again = f"learning from its demonstrations again, with reward {reward} and {columns} state columns"
    say(f"{run.imitation} was trained with another reward or state: {again}")

    def save_epoch(row: dict[str, Any]) -> None:
        run.save_checkpoint({"fit": fit.state_dict()})
        if stop.requested:
            raise Interrupted

    with progress("imitation", fit.batches_left(memory)) as advance:
        fit_memory(fit, memory, save_epoch, advance)
    return fit.network


def train_stretch(
    run: Run, learner: Learner, explorer: Explorer, advance: Callable[[int], None], stop: StopSignal
) -> None:
    """Train up to the next validation, saving checkpoints; `advance` is called with the episodes of each round."""
    settings = run.config.reinforcement
    until = min(settings.validation_interval * (learner.episode // settings.validation_interval + 1), settings.episodes)
    saved_at = time.monotonic()
    for record, loss in reinforce(learner, explorer.start, until):
        first = learner.episode - len(record.steps)
        rows = [
            {"episode": episode, "scene": row.pop("episode"), **row, "loss": loss}
            for episode, row in enumerate(episode_rows(record), start=first)
        ]
        learner.rows += rows
        run.append_rows("metrics.csv", rows)
        advance(len(rows))
        if stop.requested or learner.episode == until or time.monotonic() - saved_at > CHECKPOINT_EVERY:
            run.save_checkpoint(learner.state_dict())
            saved_at = time.monotonic()
        if stop.requested:
            raise Interrupted


def due(learner: Learner, settings: Reinforcement) -> bool:
    """Whether the next validation is due: at every interval and at the end, once each."""
    validated = bool(learner.validations) and learner.validations[-1]["episode"] == learner.episode
    regular = learner.episode % settings.validation_interval == 0 or learner.episode >= settings.episodes
    return regular and not validated


def validate(run: Run, learner: Learner, stop: StopSignal, say: Callable[[str], None], threads: int) -> None:
    """Play the validation episodes, add a row to validation.csv, and save the network if no earlier one was better."""
    settings = run.config.reinforcement
    policy = SarlPolicy(learner.tested, run.config, threads)
    rates = metrics(play(policy, "validation", settings.validation_episodes, stop.watch(no_progress)))
    row = {"episode": learner.episode} | {name: rates[name] for name in VALIDATED}
    if row["success"] >= max((old["success"] for old in learner.validations), default=0.0):
        save_weights(learner.tested, run.config, run.folder / BEST)
    learner.validations.append(row)
    run.append_rows("validation.csv", [row])
    shown = ", ".join(f"{name} {rates[name]:.3f}" for name in ("success", "collision", "timeout"))
    say(f"validation at {learner.episode} of {settings.episodes}: {shown}")


def test(run: Run, learner: Learner, progress: Progress, threads: int) -> dict[str, Any]:
    """Test the trained network alone and, if asked, with recovery and as of its best validation; returns metrics."""
    config, settings = run.config, run.config.reinforcement
    alone = RememberingPolicy(learner.tested, config, threads)
    record = play(alone, "test", settings.test_episodes, progress)
    result = metrics(record)
    run.write_table("test.csv", episode_rows(record))
    if config.planner.recover:
        recovering = with_recovery(alone, config.planner)
        result["with_recovery"] = metrics(play(recovering, "test", settings.test_episodes, progress), recovering)
    if settings.test_best:
        best = best_validation(learner.validations)
        if best["episode"] != learner.episode:
            network, _ = load_weights(run.folder / BEST)
            record = play(SarlPolicy(network, config, threads), "test", settings.test_episodes, progress)
        run.write_table("test-best.csv", episode_rows(record))
        result["best_validation"] = {"episode": best["episode"]} | metrics(record)
    return result


def play(policy: Policy, phase: str, episodes: int, progress: Progress) -> Record:
    """Play validation or test episodes (`phase`) with a network; they are the same for every training seed."""
    config = policy.config
    with progress(phase, episodes) as advance:
        return evaluation_record(
            policy,
            environment=config.reinforcement.test_environment,
            episodes=episodes,
            seed=EVALUATION_SEED,
            simulation=config.simulation,
            phase=phase,
            progress=advance,
        )


def best_validation(validations: list[dict[str, Any]]) -> dict[str, Any]:
    """The validation with the highest success rate; the last of several."""
    return max(validations, key=lambda row: (row["success"], row["episode"]))
