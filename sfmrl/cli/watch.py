"""The command that shows episodes: `sfmrl ascii-render`."""

import dataclasses
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from sfmrl.cli import options
from sfmrl.cli.console import new_file, out, say, say_result
from sfmrl.cli.options import number_option, option, settings_options
from sfmrl.cli.session import choose, drawn
from sfmrl.config import Config, ConfigError, counted

app = typer.Typer()
LEAST = (20, 8)  # columns and lines that a frame has at least
FILES = (80, 24)  # ... and those of frames in files, whatever the terminal


@app.command("ascii-render", epilog="Example: sfmrl ascii-render orca --environment 3 --episode 17")
@settings_options("simulation", "reward", "planner")
def ascii_render(
    policy: options.PolicyName = None,
    versus: Annotated[str | None, option("a second policy in the same episode, beside it and by its reward")] = None,
    environment: options.Environment = None,
    map_file: options.MapFile = None,
    episode: options.Episode = 0,
    seed: options.Seed = 0,
    humans: options.Humans = None,
    human_speed: options.HumanSpeed = None,
    speed: Annotated[float, number_option("times real time (default 2)", 0.01, 64)] = 2.0,
    frames: Annotated[
        int | None, number_option("number of stills, instead of playing (default a pipe 6, SVG 1)", 1, 10_000)
    ] = None,
    at: Annotated[float | None, number_option("the still at this time, in s, instead of playing", 0, 3600)] = None,
    size: Annotated[str | None, option("COLUMNSxLINES (default the terminal's; in files 80x24)")] = None,
    ascii_only: Annotated[bool, option("7-bit characters only", "--ascii")] = False,
    scenes: Annotated[bool, option("draw a sample of each environment, and play nothing", "--scenes")] = False,
    draw: Annotated[bool, option("print the scene as a map for --map, to edit, and play nothing", "--draw")] = False,
    svg: Annotated[Path | None, option("write the last frame, or stills one below the other, as a picture")] = None,
    cast: Annotated[Path | None, option("write a recording that asciinema and its like play")] = None,
    overwrite: options.Overwrite = False,
    trust_reward: options.TrustReward = False,
    threads: options.Threads = None,
    *,
    settings: dict[str, Any],
) -> None:
    """Replay a test episode in the terminal, or write it to files."""
    files = {flag: path for flag, path in (("--svg", svg), ("--cast", cast)) if path}
    for flag, path in files.items():
        new_file(path, flag.removeprefix("--"), overwrite)
    if len({path.resolve() for path in files.values()}) < len(files):
        raise ConfigError(f"{' and '.join(files)} name the same file; each needs its own")
    if scenes and draw:
        raise ConfigError("--scenes and --draw exclude each other; leave out one of them")
    if (scenes or draw) and (files or versus):
        which = "--scenes" if scenes else "--draw"
        raise ConfigError(f"{which} plays nothing; leave out {next(iter(files), '--versus')}")
    if frames and at is not None:
        raise ConfigError("--frames and --at both choose stills; leave out one of them")
    if (frames or at is not None) and list(files) == ["--cast"]:
        raise ConfigError("--frames and --at choose stills, but a recording has every step; leave them out")
    room = _parsed(size) if size else FILES if files else (max(out.width, LEAST[0]), max(out.height - 1, LEAST[1]))
    ascii_only = ascii_only or (not files and not (out.encoding or "").lower().startswith("utf"))
    environment = drawn(map_file, environment)
    from sfmrl.scenes import sample_scenes

    sample = partial(sample_scenes, episodes=[episode], seed=seed, people=humans, people_speed=human_speed)
    if draw:
        from sfmrl.maps import draw_map

        name = Config().reinforcement.test_environment if environment is None else environment
        say_result(draw_map(sample(name)).rstrip("\n"))
        return
    if scenes:
        _print_scenes(environment, sample, room, ascii_only)
        return
    from sfmrl.replay import SIDE_BY_SIDE_COLUMNS, STACKED_LINES

    if versus and not (room[0] >= SIDE_BY_SIDE_COLUMNS or room[1] >= STACKED_LINES):
        raise ConfigError(
            f"--versus needs {SIDE_BY_SIDE_COLUMNS} columns or {STACKED_LINES} lines; here are {room[0]} and {room[1]}"
        )
    names = [policy, versus] if versus else [policy]
    replay = _play(names, environment, sample, settings, threads, trust_reward)
    replay = dataclasses.replace(replay, ascii_only=ascii_only)
    if files:
        _write(files, replay, room, {"count": frames if at is not None else frames or 1, "at": at}, speed)
    elif frames or at is not None or not out.is_terminal or out.is_dumb_terminal:
        for picture in replay.frames(*room, frames or 6, at):
            out.print(picture.text if out.is_terminal else picture.plain, markup=False, highlight=False, soft_wrap=True)
    else:
        from sfmrl.replay import play_live

        def draw(t: int, columns: int, lines: int) -> Any:
            return replay.frame(t, *(room if size else (columns, lines))).text

        play_live(draw, replay.last, out, speed, replay.time_step)


def _parsed(size: str) -> tuple[int, int]:
    """Columns and lines from "120x40"; raises ConfigError."""
    match = re.fullmatch(r"(\d{1,3})x(\d{1,3})", size)
    columns, lines = map(int, match.groups()) if match else (0, 0)
    if columns < LEAST[0] or lines < LEAST[1]:
        raise ConfigError(f"--size is {size}; it takes COLUMNSxLINES, as in 120x40, from {LEAST[0]}x{LEAST[1]} on")
    return columns, lines


def _print_scenes(environment: str | None, sample: Callable, room: tuple[int, int], ascii_only: bool) -> None:
    """A picture of a sample of an environment, or of each."""
    from sfmrl.replay import scene_picture
    from sfmrl.scenes import ENVIRONMENTS

    for name in "12345" if environment is None else [environment]:
        scenes = sample(name)
        out.print(scene_picture(scenes, width=room[0], height=room[1], ascii_only=ascii_only), soft_wrap=True)
        out.print(ENVIRONMENTS.get(name, ""), end="\n\n")


def _play(
    names: list[str | None],
    environment: str | None,
    sample: Callable,
    settings: dict[str, Any],
    threads: int | None,
    trust_reward: bool,
) -> Any:
    """The episode that `sample` returns for an environment, as every policy plays it.

    It is judged by the first one's reward, and is in the first one's test environment if none was given.
    """
    from sfmrl.episodes import play_episodes
    from sfmrl.maps import why_unsolvable
    from sfmrl.replay import Replay, make_story

    policies = [choose(name, settings, threads, trust_reward) for name in names]
    config = policies[0][2]
    scene = sample(environment or config.reinforcement.test_environment)
    if reason := why_unsolvable(scene, config.simulation.time_limit):
        say(reason)
    how = (config.reward, config.simulation)
    stories = []
    for policy, _, _ in policies:
        record = play_episodes(scene, policy, *how, discount=config.discount, keep=True)
        stories.append(make_story(record, 0, policy, config.reward, config.discount))
    labels = [Path(name).name for _, name, _ in policies]
    if len(set(labels)) < len(labels):  # runs of one name in two folders
        labels = [name for _, name, _ in policies]
    return Replay(tuple(stories), tuple(labels))


def _write(files: dict[str, Path], replay: Any, room: tuple[int, int], stills: dict[str, Any], speed: float) -> None:
    """Write the replay to the files of some flags, and say so; `stills` is what `Replay.frames` takes for a picture."""
    from sfmrl.replay import to_cast, to_svg
    from sfmrl.runs.files import write_atomically

    colour = not out.no_color
    for flag, path in files.items():
        if flag == "--svg":
            shown = replay.frames(*room, **stills)
            data = to_svg(shown, replay.title, colour).encode()
        else:
            shown = replay.frames(*room)
            data = to_cast(shown, replay.title, speed, colour).encode()
        write_atomically(path, data, checked=False)
        say(f"wrote {path}: {counted(len(shown), 'frame')} of {room[0]}x{room[1]}, {len(data) / 1000:.0f} kB")
