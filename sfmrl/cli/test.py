"""The commands that test policies: `sfmrl eval`, `sfmrl compare`."""

from pathlib import Path
from typing import Any

import typer

from sfmrl.cli import options
from sfmrl.cli.console import check_new_files, print_metrics, print_sheet, print_social, saving, say, say_json
from sfmrl.cli.options import command, option
from sfmrl.cli.session import TestOptions, code_facts, setting_facts
from sfmrl.config import ConfigError, counted
from sfmrl.runs.files import csv_text

SOCIAL = option(False, "also print a table of how the robot treats people", "--social")
LISTED = 12  # failed episodes whose numbers are printed


@command(
    "sfmrl eval orca --environment 2 --episodes 100 --csv orca.csv",
    *("simulation", "reward", "planner"),
    plays=True,
)
def evaluate(
    policy: str | None = options.POLICY,
    *,
    episodes: int = options.EPISODES,
    test: TestOptions,
    settings: dict[str, Any],
    as_json: bool = options.JSON,
    csv: Path | None = option(None, "write one line per episode to this file"),
    social: bool = SOCIAL,
) -> None:
    """Test a policy: success, collisions, time-outs, navigation time, total reward.

    --social adds gaps, danger, jerk, path length and more, each with its formula; --json and --csv always have them.
    """
    from sfmrl.evaluation import episode_rows, metrics
    from sfmrl.maps import why_unsolvable
    from sfmrl.study.social import social_metrics, social_rows

    check_new_files(test.overwrite, csv=csv)
    chosen, name, config = test.choose(policy, settings)
    (record,) = test.play([chosen], config, episodes, settings)
    result = metrics(record, chosen)
    rows = [row | more for row, more in zip(episode_rows(record), social_rows(record), strict=True)] if csv else []
    with saving(csv_text(rows), csv):
        if as_json:
            what = {"policy": name} | code_facts([name]) | test.facts(config)
            say_json(what | result | {"social": social_metrics(record)} | setting_facts(config, settings))
            return
        print_metrics(result, f"{name}, {test.title(config, episodes, settings)}")
        if social:
            print_social(social_metrics(record))
    if failures := result["failures"]:
        failed = ", ".join(str(failure["episode"]) for failure in failures[:LISTED])
        see = test.replay_command(name, config, failures[0]["episode"], settings)
        more = ", ..." if len(failures) > LISTED else ""
        say(f"{counted(len(failures), 'episode')} ({failed}{more}) failed; see one: {see}")
    failed_scenes = record.scenes.take(record.outcome != "success")
    if unsolvable := [str(failure["episode"]) for failure in failures if not failure["solvable"]]:
        say(f"unsolvable, since the squares leave no path to the goal: episodes {', '.join(unsolvable[:LISTED])}")
    elif failures and (reason := why_unsolvable(failed_scenes, config.simulation)):
        say(reason)


@command("sfmrl compare sarl sarl-sfm6 orca --environment table2", "simulation", "reward", "planner", plays=True)
def compare(
    policies: list[str] = typer.Argument(..., help="two or more policies; all are compared with the first"),
    *,
    episodes: int = options.EPISODES,
    test: TestOptions,
    settings: dict[str, Any],
    as_json: bool = options.JSON,
    csv: Path | None = option(None, "write one line per episode and policy to this file"),
    social: bool = SOCIAL,
) -> None:
    """Compare policies on the same episodes: differences with intervals, and where only one succeeds.

    Unless you name them, reward and environment are those of the first policy's training and test.
    """
    from sfmrl.study.compare import compare as compare_records
    from sfmrl.study.compare import comparison_rows, comparison_sheets, social_sheet

    if len(policies) < 2 or len(set(policies)) < len(policies):
        raise ConfigError(f"compare takes two or more different policies; it got {', '.join(policies)}")
    check_new_files(test.overwrite, csv=csv)
    chosen, _, config = test.choose_all(policies, settings)
    records = test.play(chosen, config, episodes, settings)
    comparison = compare_records(records, chosen, policies)
    with saving(csv_text(comparison_rows(records, policies)) if csv else "", csv):
        if as_json:
            say_json(code_facts(policies) | test.facts(config) | comparison | setting_facts(config, settings))
            return
        recovering = [row["policy"] for row in comparison["policies"] if "recovered" in row]
        title = test.title(config, episodes, settings)
        title += f"\nwith recovery: {', '.join(recovering)}" if recovering else ""
        for sheet in comparison_sheets(comparison, title):
            print_sheet(sheet)
        if social:
            print_sheet(social_sheet(comparison))
    if comparison["differing"]:
        episode, versus = _first_difference(comparison["differing"][0], policies)
        say(f"see one: {test.replay_command(policies[0], config, episode, settings, versus)}")


def _first_difference(differing: dict[str, Any], policies: list[str]) -> tuple[int, str]:
    """Return the number of an episode, and a policy that succeeds or fails there unlike the first one."""
    success = {name: outcome == "success" for name, outcome in differing["outcomes"].items()}
    return differing["episode"], next(name for name in policies[1:] if success[name] != success[policies[0]])
