"""Trainings in run folders: drive imitation and reinforcement, save, validate, stop, go on, and test in the end."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from sfmrl.config import Config, ConfigError, Reinforcement
from sfmrl.episodes import Record
from sfmrl.evaluation import episode_rows, evaluation_record, metrics
from sfmrl.fast import FastNetwork
from sfmrl.fast.explorer import Explorer
from sfmrl.imitation import demonstrate, fill_memory, fit_memory, make_memory, new_fit
from sfmrl.learning import Learner
from sfmrl.lookahead import Policy, RememberingPolicy, SarlPolicy
from sfmrl.policies import WEIGHTS
from sfmrl.recovery import with_recovery
from sfmrl.reinforcement import reinforce
from sfmrl.runs.bits import machine_bits
from sfmrl.runs.demonstrations import load_demonstrations, save_demonstrations
from sfmrl.runs.files import DamagedFile, digest_of, read_sums
from sfmrl.runs.folders import BEST, DEMONSTRATIONS, run_folders, unfinished
from sfmrl.runs.progress import Progress, no_progress
from sfmrl.runs.run import Run, check_names, create_run, open_run
from sfmrl.runs.stopping import Interrupted, StopSignal
from sfmrl.runs.weights import load_weights, network_from, save_weights
from sfmrl.states import column_names

CHECKPOINT_EVERY = 20.0  # seconds between checkpoints; when they are taken changes no number
EVALUATION_SEED = 0  # validation and test are the same episodes for every training seed, so that runs compare in pairs
VALIDATED = ("success", "collision", "timeout", "navigation_time", "total_reward")


def run_imitation(run: Run, progress: Progress, stop: StopSignal) -> FastNetwork:
    """Run or go on with an imitation run to its end; raises Interrupted once `stop` has been requested."""
    config = run.config
    path = run.folder / DEMONSTRATIONS
    if not path.exists():
        save_demonstrations(demonstrate(config, stop.watch(progress)), path)
    memory = make_memory(config)
    fill_memory(memory, load_demonstrations(path, config.simulation), config)
    fit = new_fit(config)
    saved = run.load_checkpoint()
    rows = []
    if saved:
        with run.restoring():
            rows = [*saved["rows"]]
            fit.load_state_dict(saved["fit"])

    def keep(row: dict) -> None:
        rows.append(row)
        run.append_rows("metrics.csv", [row])
        run.save_checkpoint({"fit": fit.state_dict(), "rows": rows})
        if stop.requested:
            raise Interrupted

    run.write_table("metrics.csv", rows)
    fit_memory(fit, memory, progress, keep)
    run.finish(fit.network)
    return fit.network


def run_reinforcement(
    run: Run, progress: Progress, stop: StopSignal, say: Callable[[str], None], *, threads: int = 1
) -> dict[str, Any]:
    """Run or go on with a training to its end; returns the final test's metrics.

    Raises Interrupted, with a checkpoint just written, once `stop` has been requested.
    """
    config, settings = run.config, run.config.reinforcement
    learner = begin(run, progress, stop, say)
    run.write_table("metrics.csv", learner.rows)
    run.write_table("validation.csv", learner.validations)
    aside = settings.parallel > 1 and threads > 1
    sizes, left = learner.network.sizes, settings.episodes - learner.episode
    with Explorer(config, threads - aside, aside, sizes) as explorer, progress("reinforcement", left) as told:
        while True:
            if due(learner, settings):
                validate(run, learner, stop, say, threads)
            if learner.episode >= settings.episodes:
                break
            train_stretch(run, learner, explorer, told, stop)
    run.save_checkpoint(learner.state_dict())
    result = test(run, learner, stop.watch(progress), threads)
    run.write_json("result.json", result | {"bits": machine_bits()})  # a training may end on another machine
    run.finish(learner.tested)
    return result


def train_stretch(
    run: Run, learner: Learner, explorer: Explorer, told: Callable[[int], None], stop: StopSignal
) -> None:
    """Train up to the next validation and save checkpoints; `told` is given each round's number of episodes."""
    settings = run.config.reinforcement
    until = min(settings.validation_interval * (learner.episode // settings.validation_interval + 1), settings.episodes)
    saved_at = time.monotonic()
    for record, loss in reinforce(learner, explorer, until):
        first = learner.episode - len(record.steps)
        rows = [
            {"episode": episode, "scene": row.pop("episode"), **row, "loss": loss}
            for episode, row in enumerate(episode_rows(record), start=first)
        ]
        learner.rows += rows
        run.append_rows("metrics.csv", rows)
        told(len(rows))
        if stop.requested or learner.episode == until or time.monotonic() - saved_at > CHECKPOINT_EVERY:
            run.save_checkpoint(learner.state_dict())
            saved_at = time.monotonic()
        if stop.requested:
            raise Interrupted


def play(policy: Policy, phase: str, episodes: int, progress: Progress) -> Record:
    """Play the validation or test episodes of a network's training, the same for every seed of it."""
    config = policy.config
    return evaluation_record(
        policy,
        environment=config.reinforcement.test_environment,
        episodes=episodes,
        seed=EVALUATION_SEED,
        simulation=config.simulation,
        phase=phase,
        progress=progress,
    )


def validate(run: Run, learner: Learner, stop: StopSignal, say: Callable[[str], None], threads: int) -> None:
    """Validate the network as it is now, add a row to validation.csv, and keep the weights if none were better."""
    settings = run.config.reinforcement
    policy = SarlPolicy(learner.tested, run.config, threads)
    rates = metrics(play(policy, "validation", settings.validation_episodes, stop.watch(no_progress)))
    row = {"episode": learner.episode} | {name: rates[name] for name in VALIDATED}
    if row["success"] >= max((old["success"] for old in learner.validations), default=0.0):
        save_weights(learner.tested, run.config, run.folder / BEST)
    learner.validations.append(row)
    run.append_rows("validation.csv", [row])
    say(f"validation at {learner.episode} of {settings.episodes}: {summary(rates)}")


def test(run: Run, learner: Learner, progress: Progress, threads: int) -> dict[str, Any]:
    """Test the trained network alone, with recovery and, if asked, as of its best validation; returns the metrics."""
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


def start_run(config: Config, source: Path | None, from_scratch: bool, folder: Path | None, **existing: bool) -> Run:
    """Make the folder of a new training that goes on from imitation run `source`, or from the newest that fits.

    If `source` is a weights file, the training goes on from its network, without demonstrations and with its
    `value_prior`. `existing` says what becomes of a folder that is there already, as for `create_run`.

    A run fits that was made under the same preset, seed and simulation; its reward and state do not matter. Raises
    ConfigError, with what to type, where there is none.
    """
    check_names(config)  # before an imitation run is missed, which takes minutes to make
    if from_scratch:
        return create_run("rl", config, folder, **existing)
    if source is not None and source.is_file():
        network, _ = load_weights(source)
        if network.forces != config.forces:
            columns, here = (len(column_names(forces)) for forces in (network.forces, config.forces))
            remedy = "--forces" if network.forces else "--no-forces, and a variant without"
            raise ConfigError(f"{source} reads {columns} columns, this training {here}; choose {remedy}")
        config = replace(config, value_prior=network.value_prior)
        weights = {"file": str(source.resolve()), "sha256": digest_of(source)}
        return create_run("rl", config, folder, **existing, weights=weights)
    if source is None:
        fitting = (path for path in run_folders("il") if fits(path, config))
        source = next(fitting, None)
        if source is None:
            flags = f"--preset {config.preset} --seed {config.seed}"
            raise ConfigError(
                f"no finished imitation run fits ({flags}, same simulation): type sfmrl il {flags}, "
                "name a run with --from, or do without with --from-scratch"
            )
    imitation = open_run(source, "il")
    if not imitation.finished:
        raise ConfigError(unfinished(source))
    if imitation.config.simulation != config.simulation:
        raise ConfigError(f"the demonstrations of {source} come from another simulation; name another --from")
    if folder is not None and folder.resolve() == source.resolve():
        raise ConfigError(f"{folder} is the imitation run to start from; name another --run")
    config = replace(config, imitation=imitation.config.imitation)
    demonstrations = read_sums(source)[DEMONSTRATIONS]
    return create_run("rl", config, folder, source, **existing, demonstrations=demonstrations)


def fits(folder: Path, config: Config) -> bool:
    """Whether a folder holds a finished imitation run for trainings with this config; raises DamagedFile."""
    try:
        run = open_run(folder, "il")
    except DamagedFile as error:
        raise DamagedFile(f"{error}, or name a run with --from") from None
    except ConfigError:
        return False
    same = all(getattr(run.config, name) == getattr(config, name) for name in ("preset", "seed", "simulation"))
    return run.finished and same


def begin(run: Run, progress: Progress, stop: StopSignal, say: Callable[[str], None]) -> Learner:
    """The training where it was left, or at its start: the imitation run's network, fitted anew to another state.

    The demonstrations are remembered with the returns that this training's reward gives them.
    """
    config, saved = run.config, run.load_checkpoint()
    memory = make_memory(config)
    if saved and "fit" not in saved:
        with run.restoring():
            network = network_from(saved["network"], "it", config.value_prior)
            learner = Learner(network, memory, config)
            learner.load_state_dict(saved)
            return learner
    if weights := run.facts.get("weights"):
        path = Path(weights["file"])
        if not path.is_file() or digest_of(path) != weights["sha256"]:
            raise DamagedFile(f"{path} is not what this run began with any more; put it back, or start a new run")
        parameters = load_weights(path)[0].state_dict()
        return Learner(network_from(parameters, str(path), config.value_prior), memory, config)
    fit = new_fit(config)
    if run.imitation is None:
        return Learner(fit.network, memory, config)
    source = run.imitation
    demonstrations = source / DEMONSTRATIONS
    if not demonstrations.exists():
        raise DamagedFile(f"{demonstrations} is not there any more; put the imitation run back, or start a new run")
    if read_sums(source).get(DEMONSTRATIONS) != run.facts["demonstrations"]:
        raise DamagedFile(f"{demonstrations} is not the one this run began with; start a new run from it")
    fill_memory(memory, load_demonstrations(demonstrations, config.simulation), config)
    network, learnt_under = load_weights(source / WEIGHTS)
    if (learnt_under.forces, learnt_under.value_prior) == (config.forces, config.value_prior):
        with run.restoring():
            if saved:
                raise ValueError("it is one of a fit, which this run does without")
        return Learner(network, memory, config)

    if saved:
        with run.restoring():
            fit.load_state_dict(saved["fit"])
    columns = len(column_names(config.forces))
    say(f"{source} was trained with another state: learning from its demonstrations again, with {columns} columns")

    def keep(row: dict[str, Any]) -> None:
        run.save_checkpoint({"fit": fit.state_dict()})
        if stop.requested:
            raise Interrupted

    fit_memory(fit, memory, progress, keep)
    return Learner(fit.network, memory, config)


def best_validation(validations: list[dict[str, Any]]) -> dict[str, Any]:
    """The validation with the highest success; of several, the last."""
    return max(validations, key=lambda row: (row["success"], row["episode"]))


def due(learner: Learner, settings: Reinforcement) -> bool:
    """Whether it is time for a validation that has not been made yet."""
    made = bool(learner.validations) and learner.validations[-1]["episode"] == learner.episode
    regular = learner.episode % settings.validation_interval == 0 or learner.episode >= settings.episodes
    return regular and not made


def summary(rates: dict[str, Any]) -> str:
    """Metrics in a line."""
    return ", ".join(f"{name} {rates[name]:.3f}" for name in ("success", "collision", "timeout"))
