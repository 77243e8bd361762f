"""The command line: thin commands that parse, call and print. Results on standard output, all else on standard error.

Exit codes: 0 done, 1 failed, 2 wrong use, 130 interrupted. NumPy and torch are imported by the commands that need them.
"""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from sfmrl.config import Config, ConfigError
from sfmrl.console import err, out, print_metrics, print_sweep, replay_command, say, say_result
from sfmrl.files import DamagedFile, csv_text
from sfmrl.options import settings_options
from sfmrl.session import choose, new_config, reopen, train, usable, use_threads
from sfmrl.variants import MIXES, VARIANTS

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Teach a robot to cross a crowd: imitate ORCA, then reinforce, with and without social forces.",
)


def option(help: str, *flags: str, **extra: Any) -> Any:
    """A Typer option whose help text says all there is to say of its default."""
    return typer.Option(*flags, help=help, show_default=False, **extra)


Threads = Annotated[int | None, option("threads to use (default one a core)", min=1)]
Device = Annotated[str, option("torch device: cpu, cuda, ... (default cpu)")]
RunFolder = Annotated[Path | None, option("run folder to make (default a new one under runs/)")]
Resume = Annotated[Path | None, option("go on with this run, to the same bits as if it had never stopped")]
Overwrite = Annotated[bool, option("replace what is there already", "--overwrite")]
Variant = Annotated[str | None, option(f"the paper's variant: {', '.join(VARIANTS)} (default sarl)")]
PolicyName = Annotated[
    str | None, typer.Argument(help="linear, orca, sfm, a run folder or a weights file (default the newest run)")
]
Environment = Annotated[
    str | None,
    option(f"1 to 5, circle, circle5, {', '.join(MIXES)} or shares, 1:0.7,2:0.3 (default the policy's test mix)"),
]


@app.command(epilog="Example: sfmrl il --preset paper --seed 1")
@settings_options("", "simulation", "reward", "planner", "imitation")
def il(
    variant: Variant = None,
    run: RunFolder = None,
    resume: Resume = None,
    overwrite: Overwrite = False,
    threads: Threads = None,
    device: Device = "cpu",
    *,
    settings: dict[str, Any],
) -> None:
    """Imitation: learn from ORCA's demonstrations what situations are worth."""
    from sfmrl.imitation import imitate
    from sfmrl.runs import create_run

    workers = use_threads(threads)
    device = usable(device)
    if resume:
        current = reopen("il", resume, [variant, run, overwrite or None, *settings.values()])
    else:
        current = create_run("il", new_config(variant, settings), run, overwrite=overwrite)
    train(current, lambda progress, stop: imitate(current, progress, stop, threads=workers, device=device))
    plain, config = Config(), current.config
    flags = "".join(
        f" --{name} {getattr(config, name)}"
        for name in ("preset", "seed")
        if getattr(config, name) != getattr(plain, name)
    )
    say(f"done: {current.folder}; next: sfmrl rl --reward sfm{flags}, or sfmrl eval {current.folder}")


@app.command(epilog="Example: sfmrl rl --reward sfm --episodes 3000")
@settings_options("", "simulation", "reward", "planner", "reinforcement")
def rl(
    variant: Variant = None,
    source: Annotated[
        Path | None, option("imitation run to start from (default the newest that fits)", "--from")
    ] = None,
    from_scratch: Annotated[bool, option("start without imitation", "--from-scratch")] = False,
    run: RunFolder = None,
    resume: Resume = None,
    overwrite: Overwrite = False,
    threads: Threads = None,
    device: Device = "cpu",
    *,
    settings: dict[str, Any],
) -> None:
    """Reinforcement: deep V-learning on from what imitation gave, then a test."""
    from sfmrl.reinforcement import reinforce, start_run

    workers = use_threads(threads)
    device = usable(device)
    if resume:
        current = reopen(
            "rl", resume, [variant, source, from_scratch or None, run, overwrite or None, *settings.values()]
        )
    else:
        if source and from_scratch:
            raise ConfigError("--from and --from-scratch exclude each other")
        schedule = settings.get("reinforcement", {})
        if "environment" in schedule:
            schedule.setdefault("test_environment", schedule["environment"])
        current = start_run(new_config(variant, settings), source, from_scratch, run, overwrite)
    if current.imitation:
        say(f"from imitation run {current.imitation}")
    result = train(
        current, lambda progress, stop: reinforce(current, progress, stop, say, threads=workers, device=device)
    )
    title = f"{current.folder}, environment {current.config.reinforcement.test_environment}"
    print_metrics(result, f"test of {title}, the network alone")
    if "with_recovery" in result:
        print_metrics(result["with_recovery"], f"test of {title}")
    say(f"done: {current.folder}; next: sfmrl eval, sfmrl ascii-render")


@app.command("eval", epilog="Example: sfmrl eval orca --environment 2 --episodes 100 --csv orca.csv")
@settings_options("simulation", "reward", "planner")
def evaluate_command(
    policy: PolicyName = None,
    environment: Environment = None,
    episodes: Annotated[int, option("test episodes (default 500)", min=1)] = 500,
    seed: Annotated[int, option("seed of the test episodes (default 0)", min=0)] = 0,
    sweep: Annotated[
        list[str] | None,
        option(
            "vary one thing, and print a row a value: humans=0:20:5, v_pref=0.5:1.5:0.25, radius_noise=0:0.1:0.05, "
            "crowd=orca,sfm, robot_visible=true,false; can be given several times"
        ),
    ] = None,
    as_json: Annotated[bool, option("print JSON", "--json")] = False,
    csv: Annotated[Path | None, option("write a line an episode, or a value of a sweep, to this file")] = None,
    overwrite: Overwrite = False,
    threads: Threads = None,
    device: Device = "cpu",
    *,
    settings: dict[str, Any],
) -> None:
    """Test a policy: success, collisions, time-outs, navigation time, total reward."""
    from sfmrl.evaluation import episode_rows, evaluation_record, metrics, sweep_rows
    from sfmrl.progress import show_progress
    from sfmrl.sweeps import parse_sweep

    sweeps = [parse_sweep(text) for text in sweep or []]
    if csv and csv.is_dir():
        raise ConfigError(f"--csv {csv} is a folder; name a file")
    if csv and csv.exists() and not overwrite:
        raise ConfigError(f"{csv} is there already; name another --csv, or replace it with --overwrite")
    if csv and not csv.parent.is_dir():
        raise ConfigError(f"there is no folder {csv.parent} for --csv {csv.name}")
    chosen, name, config = choose(policy, settings, threads, device)
    environment = config.reinforcement.test_environment if environment is None else environment
    how = {"environment": environment, "episodes": episodes, "seed": seed}
    how |= {"reward": config.reward, "simulation": config.simulation, "progress": show_progress(err)}
    title = f"{name}, environment {environment}, {episodes} episodes, seed {seed}"
    if sweeps:
        rows = sweep_rows(chosen, sweeps, **how)
        if csv:
            csv.write_text(csv_text(rows))
        if as_json:
            say_result(json.dumps({"policy": name, "environment": environment, "seed": seed, "rows": rows}, indent=2))
        else:
            print_sweep(rows, title)
        return
    record = evaluation_record(chosen, **how)
    result = metrics(record, chosen)
    if csv:
        csv.write_text(csv_text(episode_rows(record)))
    if as_json:
        say_result(json.dumps({"policy": name, "environment": environment, "seed": seed} | result, indent=2))
        return
    print_metrics(result, title)
    if result["failures"]:
        failed = [failure["episode"] for failure in result["failures"]]
        listed = ", ".join(map(str, failed[:12])) + (", ..." if len(failed) > 12 else "")
        see = replay_command(policy, environment, seed, failed[0], settings)
        say(f"{len(failed)} episodes ({listed}) failed; see one: {see}")
        no_way = [str(failure["episode"]) for failure in result["failures"] if not failure["solvable"]]
        if no_way:
            say(f"unsolvable, the squares leave no way to the goal: {', '.join(no_way[:12])}")


@app.command("ascii-render", epilog="Example: sfmrl ascii-render orca --environment 3 --episode 17")
@settings_options("simulation", "reward", "planner")
def ascii_render(
    policy: PolicyName = None,
    environment: Environment = None,
    episode: Annotated[int, option("number of the test episode (default 0)", min=0)] = 0,
    seed: Annotated[int, option("seed of the test episodes (default 0)", min=0)] = 0,
    speed: Annotated[float, option("times real time (default 2)", min=0.01)] = 2.0,
    frames: Annotated[int | None, option("print so many stills instead of playing (a pipe gets 6)", min=1)] = None,
    ascii_only: Annotated[bool, option("7-bit characters only", "--ascii")] = False,
    scenes: Annotated[bool, option("draw a sample of each environment, and play nothing", "--scenes")] = False,
    threads: Threads = None,
    device: Device = "cpu",
    *,
    settings: dict[str, Any],
) -> None:
    """Replay a test episode in the terminal."""
    from sfmrl import replay
    from sfmrl.episodes import play_episodes
    from sfmrl.scenarios import ENVIRONMENTS, sample_scenes

    plain = ascii_only or not (out.encoding or "").lower().startswith("utf")
    size = {"width": max(out.width, 20), "height": max(out.height - 1, 8), "ascii_only": plain}
    if scenes:
        for name in "12345" if environment is None else [environment]:
            out.print(replay.scene_picture(sample_scenes(name, [episode], seed), **size))
            out.print(ENVIRONMENTS.get(name, ""), end="\n\n")
        return
    chosen, name, config = choose(policy, settings, threads, device)
    environment = config.reinforcement.test_environment if environment is None else environment
    scene = sample_scenes(environment, [episode], seed)
    record = play_episodes(scene, chosen, config.reward, config.simulation, discount=config.discount)
    pictures = replay.make_frames(
        record, 0, policy=chosen, label=Path(name).name, reward=config.reward, discount=config.discount, **size
    )
    if frames or not out.is_terminal or out.is_dumb_terminal:
        for picture in replay.strip(pictures, frames or 6):
            out.print(picture.text if out.is_terminal else picture.plain, highlight=False)
    else:
        replay.play_live(pictures, out, speed=speed)


def main() -> None:
    """The `sfmrl` command: every expected failure is one line on standard error."""
    try:
        code = app(standalone_mode=False)
    except typer.TyperException as error:
        where = getattr(getattr(error, "ctx", None), "command_path", "sfmrl")
        code, reason = 2, f"{error.format_message().rstrip('.')}; see {where} --help"
    except (ConfigError, DamagedFile) as error:
        code, reason = 2, str(error)
    except (KeyboardInterrupt, typer.Abort):
        code, reason = 130, "interrupted"
    except OSError as error:
        code, reason = 1, f"{error.filename or ''}: {error.strerror or error}".strip(": ")
    else:
        reason = ""
    if reason:
        say(f"sfmrl: {reason}")
    sys.exit(code or 0)
