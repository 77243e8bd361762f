"""Validation success during training: mean over seeds and its 95 % interval, one panel per row."""

from typing import Any

import numpy as np
from rich.text import Text

from sfmrl.config import counted
from sfmrl.replay.canvas import Canvas, View, fitted
from sfmrl.study.statistics import mean_interval
from sfmrl.study.tables import Trained

LINE, BAND = "bold cyan", "grey50"
AXIS = 5  # columns before a panel's plot
APART = 2  # columns between panels


def curve_rows(rows: dict[str, Trained]) -> list[dict[str, Any]]:
    """A line per validation of each row: mean over seeds, its 95 % interval, each seed's success; None for no value."""
    seeds = sorted({seed for tested in rows.values() for seed in tested.seeds})
    lines = []
    for name, tested in rows.items():
        for episode, success in zip(tested.episodes, tested.validation.T, strict=True):
            low, high = mean_interval(success, 0.0, 1.0)
            by_seed = dict(zip(tested.seeds, success.tolist(), strict=True))
            by_seed = {f"seed {seed}": by_seed.get(seed) for seed in seeds}
            mean = {"mean": float(success.mean()), "low": low, "high": high}
            lines.append({"row": name, "episode": int(episode), **mean, **by_seed})
    return lines


def draw_curves(lines: list[dict[str, Any]], width: int = 80, height: int = 24) -> list[Text]:
    """Draw the lines of `curve_rows` as panels of one scale, as many side by side as `width` has room for."""
    names = list(dict.fromkeys(line["row"] for line in lines))
    across = max(1, min(len(names), width // 38))
    down = -(-len(names) // across)
    columns, rows = (width - APART * (across - 1)) // across, max(4, height // down)
    ends = ("low", "high")
    lines = [line | {end: line["mean"] for end in ends if line[end] is None} for line in lines]
    lowest = min(line["low"] for line in lines)
    floor = min(np.floor(10 * lowest) / 10, 0.9)
    last = max(line["episode"] for line in lines)
    by_name = {name: [line for line in lines if line["row"] == name] for name in names}
    panels = [_panel(name, course, columns, rows, floor, last) for name, course in by_name.items()]
    panels += [[Text(" " * columns)] * rows] * (across * down - len(panels))
    gap = Text(" " * APART)
    return [
        gap.join(panel[row] for panel in panels[first : first + across])
        for first in range(0, len(panels), across)
        for row in range(rows)
    ]


def _panel(name: str, lines: list[dict[str, Any]], columns: int, rows: int, floor: float, last: int) -> list[Text]:
    """A row's name with its first and last success, its curve, and the axis below: `rows` texts of `columns`."""
    plot = Canvas(View(0.0, 1.0 * (rows - 2), 1.0, rows - 2, columns - AXIS))
    at = np.linspace(0, last, 4 * (columns - AXIS))
    episodes = [line["episode"] for line in lines]
    mean, low, high = (np.interp(at, episodes, [line[key] for line in lines]) for key in ("mean", "low", "high"))
    across = at / last * (plot.view.columns - 0.5) / 2
    plot.dots(np.stack([across, _up(mean, floor, plot.view)], axis=1), LINE)
    band = zip(across, _up(low, floor, plot.view), _up(high, floor, plot.view), strict=True)
    for x, bottom, top in band:
        for y in np.arange(np.ceil(bottom - 0.5), top - 0.5 + 1e-9) + 0.5:  # cells whose middle is in the band
            row, column = plot.view.cells(np.array([x, y]))
            if plot.glyphs[row, column] == " ":
                plot.put(np.array([x, y]), "░", BAND)
    marks = ["1.0 ┤", *["    │"] * (rows - 4), f"{floor:.1f} ┤"] if rows > 3 else ["    │"]
    body = [Text.assemble(mark, line) for mark, line in zip(marks, plot.lines(), strict=True)]
    title = fitted(Text(f"     {name}"), columns, Text(f"{lines[0]['mean']:.3f} to {lines[-1]['mean']:.3f}"))
    return [title, *body, fitted(Text("     0"), columns, Text(counted(last, "episode")))]


def _up(success: np.ndarray, floor: float, view: View) -> np.ndarray:
    """Success as a height in the plot; 1 is the middle of its uppermost dots."""
    return np.clip((success - floor) / (1 - floor), 0, 1) * (view.rows - 0.25) + 0.125
