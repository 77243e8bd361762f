"""What the commands share: from options to configs, runs, policies, scenes; and a training that can be stopped."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from sfmrl.cli.console import err, say
from sfmrl.config import Config, ConfigError, counted, override
from sfmrl.runs.folders import as_words, finished, newest_run
from sfmrl.variants import make_config


def new_config(variant: str | None, settings: dict[str, Any]) -> Config:
    """Return the config of a new training from the options that were given."""
    from sfmrl.own_code import absolute

    preset = settings.pop("preset", "quick")
    if name := settings.get("reward", {}).get("reward"):
        settings["reward"]["reward"] = absolute(name)
    return make_config(preset, variant or "sarl", **settings)


def reopen(kind: str, folder: Path, given: list[Any], trust_reward: bool) -> Any:
    """Open the run to go on with; raises ConfigError where settings are `given`, since it keeps its own."""
    from sfmrl.own_code import trusted
    from sfmrl.runs.run import open_run

    if any(value is not None for value in given):
        raise ConfigError(f"--resume takes every setting from {folder}; leave out all but --threads")
    run = open_run(folder, kind)
    return replace(run, config=trusted(run.config, trust_reward))


def existing(folder: Path | None, overwrite: bool, go_on: bool) -> dict[str, bool]:
    """Return what to do with a run folder that is there already; raises ConfigError where that is contradictory."""
    if go_on and folder is None:
        raise ConfigError("--continue needs the folder to go on with; name it with --run")
    if go_on and overwrite:
        raise ConfigError("--continue and --overwrite exclude each other; leave out one of them")
    return {"overwrite": overwrite, "go_on": go_on}


def already_finished(run: Any) -> bool:
    """Whether a training has finished; if so, say it, and remove checkpoints that a killed process left."""
    from sfmrl.runs.run import sole_use

    if not finished(run.folder):
        return False
    if run.checkpoints():  # it was killed while it removed them
        with sole_use(run):
            pass
    say(f"{run.folder} is finished already")
    return True


def use_threads(threads: int | None) -> int:
    """Return how many threads to work on."""
    from sfmrl.lookahead import available_cores

    return threads or available_cores()


def on_run(command: str, run: Any) -> str:
    """Return what to type to use a run, quoted for the shell, with --trust-reward if its reward is the user's own."""
    return f"sfmrl {command} {as_words(run.folder)}"


def train(run: Any, work: Callable[..., Any]) -> Any:
    """Train; raises Interrupted, which says how to go on, when it is asked to stop."""
    from sfmrl.own_code import reward_digest
    from sfmrl.rewards import reward_terms
    from sfmrl.runs.bits import machine_bits
    from sfmrl.runs.progress import Interrupted, StopSignal, show_progress
    from sfmrl.runs.run import sole_use

    how = on_run(f"{run.kind} --resume", run)
    if run.facts.get("own_reward") != reward_digest(run.config.reward):
        raise ConfigError(f"{run.config.reward.reward} has changed since {run.folder} began; start a new run with it")
    reward_terms(run.config.reward)  # which says why if it cannot, or must not, be used
    with sole_use(run), StopSignal(say) as stop:
        if finished(run.folder):
            next_step = f"test it with {on_run('eval', run)}, or begin another run"
            raise ConfigError(f"{run.folder} is finished; there is nothing to go on with: {next_step}")
        say(f"run folder {run.folder}")
        if run.facts["versions"].get("bits", machine_bits()) != machine_bits():
            say("the run began where other bits are computed: it will not end in those of an uninterrupted training")
        try:
            return work(show_progress(err), stop)
        except (Interrupted, KeyboardInterrupt):
            raise Interrupted(f"go on with: {how}") from None
        except OSError as error:  # as where the disk is full
            raise OSError(error.errno, f"{error.strerror}; then go on with: {how}", error.filename) from None


def choose(
    policy: str | None, settings: dict[str, Any], threads: int | None, trust_reward: bool
) -> tuple[Any, str, Config]:
    """Return the policy to play, its name, and its config with the options that were given.

    Without a name, it is the newest finished run. The reward that a network looks ahead with is run if it is sfmrl's,
    if --reward names it, or with --trust-reward.
    """
    from sfmrl.policies import POLICIES, load_policy
    from sfmrl.recovery import with_recovery
    from sfmrl.runs.weights import find_weights, model_names

    name = policy or str(newest_run(say))
    if not policy:
        say(f"policy: {name}")
    trust = trust_reward or settings.get("reward", {}).get("reward", False)
    chosen = load_policy(name, None if name in POLICIES else use_threads(threads), trust_reward=trust)
    config = override(getattr(chosen, "config", Config()), settings)
    if name not in (*POLICIES, *model_names()):
        say_habits(find_weights(name), config)
    return with_recovery(chosen, config.planner), name, config


def say_habits(path: Path, config: Config) -> None:
    """Say on standard error what the files beside a CrowdNav checkpoint say that is otherwise under a config."""
    from sfmrl.runs.crowdnav import other_habits

    for note in other_habits(path, config.simulation.robot_visible):
        say(note)


def drawn(map_file: Path | None, environment: str | None) -> str | None:
    """Return the environment that --map or --environment asks for; None where neither was given."""
    from sfmrl.maps import load_map

    if map_file and environment is not None:
        raise ConfigError("--map and --environment exclude each other; leave out one of them")
    return load_map(map_file) if map_file else environment


def among(humans: int | None, human_speed: float | None) -> tuple[dict[str, Any], str]:
    """Return what was given of --humans and --human-speed, by name, and in words for a title."""
    from sfmrl.scenes import circle_of

    given = {name: value for name, value in (("humans", humans), ("human_speed", human_speed)) if value is not None}
    words = "" if humans is None else f", {counted(humans, 'human')} on a circle of {circle_of(humans):g} m"
    return given, words + ("" if human_speed is None else f", humans at {human_speed:g} m/s")
