"""The commands that look closer: `sfmrl explain`, `sfmrl verify`, `sfmrl doctor`."""

import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from sfmrl.cli import completion, options
from sfmrl.cli.console import WIDTH, err, new_file, out, print_table, say, say_finding, say_result
from sfmrl.cli.options import number_option, option, settings_options
from sfmrl.cli.session import choose, drawn, use_threads
from sfmrl.config import EPISODES, STEPS
from sfmrl.runs.files import csv_text, write_text

app = typer.Typer()


@app.command(epilog="Example: sfmrl explain orca --environment 2 --reward sfm --episode 3 --csv steps.csv")
@settings_options("simulation", "reward", "planner")
def explain(
    policy: options.PolicyName = None,
    environment: options.Environment = None,
    map_file: options.MapFile = None,
    episode: options.Episode = 0,
    seed: options.Seed = 0,
    every: Annotated[
        int | None, number_option("show every N-th step, and those with events (default a dozen)", 1, STEPS)
    ] = None,
    steps: Annotated[str | None, option("show these steps, e.g. 10:20 (default the whole episode)")] = None,
    as_json: Annotated[bool, option("print JSON: all steps, all numbers", "--json")] = False,
    csv: Annotated[Path | None, option("write a line a step, all numbers, to this file")] = None,
    overwrite: options.Overwrite = False,
    trust_reward: options.TrustReward = False,
    threads: options.Threads = None,
    *,
    settings: dict[str, Any],
) -> None:
    """Take an episode apart: each step's reward by term, and what the paper's rewards would have paid."""
    from sfmrl.episodes import play_episodes
    from sfmrl.lessons.explain import chosen_steps, explain_episode
    from sfmrl.lessons.tables import explanation_parts
    from sfmrl.scenes import sample_scenes

    new_file(csv, "csv", overwrite)
    environment = drawn(map_file, environment)
    chosen, name, config = choose(policy, settings, threads, trust_reward)
    environment = config.reinforcement.test_environment if environment is None else environment
    scene = sample_scenes(environment, [episode], seed)
    record = play_episodes(scene, chosen, config.reward, config.simulation, discount=config.discount, keep=True)
    explained = explain_episode(record, 0, chosen, config.reward, config.discount)
    shown = chosen_steps(explained.steps, every, steps)
    if csv:
        write_text(csv, csv_text(explained.steps))
    if as_json:
        what = {"policy": name, "environment": str(scene.environment[0]), "episode": episode, "seed": seed}
        what |= {"outcome": str(record.outcome[0]), "time": float(record.time[0]), "discount": config.discount}
        say_result(json.dumps(what | {"reward": asdict(config.reward)} | explained.sums(), indent=2, allow_nan=False))
        return
    for part in explanation_parts(explained, shown, name, max(out.width, WIDTH)):
        say_result(part) if isinstance(part, str) else print_table(part)


@app.command(epilog="Example: sfmrl verify runs/rl-sarl-sfm2-seed0 --episodes 500")
def verify(
    run: Annotated[Path, typer.Argument(help="the run folder", show_default=False, autocompletion=completion.runs)],
    episodes: Annotated[
        int, number_option("test episodes, or demonstrations, to play again at most (default 100)", 1, EPISODES)
    ] = 100,
    tolerance: Annotated[
        float | None,
        number_option(
            "share of them that may end otherwise (default 0, or 0.05 if this machine computes other bits)", 0, 1
        ),
    ] = None,
    trust_reward: options.TrustReward = False,
    threads: options.Threads = None,
) -> None:
    """Check a run that was handed in: files against SHA256SUMS, weights by playing again.

    Exit code 0 if all that could be checked agrees, else 1. Digests can be forged by recomputing them; that
    the weights do what the test's table says cannot, but who trained them, and how, is not checked. A reward of the
    run's own is Python code, and is run only with --trust-reward: read it first.
    """
    from sfmrl.lessons.verify import verify as findings_of
    from sfmrl.runs.progress import show_progress

    how = (episodes, tolerance, use_threads(threads), show_progress(err))
    wrong, unknown, count = _say_findings(findings_of(run, *how, trust_reward=trust_reward))
    aside = f"; not judged: {', '.join(unknown)}" if unknown else ""
    if wrong:
        say_result(f"{run}: {len(wrong)} of {count} DO NOT AGREE: {', '.join(wrong)}{aside}")
        raise typer.Exit(1)
    say_result(f"{run}: all {count} agree{aside}")


@app.command(epilog="Example: sfmrl doctor")
def doctor() -> None:
    """Check whether sfmrl works here: versions, terminal, ORCA, two threads, and the processor's bits. Writes nothing.

    Exit code 0 if all is well, else 1.
    """
    from sfmrl.lessons.doctor import examine

    wrong, _, _ = _say_findings(examine(out))
    if wrong:
        say(f"not ok: {', '.join(wrong)}; what helps stands beside it")
        raise typer.Exit(1)
    say("all is well")


def _say_findings(findings: Iterable[Any]) -> tuple[list[str], list[str], int]:
    """Print findings as they come; returns what is wrong, what is not judged, and how many are judged."""
    by_result: dict[bool | None, list[str]] = {True: [], False: [], None: []}
    for finding in findings:
        say_finding(finding)
        by_result[finding.ok].append(finding.what)
    return by_result[False], by_result[None], len(by_result[True]) + len(by_result[False])
