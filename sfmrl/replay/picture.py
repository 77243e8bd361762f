"""Episodes and scenes as SVG and HTML, for notebooks and web pages; an episode moves by itself, in real time."""

from collections import Counter
from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from sfmrl.episodes import Record
from sfmrl.evaluation import RATES, metrics
from sfmrl.scenes import Scenes

SCALE = 36  # pixels per metre
MARGIN = 0.6  # m around what is drawn
HOLD = 1.0  # s for which an episode rests at its end before it starts again
ROBOT, PERSON, SQUARE, GOAL = "#2a6fdb", "#f2b177", "#8c8c8c", "#d62728"


def episode_svg(record: Record, episode: int = 0) -> str:
    """An animated SVG of one episode, given by its row in the record."""
    one = record.take([episode])
    steps, seconds = int(one.steps[0]), float(one.time[0])
    title = f"environment {one.scenes.environment[0]}: {one.outcome[0]} after {seconds:.2f} s"
    return _drawing(one.scenes, one.position[0, : steps + 1], seconds, title)


def scene_svg(scenes: Scenes, episode: int = 0) -> str:
    """An SVG of one scene, given by its row, with a line from everybody's start to the goal."""
    one = scenes.take([episode])
    return _drawing(one, one.start, 0.0, f"environment {one.environment[0]}")


def record_html(record: Record) -> str:
    """What a notebook shows of a record: its metrics, and its first episode if it has one."""
    return metrics_html(metrics(record)) + (episode_svg(record) if len(record.steps) else "")


def scenes_html(scenes: Scenes) -> str:
    """What a notebook shows of scenes: how many there are of each environment, and the first if there is one."""
    table = _table([["environment", "scenes"], *Counter(map(str, scenes.environment)).items()])
    return table + (scene_svg(scenes) if len(scenes) else "")


def metrics_html(found: Mapping[str, Any]) -> str:
    """Metrics as a table, a row for all episodes and one for each environment."""
    parts = {"all": found, **{f"env. {name}": part for name, part in found.get("environments", {}).items()}}
    names = ("episodes", *RATES, "navigation_time", "total_reward")
    rows = [[label, *(_plain(part[name]) for name in names)] for label, part in parts.items()]
    return _table([["", *(name.replace("_", " ") for name in names)], *rows])


def _plain(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)


def _table(rows: list[Any]) -> str:
    head, *body = ["".join(f"<td>{escape(str(cell))}</td>" for cell in row) for row in rows]
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(f'<tr>{row}</tr>' for row in body)}</tbody></table>"


def _drawing(scenes: Scenes, position: np.ndarray, seconds: float, title: str) -> str:
    """One scene (a batch of one) with everybody at `position` (T, N, 2); with several times, as a film of `seconds`."""
    start, goal, radius = scenes.start[0], scenes.goal[0], scenes.radius[0]
    drawn = np.concatenate((position.reshape(-1, 2), goal[:1], start - radius[:, None], start + radius[:, None]))
    low, high = np.nanmin(drawn, axis=0) - MARGIN, np.nanmax(drawn, axis=0) + MARGIN
    width, height = (high - low) * SCALE

    def place(points: np.ndarray) -> np.ndarray:
        """Pixels from metres, (..., 2); y points down."""
        return np.round((points - low) * (SCALE, -SCALE) + (0, height), 1)

    parts = [f'<rect width="100%" height="100%" fill="white"/><title>{escape(title)}</title>']
    for row in np.flatnonzero(~np.isnan(start[:, 0])):
        size = radius[row] * SCALE
        x, y = place(start[row])
        if scenes.square[0, row]:
            side = f'width="{2 * size:g}" height="{2 * size:g}"'
            parts.append(f'<rect x="{x - size:g}" y="{y - size:g}" {side} fill="{SQUARE}"/>')
        else:
            parts.append(_walker(row, size, place(position[:, row]), place(goal[row]), seconds))
    x, y = place(goal[0])
    parts.append(f'<text x="{x:g}" y="{y:g}" font-size="20" fill="{GOAL}">★</text>')
    style = "font-family:sans-serif;text-anchor:middle;dominant-baseline:central"
    box = f'viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" height="{height:.0f}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {box} style="{style}">{"".join(parts)}</svg>'


def _walker(row: int | np.integer, size: float, path: np.ndarray, goal: np.ndarray, seconds: float) -> str:
    """The robot (row 0) or a person: its path (T, 2) as a line, and a disc, which moves if it has several points."""
    way = " ".join(f"{x:g},{y:g}" for x, y in (path if len(path) > 1 else [path[0], goal]))
    colour = PERSON if row else ROBOT
    film = ""
    if len(path) > 1:
        last = seconds / (seconds + HOLD)
        times = ";".join(f"{t:.3f}" for t in [*np.linspace(0.0, last, len(path)), 1.0])
        places = ";".join(f"{x:g},{y:g}" for x, y in [*path, path[-1]])
        film = (
            f'<animateTransform attributeName="transform" type="translate" dur="{seconds + HOLD:g}s" '
            f'repeatCount="indefinite" keyTimes="{times}" values="{places}"/>'
        )
    return (
        f'<polyline points="{way}" fill="none" stroke="{colour}" stroke-opacity="0.4"/>'
        f'<g transform="translate({path[0, 0]:g},{path[0, 1]:g})"><circle r="{size:g}" fill="{colour}"/>'
        f'<text font-size="11" fill="{"black" if row else "white"}">{row or "R"}</text>{film}</g>'
    )
