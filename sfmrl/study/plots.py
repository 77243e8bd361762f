"""Figures for papers and slides, by matplotlib (the extra `plot`): validations, trajectories, films."""

import io
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from sfmrl.config import ConfigError
from sfmrl.episodes import Record
from sfmrl.runs.files import write_atomically
from sfmrl.scenes import Scenes

try:
    import matplotlib
    from matplotlib.animation import FFMpegWriter, FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Rectangle
except ImportError:
    raise ConfigError("figures need matplotlib; install it with: pip install matplotlib") from None

STILLS, FILMS = (".svg", ".png", ".pdf"), (".gif", ".mp4", ".html")
ROBOT, PERSON, SQUARE, GOAL = "tab:blue", "tab:orange", "0.6", "tab:red"


def validation_figure(lines: list[dict[str, Any]], title: str) -> Figure:
    """Success in validation over the training: a curve per row, a band for its 95 % interval (`study.validations`)."""
    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    axes, curves = figure.add_subplot(), {}
    for name in dict.fromkeys(line["row"] for line in lines):
        course = [line for line in lines if line["row"] == name]
        episodes, mean, low, high = ([line[key] for line in course] for key in ("episode", "mean", "low", "high"))
        shown = name.encode(errors="backslashreplace").decode()  # names of folders need not be UTF-8
        (curves[shown],) = axes.plot(episodes, mean, marker="o", markersize=3)
        if None not in low:
            axes.fill_between(episodes, low, high, color=curves[shown].get_color(), alpha=0.15, linewidth=0)
    axes.set(xlabel="training episodes", ylabel="success in validation", title=title)
    axes.set_ylim(top=1.005)
    axes.grid(alpha=0.3)
    legend = axes.legend(list(curves.values()), list(curves), loc="lower right")
    for text in legend.get_texts():
        text.set_parse_math(False)  # names of folders may have any signs
    return figure


def trajectory_figure(record: Record, episode: int = 0) -> Figure:
    """An episode, by its row: everybody's path with a disc each second, every fourth with its time, as in CrowdNav."""
    figure, axes, scenes, position = _stage(record, episode)
    dt, last = record.simulation.time_step, len(position) - 1
    second = max(1, round(1.0 / dt))  # in steps
    for row in _walkers(scenes):
        axes.plot(*position[:, row].T, color=_colour(row), linewidth=0.8)
        for step in sorted({*range(0, last + 1, second), last}):
            opacity = 0.2 + 0.6 * step / last
            axes.add_patch(Circle(position[step, row], scenes.radius[0, row], color=_colour(row), alpha=opacity))
            if step % (4 * second) == 0 or step == last:
                axes.annotate(f"{step * dt:g}", position[step, row], ha="center", va="center", fontsize=7)
    return figure


def scenes_figure(scenes: list[Scenes]) -> Figure:
    """Scenes, each a batch of one, side by side: everybody at the start, with a thin line to the goal."""
    figure = Figure(figsize=(3.4 * len(scenes), 3.8), layout="constrained")
    for one, axes in zip(scenes, figure.subplots(1, len(scenes), squeeze=False)[0], strict=True):
        _surroundings(axes, one, np.concatenate((one.start, one.goal), axis=1))
        for row in _walkers(one):
            axes.plot(*np.stack((one.start[0, row], one.goal[0, row]), axis=1), color=_colour(row), linewidth=0.6)
            axes.add_patch(Circle(one.start[0, row], one.radius[0, row], color=_colour(row)))
        axes.set_title(f"environment {one.environment[0]}", fontsize=10)
    return figure


def film(record: Record, episode: int = 0) -> FuncAnimation:
    """An episode, by its row, as an animation in real time."""
    figure, axes, scenes, position = _stage(record, episode)
    dt = record.simulation.time_step
    discs = {row: Circle((0, 0), scenes.radius[0, row], color=_colour(row)) for row in _walkers(scenes)}
    for disc in discs.values():
        axes.add_patch(disc)
    names = {row: axes.text(0, 0, str(row or "R"), ha="center", va="center", fontsize=8) for row in discs}
    clock = axes.text(0.02, 0.98, "", transform=axes.transAxes, va="top")

    def show(step: int) -> None:
        for row, disc in discs.items():
            disc.center = position[step, row]
            names[row].set_position(position[step, row])
        clock.set_text(f"{step * dt:.2f} s")

    return FuncAnimation(figure, show, frames=len(position), interval=1000 * dt)


def draw_episode(record: Record, path: Path) -> None:
    """Write a record's first episode to a file: a drawing (.svg, .png, .pdf) or a film (.gif, .mp4, .html)."""
    if path.suffix not in FILMS:
        save(trajectory_figure(record), path)
        return
    if path.suffix == ".mp4" and not FFMpegWriter.isAvailable():
        raise ConfigError("films as .mp4 need the program ffmpeg; install it, or choose .gif or .html")
    moving = film(record)
    if path.suffix == ".html":
        data = moving.to_jshtml().encode()
    else:
        with tempfile.TemporaryDirectory() as folder:
            try:
                moving.save(Path(folder) / path.name, writer="pillow" if path.suffix == ".gif" else "ffmpeg")
            except Exception as error:
                if isinstance(error.__context__, KeyboardInterrupt):  # a writer that has no frame yet fails to end
                    raise error.__context__ from None
                raise
            data = (Path(folder) / path.name).read_bytes()
    write_atomically(path, data, checked=False)


def save(figure: Figure, path: Path) -> None:
    """Write a figure to a file in the format of its ending; the same figure gives the same bytes."""
    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}, ".png": {}}
    data = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "sfmrl"}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # in the name of a folder
        figure.savefig(data, format=path.suffix[1:], dpi=150, metadata=undated[path.suffix])
    write_atomically(path, data.getvalue(), checked=False)


def _stage(record: Record, episode: int) -> tuple[Figure, Axes, Scenes, np.ndarray]:
    """A figure in metres with an episode's squares and goal, the scene as a batch of one, positions (T + 1, N, 2)."""
    one = record.take([episode])
    scenes, position = one.scenes, one.position[0, : one.steps[0] + 1]
    figure = Figure(figsize=(5.6, 5.6), layout="constrained")
    axes = figure.add_subplot()
    _surroundings(axes, scenes, position)
    end = f"{one.outcome[0]} after {one.time[0]:.2f} s"
    axes.set_title(f"environment {scenes.environment[0]}, episode {scenes.episode[0]}: {end}", fontsize=10)
    return figure, axes, scenes, position


def _surroundings(axes: Axes, scenes: Scenes, position: np.ndarray) -> None:
    """Draw the squares and the robot's goal of a scene, a batch of one, in metres; `position` (..., 2) must fit in."""
    for row in np.flatnonzero(scenes.square[0]):
        half = scenes.radius[0, row]
        axes.add_patch(Rectangle(scenes.start[0, row] - half, 2 * half, 2 * half, color=SQUARE))
    axes.plot(*scenes.goal[0, 0], marker="*", markersize=14, color=GOAL, zorder=3)
    drawn = np.concatenate((position.reshape(-1, 2), scenes.goal[0, :1]))
    low, high = np.nanmin(drawn, axis=0) - 1.0, np.nanmax(drawn, axis=0) + 1.0
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x, m", ylabel="y, m")


def _walkers(scenes: Scenes) -> list[int]:
    """Rows of the robot and the people of a scene, a batch of one."""
    return np.flatnonzero(~scenes.square[0] & ~np.isnan(scenes.start[0, :, 0])).tolist()


def _colour(row: int) -> str:
    return PERSON if row else ROBOT
