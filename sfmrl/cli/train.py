"""The commands that train: `sfmrl il`, `sfmrl rl`."""

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from sfmrl.cli import completion, options
from sfmrl.cli.console import as_options, print_metrics, say
from sfmrl.cli.options import option, settings_options
from sfmrl.cli.session import (
    already_finished,
    drawn,
    existing,
    new_config,
    on_run,
    reopen,
    say_habits,
    train,
    use_threads,
)
from sfmrl.config import Config, ConfigError

app = typer.Typer()


@app.command(epilog="Example: sfmrl il --preset paper --seed 1")
@settings_options("", "simulation", "reward", "planner", "imitation")
def il(
    variant: options.Variant = None,
    run: options.RunFolder = None,
    resume: options.Resume = None,
    overwrite: options.Overwrite = False,
    go_on: options.Continue = False,
    trust_reward: options.TrustReward = False,
    threads: options.Threads = None,  # as the other commands have it; ORCA and learning take one
    *,
    settings: dict[str, Any],
) -> None:
    """Imitation: learn from ORCA's demonstrations what situations are worth."""
    from sfmrl.runs.create import create_run
    from sfmrl.runs.training import run_imitation

    if resume:
        given = [variant, run, overwrite or None, go_on or None, *settings.values()]
        current = reopen("il", resume, given, trust_reward)
    else:
        current = create_run("il", new_config(variant, settings), run, **existing(run, overwrite, go_on))
    if go_on and already_finished(current):
        return
    train(current, lambda progress, stop: run_imitation(current, progress, stop))
    plain, made = asdict(Config()), asdict(current.config)
    needed = {name: made[name] for name in ("preset", "seed") if made[name] != plain[name]}
    needed |= {name: value for name, value in made["simulation"].items() if value != plain["simulation"][name]}
    following = ["sfmrl", "rl", "--reward", "sfm", "--from", str(current.folder), *as_options(needed)]
    say(f"done: {current.folder}; next: {shlex.join(following)}, or {on_run('eval', current)}")


@app.command(epilog="Example: sfmrl rl --reward sfm --episodes 3000")
@settings_options("", "simulation", "reward", "planner", "reinforcement")
def rl(
    variant: options.Variant = None,
    source: Annotated[
        Path | None,
        option(
            "imitation run, or weights file, to start from (default the newest run that fits)",
            "--from",
            autocompletion=completion.imitation_runs,
        ),
    ] = None,
    from_scratch: Annotated[bool, option("start without imitation", "--from-scratch")] = False,
    map_file: options.MapFile = None,
    run: options.RunFolder = None,
    resume: options.Resume = None,
    overwrite: options.Overwrite = False,
    go_on: options.Continue = False,
    trust_reward: options.TrustReward = False,
    threads: options.Threads = None,
    *,
    settings: dict[str, Any],
) -> None:
    """Reinforcement: deep V-learning on from what imitation gave, then a test."""
    from sfmrl.maps import why_unsolvable
    from sfmrl.runs.create import start_run
    from sfmrl.runs.training import run_reinforcement
    from sfmrl.scenes import label, sample_scenes

    workers = use_threads(threads)
    if resume:
        flags = (from_scratch or None, overwrite or None, go_on or None)
        current = reopen("rl", resume, [variant, source, map_file, run, *flags, *settings.values()], trust_reward)
    else:
        if source and from_scratch:
            raise ConfigError("--from and --from-scratch exclude each other; leave out one of them")
        schedule = settings.setdefault("reinforcement", {})
        if environment := drawn(map_file, schedule.get("environment")):
            schedule["environment"] = environment
            schedule.setdefault("test_environment", environment)
        config = new_config(variant, settings)
        if map_file and (reason := why_unsolvable(sample_scenes(environment, [0]), config.simulation.time_limit)):
            say(f"{map_file}: {reason}")
        current = start_run(config, source, from_scratch, run, **existing(run, overwrite, go_on))
    if go_on and already_finished(current):
        return
    if current.imitation:
        say(f"from imitation run {current.imitation}")
    if weights := current.facts.get("weights"):
        prior = "with" if current.config.value_prior else "without"
        say(f"from the network in {weights['file']}, {prior} value-prior as there")
        say_habits(Path(weights["file"]), current.config)
    result = train(current, lambda progress, stop: run_reinforcement(current, progress, stop, say, threads=workers))
    title = f"{current.folder}, environment {label(current.config.reinforcement.test_environment)}"
    print_metrics(result, f"test of {title}, the network alone")
    if "with_recovery" in result:
        print_metrics(result["with_recovery"], f"test of {title}")
    say(f"done: {current.folder}; next: {on_run('eval', current)}, {on_run('ascii-render', current)}")
