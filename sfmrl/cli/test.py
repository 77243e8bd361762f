"""The commands that test policies: `sfmrl eval`, `sfmrl compare`, `sfmrl models`."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from sfmrl.cli import options
from sfmrl.cli.console import err, new_file, print_metrics, print_sheet, replay_command, say, say_result
from sfmrl.cli.options import option, settings_options
from sfmrl.cli.session import among, choose, drawn
from sfmrl.config import Config, ConfigError, counted, suggest
from sfmrl.runs.files import DamagedFile, csv_text, write_text

app = typer.Typer()


@app.command("eval", epilog="Example: sfmrl eval orca --environment 2 --episodes 100 --csv orca.csv")
@settings_options("simulation", "reward", "planner")
def evaluate_command(
    policy: options.PolicyName = None,
    environment: options.Environment = None,
    map_file: options.MapFile = None,
    episodes: options.Episodes = 500,
    seed: options.Seed = 0,
    humans: options.Humans = None,
    human_speed: options.HumanSpeed = None,
    as_json: Annotated[bool, option("print JSON", "--json")] = False,
    csv: Annotated[Path | None, option("write a line an episode to this file")] = None,
    overwrite: options.Overwrite = False,
    trust_reward: options.TrustReward = False,
    threads: options.Threads = None,
    *,
    settings: dict[str, Any],
) -> None:
    """Test a policy: success, collisions, time-outs, navigation time, total reward."""
    from sfmrl.evaluation import episode_rows, metrics

    new_file(csv, "csv", overwrite)
    asked = drawn(map_file, environment)
    chosen, name, config = choose(policy, settings, threads, trust_reward)
    environment = config.reinforcement.test_environment if asked is None else asked
    test = {"environment": environment, "episodes": episodes, "seed": seed}
    (record,) = _play([chosen], config, **test, people=humans, people_speed=human_speed)
    result = metrics(record, chosen)
    given, crowd = among(humans, human_speed)
    if csv:
        write_text(csv, csv_text(episode_rows(record)))
    if as_json:
        say_result(json.dumps({"policy": name, "environment": environment, "seed": seed} | given | result, indent=2))
        return
    print_metrics(result, f"{name}, {_title(map_file, environment, crowd, episodes, seed)}")
    if result["failures"]:
        first, place = result["failures"][0]["episode"], _place(map_file, asked, environment)
        see = replay_command(policy, place, seed, first, given | settings, trust_reward=trust_reward)
        _say_failures(result["failures"], see)


def _play(policies: Sequence[Any], config: Config, **test: Any) -> list[Any]:
    """Return the records of policies that play the same test episodes, under a config's simulation and reward."""
    from sfmrl.evaluation import evaluation_record
    from sfmrl.runs.progress import show_progress

    test |= {"simulation": config.simulation, "reward": config.reward}
    records = []
    for policy in policies:
        with show_progress(err)("test", test["episodes"]) as advance:
            records.append(evaluation_record(policy, **test, progress=advance))
    return records


def _title(map_file: Path | None, environment: str, crowd: str, episodes: int, seed: int) -> str:
    from sfmrl.scenes import label

    where = f"map {map_file}" if map_file else f"environment {label(environment)}"
    return f"{where}{crowd}, {counted(episodes, 'episode')}, seed {seed}"


def _place(map_file: Path | None, asked: str | None, environment: str) -> tuple[str, Any] | None:
    """Return the option that leads to the environment; None for the map that a run was trained on and has with it."""
    from sfmrl.scenes import label

    if asked is None and environment != label(environment):
        return None
    return ("--map", map_file) if map_file else ("--environment", environment)


def _say_failures(failures: list[dict[str, Any]], see: str) -> None:
    """Say which episodes failed, what to type to see one, and which of them no robot can solve."""
    failed = [failure["episode"] for failure in failures]
    listed = ", ".join(map(str, failed[:12])) + (", ..." if len(failed) > 12 else "")
    say(f"{counted(len(failed), 'episode')} ({listed}) failed; see one: {see}")
    no_way = [str(failure["episode"]) for failure in failures if not failure["solvable"]]
    if no_way:
        say(f"unsolvable, the squares leave no way to the goal: {', '.join(no_way[:12])}")


@app.command("compare", epilog="Example: sfmrl compare sarl sarl-sfm6 orca --environment table2")
@settings_options("simulation", "reward", "planner")
def compare_command(
    policies: Annotated[list[str], typer.Argument(help="two or more, as for eval; all are compared with the first")],
    environment: options.Environment = None,
    map_file: options.MapFile = None,
    episodes: options.Episodes = 500,
    seed: options.Seed = 0,
    humans: options.Humans = None,
    human_speed: options.HumanSpeed = None,
    as_json: Annotated[bool, option("print JSON", "--json")] = False,
    csv: Annotated[Path | None, option("write a line an episode of each policy to this file")] = None,
    overwrite: options.Overwrite = False,
    trust_reward: options.TrustReward = False,
    threads: options.Threads = None,
    *,
    settings: dict[str, Any],
) -> None:
    """Compare policies on the same episodes: differences with intervals, and where only one succeeds.

    Total rewards are those of the first one's reward, and the environment its test mix, unless they are given.
    """
    from sfmrl.study.compare import compare, comparison_rows, comparison_sheets

    if len(policies) < 2 or len(set(policies)) < len(policies):
        raise ConfigError(f"compare takes two or more different policies; it got {', '.join(policies)}")
    new_file(csv, "csv", overwrite)
    asked = drawn(map_file, environment)
    chosen, _, configs = zip(*(choose(policy, settings, threads, trust_reward) for policy in policies), strict=True)
    environment = configs[0].reinforcement.test_environment if asked is None else asked
    test = {"environment": environment, "episodes": episodes, "seed": seed}
    records = _play(chosen, configs[0], **test, people=humans, people_speed=human_speed)
    comparison = compare(records, chosen, policies)
    given, crowd = among(humans, human_speed)
    if csv:
        write_text(csv, csv_text(comparison_rows(records, policies)))
    if as_json:
        say_result(json.dumps({"environment": environment, "seed": seed} | given | comparison, indent=2))
        return
    for sheet in comparison_sheets(comparison, _title(map_file, environment, crowd, episodes, seed)):
        print_sheet(sheet)
    if comparison["differing"]:
        episode, versus = _first_difference(comparison["differing"][0], policies)
        place = _place(map_file, asked, environment)
        say("see one: " + replay_command(policies[0], place, seed, episode, given | settings, versus, trust_reward))


def _first_difference(differing: dict[str, Any], policies: list[str]) -> tuple[int, str]:
    """Return an episode's number, and a policy that does otherwise in it than the first one."""
    success = {name: outcome == "success" for name, outcome in differing["outcomes"].items()}
    return differing["episode"], next(name for name in policies[1:] if success[name] != success[policies[0]])


@app.command(epilog="Example: sfmrl models sarl-sfm6")
def models(
    name: Annotated[str | None, typer.Argument(help="print this one's card (default list all)")] = None,
    as_json: Annotated[bool, option("print JSON", "--json")] = False,
) -> None:
    """List the trained networks that come with sfmrl, one for each row of the paper's tables."""
    from sfmrl.runs.weights import model_card, model_names
    from sfmrl.study.sheets import card_lines, model_sheet

    names = model_names()
    if name is not None and name not in names:
        raise ConfigError(f"there is no model {name}; there are {', '.join(names)}{suggest(name, names)}")
    cards = {each: model_card(each) for each in names}
    if as_json:
        say_result(json.dumps(cards[name] if name else cards, indent=2))
        return
    try:
        shown = card_lines(cards[name]) if name else model_sheet(cards)
    except (LookupError, TypeError, ValueError, AttributeError):
        raise DamagedFile("a model's card is not what sfmrl came with; install sfmrl again") from None
    if name:
        say_result("\n".join(shown))
    else:
        print_sheet(shown)
