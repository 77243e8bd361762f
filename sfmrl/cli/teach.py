"""The commands that inspect episodes, runs and the installation: `sfmrl explain`, `sfmrl verify`, `sfmrl doctor`."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer

from sfmrl.cli import completion, options
from sfmrl.cli.console import (
    WIDTH,
    check_new_files,
    err,
    one_line,
    out,
    print_table,
    saving,
    say,
    say_finding,
    say_json,
    say_result,
)
from sfmrl.cli.options import command, number_option, option
from sfmrl.cli.session import TestOptions
from sfmrl.config import MOST_EPISODES, MOST_STEPS
from sfmrl.lessons import Finding
from sfmrl.runs.files import csv_text


@command(
    "sfmrl explain orca --environment 2 --reward sfm --episode 3 --csv steps.csv",
    *("simulation", "reward", "planner"),
    plays=True,
)
def explain(
    policy: str | None = options.POLICY,
    *,
    episode: int = options.EPISODE,
    test: TestOptions,
    settings: dict[str, Any],
    every: int | None = number_option(
        None, "show every N-th step, and steps with events (default a dozen steps)", 1, MOST_STEPS
    ),
    steps: str | None = option(None, "show these steps, e.g. 10:20 (default the whole episode)"),
    as_json: bool = option(False, "print JSON: all steps, all numbers", "--json"),
    csv: Path | None = option(None, "write all numbers to this file, one line per step"),
) -> None:
    """Print an episode step by step: each step's reward by term, and what the paper's rewards would have paid."""
    from sfmrl.episodes import play_episodes
    from sfmrl.lessons.explain import chosen_steps, explain_episode
    from sfmrl.lessons.explanation_tables import explanation_parts

    check_new_files(test.overwrite, csv=csv)
    chosen, name, config = test.choose(policy, settings)
    scene = test.scene(test.where(config), episode, config)
    record = play_episodes(scene, chosen, config.reward, config.simulation, discount=config.discount, keep=True)
    explained = explain_episode(record, 0, chosen, config.reward, config.discount)
    shown = chosen_steps(explained.steps, every, steps)
    with saving(csv_text(explained.steps), csv):
        if as_json:
            what = {"policy": name, "environment": str(scene.environment[0]), "episode": episode, "seed": test.seed}
            what |= {"outcome": str(record.outcome[0]), "time": float(record.time[0]), "discount": config.discount}
            say_json(what | {"reward": asdict(config.reward)} | explained.sums())
            return
        for part in explanation_parts(explained, shown, name, max(out.width, WIDTH)):
            say_result(part) if isinstance(part, str) else print_table(part)


@command("sfmrl verify runs/rl-sarl-sfm2-seed0 --episodes 500")
def verify(
    runs: list[Path] = typer.Argument(
        ..., help="run folders, or archives of them (.zip, .tar, .tar.gz ...)", autocompletion=completion.runs
    ),
    *,
    episodes: int = number_option(
        100, "replay at most this many test episodes or demonstrations (default 100)", 1, MOST_EPISODES
    ),
    tolerance: float | None = number_option(
        None, "share of these that may end differently (default 0, or 0.05 if this machine computes other bits)", 0, 1
    ),
    trust_reward: bool = options.TRUST_REWARD,
    threads: int | None = options.THREADS,
) -> None:
    """Check runs that were handed in: compare files with SHA256SUMS, and replay episodes with the weights.

    Archives are unpacked into a temporary folder. Several runs get one line each; runs with the same weights are named:
    they are copies, or have the same command and seed. Exit code 0 if all that could be checked agrees, else 1, or 2 if
    the only run cannot be read. Digests can be recomputed and so forged; the replayed test cannot. It is not checked
    who trained the weights, and how. A run's own reward is Python code, which is run only with --trust-reward: read it
    first.
    """
    from sfmrl.lessons.handed_in import runs_in, same_weights
    from sfmrl.lessons.verify import verify as findings_of
    from sfmrl.policies import available_cores
    from sfmrl.runs.progress import show_progress

    how = (episodes, tolerance, threads or available_cores(), show_progress(err))
    with runs_in(runs) as (folders, errors):
        if errors and len(runs) == 1:
            raise errors[0]
        disagree = bool(errors)
        for error in errors:
            say_result(one_line(error))
        for name, folder in folders.items():
            found = findings_of(folder, *how, trust_reward=trust_reward)
            wrong, unknown, count = _by_result(_printed(found) if len(folders) + len(errors) == 1 else found)
            aside = f"; not judged: {', '.join(unknown)}" if unknown else ""
            verdict = f"{len(wrong)} of {count} DO NOT AGREE: {', '.join(wrong)}" if wrong else f"all {count} agree"
            say_result(one_line(f"{name}: {verdict}{aside}"))
            disagree |= bool(wrong)
        for name, earlier in same_weights(folders).items():
            say_result(one_line(f"{name}: the same weights as {earlier}: a copy, or the same command and seed"))
    if disagree:
        raise typer.Exit(1)


@command("sfmrl doctor")
def doctor() -> None:
    """Check whether sfmrl works here: versions, terminal, ORCA, two threads, and the processor's bits. Writes nothing.

    Exit code 0 if all is well, else 1.
    """
    from sfmrl.lessons.doctor import examine

    wrong, _, _ = _by_result(_printed(examine(out)))
    if wrong:
        say(f"not ok: {', '.join(wrong)}; see the remedy beside each")
        raise typer.Exit(1)
    say("all is well")


def _printed(findings: Iterable[Finding]) -> Iterator[Finding]:
    """Print findings as they come, and pass them on."""
    for finding in findings:
        say_finding(finding)
        yield finding


def _by_result(findings: Iterable[Finding]) -> tuple[list[str], list[str], int]:
    """The names of the findings that are wrong, and that are not judged, and the number judged."""
    by_result: dict[bool | None, list[str]] = {True: [], False: [], None: []}
    for finding in findings:
        by_result[finding.ok].append(finding.what)
    return by_result[False], by_result[None], len(by_result[True]) + len(by_result[False])
