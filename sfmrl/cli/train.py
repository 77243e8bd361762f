"""The commands that train: `sfmrl il`, `sfmrl rl`."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from sfmrl.cli import completion, options
from sfmrl.cli.console import err, print_metrics, say
from sfmrl.cli.options import command, option
from sfmrl.cli.session import check_planner, check_read, exclude, named_environment, say_differing_settings
from sfmrl.config import Config, ConfigError, as_typed, override
from sfmrl.runs.files import read_regular
from sfmrl.runs.folders import as_options, as_words, finished
from sfmrl.variants import PRESETS, VARIANTS, make_config

VARIANT = option(
    None,
    "the paper's variant: sarl, sarl-sfm, or sarl-sfm2 to sarl-sfm6 (default sarl)",
    autocompletion=completion.among(*VARIANTS),
)


@dataclass(frozen=True)
class TrainingOptions:
    """The options that both trainings have."""

    config: Path | None = option(None, "take the settings from a run's config.json; other options override them")
    run: Path | None = option(None, "run folder to create (default a new one under runs/)")
    resume: Path | None = option(
        None,
        "resume this run; it ends with the same bits as if it had never stopped",
        autocompletion=completion.unfinished_runs,
    )
    overwrite: bool = option(False, "replace the run in --run, if it exists", "--overwrite")
    go_on: bool = option(False, "continue the run in --run, if it exists; do nothing if it is finished", "--continue")
    trust_reward: bool = options.TRUST_REWARD

    def reopen(self, kind: str, *others: Any) -> Any:
        """Open the run to resume; raises ConfigError if other options are given, since a run has its own settings."""
        from sfmrl.own_code.trust import trusted
        from sfmrl.runs.run import open_run

        if any((self.config, self.run, self.overwrite, self.go_on, *others)):
            raise ConfigError(f"--resume takes every setting from {self.resume}; leave out the other options")
        run = open_run(cast(Path, self.resume), kind)
        return replace(run, config=trusted(run.config, self.trust_reward))

    def existing(self) -> dict[str, Any]:
        """Return what `create_run` should do with an existing run; raises ConfigError if that is unclear."""
        exclude({"--continue": self.go_on, "--overwrite": self.overwrite})
        if self.run is None and (self.go_on or self.overwrite):
            flag, what = ("--continue", "continue") if self.go_on else ("--overwrite", "replace")
            raise ConfigError(f"{flag} needs the folder to {what}; name it with --run")
        return {"overwrite": self.overwrite, "go_on": self.go_on}

    def new_config(self, variant: str | None, settings: dict[str, Any]) -> Config:
        """Return the config of a new training: that of --config, or of preset and variant, with settings changed."""
        from sfmrl.own_code.trust import absolute, trusted

        preset = settings.pop("preset", None)
        if name := settings.get("reward", {}).get("reward"):
            settings["reward"]["reward"] = absolute(name)
        if self.config is None:
            config = make_config(preset or "quick", variant or "sarl")
        elif not self.config.exists():
            raise ConfigError(f"there is no file {self.config} for --config; name the config.json of a run")
        else:
            config = trusted(Config.from_json(read_regular(self.config), self.config), self.trust_reward)
            named = make_config(preset or config.preset, variant or "sarl")
            # Beside --config, --preset sets all that some preset changes, and --variant all that some variant changes.
            for given, table in ((preset, PRESETS), (variant, VARIANTS)):
                if given:
                    for entry in table.values():
                        config = override(config, _values(named, entry))
        config = override(config, settings)
        check_read(config.reward, settings.get("reward", {}))
        check_planner([config.planner], settings.get("planner", {}))
        return config


def _values(config: Any, names: dict[str, Any]) -> dict[str, Any]:
    """Return a config's values of the settings in `names`, which nests as the config does."""
    return {
        name: _values(getattr(config, name), inner) if isinstance(inner, dict) else getattr(config, name)
        for name, inner in names.items()
    }


@command("sfmrl il --preset paper --seed 1", "", "simulation", "reward", "planner", "imitation")
def il(variant: str | None = VARIANT, *, settings: dict[str, Any], training: TrainingOptions) -> None:
    """Learn by imitation: play demonstrations by ORCA, and fit the values of their situations."""
    from sfmrl.runs.create import create_run, unusual_simulation
    from sfmrl.runs.training import run_imitation

    if training.resume:
        run = training.reopen("il", variant, settings)
    else:
        run = create_run("il", training.new_config(variant, settings), training.run, **training.existing())
    if training.go_on and _already_finished(run):
        return
    _train(run, run_imitation)
    preset, seed = run.config.preset, run.config.seed
    needed: dict[str, Any] = {} if preset == "quick" else {"preset": preset}
    needed |= ({"seed": seed} if seed else {}) | unusual_simulation(run.config)
    named = run.facts["variant"] in VARIANTS and run.facts["variant"] != "sarl"
    which = ["--variant", run.facts["variant"]] if named else ["--reward", "sfm"]
    which += ["--forces"] if run.config.forces and not named else []
    following = ["sfmrl", "rl", *which, "--from", str(run.folder), *as_options(needed)]
    say(f"done: {run.folder}; next: {as_typed(following)}, or {on_run('eval', run)}")


@command("sfmrl rl --reward sfm --episodes 3000", "", "simulation", "reward", "planner", "reinforcement")
def rl(
    variant: str | None = VARIANT,
    *,
    settings: dict[str, Any],
    map_file: Path | None = options.MAP,
    source: Path | None = option(
        None,
        "imitation run, model or weights file to start from (default the newest imitation run that fits)",
        "--from",
        autocompletion=completion.beginnings,
    ),
    from_scratch: bool = option(False, "start without imitation", "--from-scratch"),
    training: TrainingOptions,
    threads: int | None = options.THREADS,
) -> None:
    """Learn by reinforcement: train the imitation network further by deep V-learning, then test it."""
    from sfmrl.policies import available_cores
    from sfmrl.runs.create import start_run
    from sfmrl.runs.training import run_reinforcement
    from sfmrl.scenes import label

    if training.resume:
        run = training.reopen("rl", variant, settings, map_file, source, from_scratch)
    else:
        exclude({"--from": source, "--from-scratch": from_scratch})
        config = _new_config(variant, map_file, settings, training)
        run = start_run(config, source, from_scratch, training.run, **training.existing())
    if training.go_on and _already_finished(run):
        return
    result = _train(run, partial(run_reinforcement, say=say, threads=threads or available_cores()))
    title = f"{run.folder}, environment {label(run.config.reinforcement.test_environment)}"
    print_metrics(result, f"test of {title}, the network alone")
    if "with_recovery" in result:
        print_metrics(result["with_recovery"], f"test of {title}")
    say(f"done: {run.folder}; next: {on_run('eval', run)}, {on_run('ascii-render', run)}")


def _new_config(
    variant: str | None, map_file: Path | None, settings: dict[str, Any], training: TrainingOptions
) -> Config:
    """Return the config of a new reinforcement; its test environment is by default that of the training."""
    from sfmrl.maps import why_unsolvable
    from sfmrl.scenes import sample_scenes

    schedule = settings.setdefault("reinforcement", {})
    if environment := named_environment(map_file, schedule.get("environment")):
        schedule["environment"] = environment
        schedule.setdefault("test_environment", environment)
    config = training.new_config(variant, settings)
    if map_file and (reason := why_unsolvable(sample_scenes(str(environment), [0]), config.simulation)):
        say(f"{map_file}: {reason}")
    return config


def _say_start(run: Any) -> None:
    """Say what a reinforcement starts from, and which settings differ from those of its network's training."""
    if run.imitation:
        say(f"from imitation run {run.imitation}")
    if weights := run.facts.get("weights"):
        prior = "with" if run.config.value_prior else "without"
        say(f"from the network in {weights['file']}, {prior} --value-prior, as it was trained")
        say_differing_settings(Path(weights["file"]), run.config)
        if "trained_with" in weights:
            say(f"it was trained with {weights['trained_with']}; this training has {weights['goes_on_with']}")


def on_run(command: str, run: Any) -> str:
    """Return what to type to use a run, quoted for the shell, with --trust-reward if its reward is the user's own."""
    from sfmrl.own_code import names_code
    from sfmrl.policies import POLICIES
    from sfmrl.runs.weights import model_names

    name = str(run.folder)  # of a run that is called like a policy, sfmrl eval would take that one
    here = "./" if name in (*POLICIES, *model_names()) or names_code(name) else ""
    return f"sfmrl {command} {here}{as_words(run.folder)}"


def _already_finished(run: Any) -> bool:
    """Whether a training has finished; if so, say it, and remove checkpoints that a killed process left."""
    from sfmrl.runs.run import sole_use

    if not finished(run.folder):
        return False
    if run.checkpoints():
        with sole_use(run):
            pass
    say(f"{run.folder} is finished already")
    return True


def _train(run: Any, work: Callable[..., Any]) -> Any:
    """Train by `work(run, progress, stop)`; raises Interrupted, which says how to resume, if a stop is requested."""
    from sfmrl.rewards import reward_terms
    from sfmrl.runs.bits import machine_bits
    from sfmrl.runs.progress import Interrupted, StopSignal, show_progress
    from sfmrl.runs.run import sole_use

    how = on_run(f"{run.kind} --resume", run)
    run.check_reward()
    reward_terms(run.config.reward)  # raises an error that says why, if it cannot or must not be used
    with sole_use(run), StopSignal(say) as stop:
        if finished(run.folder):
            next_step = f"test it with {on_run('eval', run)}, or begin another run"
            raise ConfigError(f"{run.folder} is finished; nothing is left to train: {next_step}")
        _say_start(run)
        say(f"run folder {run.folder}")
        if run.facts["versions"].get("bits", machine_bits()) != machine_bits():
            say("the run began on a machine with other bits: its numbers will not be those of an uninterrupted run")
        try:
            return work(run, show_progress(err), stop)
        except (Interrupted, KeyboardInterrupt):
            raise Interrupted(f"resume with: {how}") from None
        except OSError as error:  # such as a full disk
            raise OSError(error.errno, f"{error.strerror}; then resume with: {how}", error.filename) from None
