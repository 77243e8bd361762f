"""The command that shows episodes: `sfmrl ascii-render`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from sfmrl.config import Config, ConfigError
from sfmrl.console import out, say, say_result
from sfmrl.options import Device, Environment, MapFile, PolicyName, Threads, option, settings_options
from sfmrl.session import choose, drawn

app = typer.Typer()


@app.command("ascii-render", epilog="Example: sfmrl ascii-render orca --environment 3 --episode 17")
@settings_options("simulation", "reward", "planner")
def ascii_render(
    policy: PolicyName = None,
    environment: Environment = None,
    map_file: MapFile = None,
    episode: Annotated[int, option("number of the test episode (default 0)", min=0)] = 0,
    seed: Annotated[int, option("seed of the test episodes (default 0)", min=0)] = 0,
    speed: Annotated[float, option("times real time (default 2)", min=0.01)] = 2.0,
    frames: Annotated[int | None, option("print so many stills instead of playing (a pipe gets 6)", min=1)] = None,
    ascii_only: Annotated[bool, option("7-bit characters only", "--ascii")] = False,
    scenes: Annotated[bool, option("draw a sample of each environment, and play nothing", "--scenes")] = False,
    draw: Annotated[bool, option("print the scene as a map for --map, to edit, and play nothing", "--draw")] = False,
    threads: Threads = None,
    device: Device = "cpu",
    *,
    settings: dict[str, Any],
) -> None:
    """Replay a test episode in the terminal."""
    from sfmrl import replay
    from sfmrl.drawings import draw_map, hindrance
    from sfmrl.episodes import play_episodes
    from sfmrl.scenarios import ENVIRONMENTS, sample_scenes

    plain = ascii_only or not (out.encoding or "").lower().startswith("utf")
    size = {"width": max(out.width, 20), "height": max(out.height - 1, 8), "ascii_only": plain}
    environment = drawn(map_file, environment)
    if scenes and draw:
        raise ConfigError("--scenes and --draw exclude each other; leave out one of them")
    if draw:
        name = Config().reinforcement.test_environment if environment is None else environment
        say_result(draw_map(sample_scenes(name, [episode], seed)).rstrip("\n"))
        return
    if scenes:
        for name in "12345" if environment is None else [environment]:
            out.print(replay.scene_picture(sample_scenes(name, [episode], seed), **size))
            out.print(ENVIRONMENTS.get(name, ""), end="\n\n")
        return
    chosen, name, config = choose(policy, settings, threads, device)
    environment = config.reinforcement.test_environment if environment is None else environment
    scene = sample_scenes(environment, [episode], seed)
    if reason := hindrance(scene, config.simulation.time_limit):
        say(reason)
    record = play_episodes(scene, chosen, config.reward, config.simulation, discount=config.discount)
    pictures = replay.make_frames(
        record, 0, policy=chosen, label=Path(name).name, reward=config.reward, discount=config.discount, **size
    )
    if frames or not out.is_terminal or out.is_dumb_terminal:
        for picture in replay.strip(pictures, frames or 6):
            out.print(picture.text if out.is_terminal else picture.plain, highlight=False)
    else:
        replay.play_live(pictures, out, speed=speed)
