"""The command that shows episodes: `sfmrl ascii-render`."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sfmrl.cli import options
from sfmrl.cli.console import check_new_files, out, say, say_result
from sfmrl.cli.options import command, number_option, option
from sfmrl.cli.session import TestOptions, exclude, simulation_for
from sfmrl.config import Config, ConfigError, counted, override
from sfmrl.runs.files import write_text

MINIMUM = (20, 8)  # columns and lines of the smallest frame
IN_FILES = (80, 24)  # columns and lines of frames in files
STILLS = 6  # printed to a pipe


@dataclass(frozen=True)
class Look:
    """The options that choose which part of an episode is shown, and how."""

    frames: int | None = number_option(None, "show N stills (default 6 in a pipe, 1 in an SVG)", 1, 10_000)
    at: float | None = number_option(None, "show the still at this time, s", 0, 3600)
    speed: float = number_option(2.0, "playback speed, times real time (default 2)", 0.01, 64)
    size: str | None = option(None, "size of a frame, COLUMNSxLINES (default the terminal's; in files 80x24)")
    ascii_only: bool = option(False, "use 7-bit characters only", "--ascii")
    svg: Path | None = option(None, "write a picture: the last frame, or the stills one below the other")
    cast: Path | None = option(None, "write a recording that asciinema plays")

    def check(self, overwrite: bool) -> None:
        """Raise ConfigError if files cannot be written, or if options contradict each other."""
        check_new_files(overwrite, svg=self.svg, cast=self.cast)
        exclude({"--frames": self.frames, "--at": self.at})
        if self.cast and not self.svg and self.stills():
            raise ConfigError("--frames and --at choose stills, but a recording has every step; leave them out")

    def stills(self) -> bool:
        """Return whether the options choose stills."""
        return self.frames is not None or self.at is not None

    def room(self) -> tuple[int, int]:
        """Return the columns and lines of a frame; raises ConfigError if --size is wrong."""
        if not self.size:
            in_files = self.svg or self.cast
            return IN_FILES if in_files else (max(out.width, MINIMUM[0]), max(out.height - 1, MINIMUM[1]))
        match = re.fullmatch(r"(\d{1,3})x(\d{1,3})", self.size)
        columns, lines = map(int, match.groups()) if match else (0, 0)
        if columns < MINIMUM[0] or lines < MINIMUM[1]:
            example = f"COLUMNSxLINES, as in 120x40, at least {MINIMUM[0]}x{MINIMUM[1]}"
            raise ConfigError(f"--size is {self.size}; it takes {example}")
        return columns, lines

    def plain(self) -> bool:
        """Return whether to use 7-bit characters: with --ascii, or if the output cannot show others."""
        shown = self.svg is None and self.cast is None
        unicode = (out.encoding or "").lower().startswith("utf") and not out.legacy_windows
        return self.ascii_only or (shown and not unicode)


@command("sfmrl ascii-render orca --environment 3 --episode 17", "simulation", "reward", "planner", plays=True)
def ascii_render(
    policy: str | None = options.POLICY,
    *,
    versus: str | None = option(
        None, "show a second policy beside the first, in the same episode and by the same reward"
    ),
    episode: int = options.EPISODE,
    test: TestOptions,
    settings: dict[str, Any],
    look: Look,
    scenes: bool = option(False, "draw a sample of each environment, and play nothing", "--scenes"),
    draw: bool = option(False, "print the scene as a map, to edit and give to --map, and play nothing", "--draw"),
) -> None:
    """Replay a test episode in the terminal, or write it to files."""
    look.check(test.overwrite)
    exclude({"--scenes": scenes, "--draw": draw})
    unplayed = {"--svg": look.svg, "--cast": look.cast, "--frames": look.frames, "--at": look.at, "--versus": versus}
    unplayed[f"the policy {policy}"] = policy
    if (scenes or draw) and (needless := [flag for flag, value in unplayed.items() if value is not None]):
        raise ConfigError(f"{'--scenes' if scenes else '--draw'} plays nothing; leave out {needless[0]}")
    room, config = look.room(), override(Config(), settings)
    if draw:
        from sfmrl.maps import draw_map

        say_result(draw_map(test.scene(test.where(config), episode, config)).rstrip("\n"))
    elif scenes:
        _print_scenes(test, episode, config, room, look.plain())
    else:
        if versus is not None:
            _check_two(*room)
        names = [policy, versus] if versus is not None else [policy]
        _show(_replay(names, test, episode, settings, look.plain()), look, room)


def _print_scenes(test: TestOptions, episode: int, config: Config, room: tuple[int, int], ascii_only: bool) -> None:
    """Print a picture of a sample of one environment, or of each."""
    from sfmrl.replay.frames import scene_picture
    from sfmrl.scenes import ENVIRONMENTS

    for name in "12345" if test.place is None else [test.place]:
        scene = test.scene(name, episode, config)
        picture = scene_picture(scene, width=room[0], height=room[1], ascii_only=ascii_only)
        out.print(picture, soft_wrap=True)
        out.print(ENVIRONMENTS.get(name, ""), end="\n\n")


def _check_two(columns: int, lines: int) -> None:
    """Raise ConfigError if two policies do not fit into a frame."""
    from sfmrl.replay.frames import SIDE_BY_SIDE_COLUMNS, STACKED_LINES

    if columns < SIDE_BY_SIDE_COLUMNS and lines < STACKED_LINES:
        needed = f"{SIDE_BY_SIDE_COLUMNS} columns or {STACKED_LINES} lines"
        raise ConfigError(f"--versus needs {needed}, not {columns} and {lines}; enlarge the terminal or --size")


def _replay(
    names: list[str | None], test: TestOptions, episode: int, settings: dict[str, Any], ascii_only: bool
) -> Any:
    """Return the replay of an episode as every policy plays it; the first one's config decides reward and scene."""
    from sfmrl.episodes import play_episodes
    from sfmrl.maps import why_unsolvable
    from sfmrl.replay.frames import Replay
    from sfmrl.replay.story import make_story

    policies, named, config = test.choose_all(names, settings)
    scene = test.scene(test.where(config), episode, config)
    stories, failed = [], False
    for policy in policies:
        simulation = simulation_for(policy, config, settings)
        record = play_episodes(scene, policy, config.reward, simulation, discount=config.discount, keep=True)
        stories.append(make_story(record, policy, config.reward, config.discount))
        failed |= bool((record.outcome != "success").all())
    if failed and (reason := why_unsolvable(scene, config.simulation)):
        say(reason)
    labels = tuple(Path(name).name for name in named)
    differ = len(set(labels)) == len(labels)  # they do not if runs in two folders have the same name
    return Replay(tuple(stories), labels if differ else tuple(named), ascii_only=ascii_only)


def _show(replay: Any, look: Look, room: tuple[int, int]) -> None:
    """Write a replay to files, print stills of it, or play it in the terminal."""
    from sfmrl.replay.recordings import to_cast, to_svg
    from sfmrl.replay.screen import play_live

    if look.svg:
        shown = replay.frames(*room, look.frames or 1, look.at)
        _write(look.svg, to_svg(shown, replay.title, not out.no_color), len(shown), room)
    if look.cast:
        shown = replay.frames(*room)
        _write(look.cast, to_cast(shown, replay.title, look.speed, not out.no_color), len(shown), room)
    if look.svg or look.cast:
        return
    live = out.is_terminal and out.file.isatty()  # FORCE_COLOR makes Rich take a file for a terminal
    if look.stills() or not live or out.is_dumb_terminal:
        for picture in replay.frames(*room, look.frames or STILLS, look.at):
            out.print(picture.text if out.is_terminal else picture.plain, markup=False, highlight=False, soft_wrap=True)
        return

    def draw(t: int, columns: int, lines: int) -> Any:
        return replay.frame(t, *(room if look.size else (columns, lines))).text

    play_live(draw, replay.last, out, look.speed, replay.time_step)


def _write(path: Path, text: str, frames: int, room: tuple[int, int]) -> None:
    write_text(path, text)
    say(f"wrote {path}: {counted(frames, 'frame')} of {room[0]}x{room[1]}, {len(text.encode()) / 1000:.0f} kB")
