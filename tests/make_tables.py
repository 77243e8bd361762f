"""Compute tutorials/results from the values of every seed in its CSV files: `python tests/make_tables.py [FOLDER]`.

The trainings take hours and their run folders are not kept; the values of every seed are, and statistics follow from
them. The finished runs under FOLDER, as `make_all.py` trains them, are added, so that a table can grow over several
sittings: delete its CSV files after a change of the recipe.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import make_ablation
import make_crowds
import numpy as np
from make_ablation import ablation_markdown, read_csv
from make_crowds import crowds_markdown

from sfmrl.runs.files import csv_text
from sfmrl.study.plots import save, validation_figure
from sfmrl.study.sheets import csv_rows, sheets
from sfmrl.study.statistics import contrasts, summarise
from sfmrl.study.tables import TABLES, Figures, Trained, figures, read_row
from sfmrl.study.validations import table_validations

RESULTS = Path(__file__).parents[1] / "tutorials" / "results"
SEEDS = list(range(10))
# The files' names: the table's number, preset, title, place under FOLDER and schedule.
KINDS: dict[str, tuple[int, str, str, str, dict[str, int]]] = {
    "1-quick": (1, "quick", "quick preset", ".", {}),
    "1-paper": (1, "paper", "paper preset", "paper", {}),
    "1-early": (1, "paper", "paper preset, its first 3,000 episodes", "early", {"episodes": 3000, "interval": 500}),
    "2-quick": (2, "quick", "quick preset", ".", {}),
}


def read_figures(path: Path, test_episodes: int) -> dict[str, Figures]:
    """The rows of a table's CSV file, from the values of every seed."""
    rows: dict[str, dict[str, dict[int, float]]] = {}
    for line in read_csv(path):
        if line["seed"] != "all" and line["metric"] != "success_wilson":
            by_seed = rows.setdefault(line["row"], {}).setdefault(line["metric"], {})
            by_seed[int(line["seed"])] = float(line["value"] or "nan")
    return {
        name: Figures(list(row["success"]), test_episodes, {m: np.array(list(v.values())) for m, v in row.items()})
        for name, row in rows.items()
    }


def read_courses(path: Path) -> dict[str, Any]:
    """The validations of a figure's CSV file, by row, as the `Trained` that they are of."""
    rows: dict[str, list[dict[str, str]]] = {}
    for line in read_csv(path):
        rows.setdefault(line["row"], []).append(line)
    courses = {}
    for name, lines in rows.items():
        columns = [key for key in lines[0] if key.startswith("seed ") and lines[0][key]]
        courses[name] = SimpleNamespace(
            seeds=[int(key.removeprefix("seed ")) for key in columns],
            episodes=[int(line["episode"]) for line in lines],
            validation=np.array([[float(line[key]) for line in lines] for key in columns]),
        )
    return courses


def with_new(old: dict[str, Any], new: dict[str, Any], join: Callable, table: int) -> dict[str, Any]:
    """The rows of both, in the table's order; of a row in both, what `join` makes of the two."""
    rows = old | {name: join(old[name], row) if name in old else row for name, row in new.items()}
    return {name: rows[name] for name in TABLES[table].paper if name in rows}


def join_figures(old: Figures, new: Figures) -> Figures:
    """The figures of both runs' seeds in order, the new ones where both have a seed."""
    seeds = sorted({*old.seeds, *new.seeds})
    from_new = [seed in new.seeds for seed in seeds]
    picked = {
        metric: np.array(
            [(new if fresh else old).of(metric, [seed])[0] for seed, fresh in zip(seeds, from_new, strict=True)]
        )
        for metric in new.values
    }
    return Figures(seeds, new.test_episodes, picked)


def join_courses(old: Any, new: Trained) -> Any:
    """The validations of both runs' seeds in order, the new ones where both have a seed."""
    of = dict(zip(old.seeds, old.validation, strict=True)) | dict(zip(new.seeds, new.validation, strict=True))
    return SimpleNamespace(seeds=sorted(of), episodes=new.episodes, validation=np.array([of[s] for s in sorted(of)]))


def texts(folder: Path | None = None) -> dict[Path, str]:
    """All Markdown and CSV files of the results, with what has been trained under `folder`."""
    made = {}
    for kind, (number, preset, title, place, schedule) in KINDS.items():
        path, course = RESULTS / f"table{kind}.csv", RESULTS / f"figure{kind}.csv"
        episodes = TABLES[number].test_episodes
        found = {}
        if folder:
            read = {
                row: read_row(folder / place, number, preset, row, SEEDS, **schedule) for row in TABLES[number].paper
            }
            found = {row: runs for row, runs in read.items() if runs}
        new = {row: figures(runs) for row, runs in found.items()}
        if rows := with_new(read_figures(path, episodes), new, join_figures, number):
            summary, changes = summarise(TABLES[number], rows), contrasts(rows) if number == 1 else []
            pages = sheets(summary, changes, f"Table {number}, {title}, {episodes} test episodes")
            made[path] = csv_text(csv_rows(summary, changes))
            made[path.with_suffix(".md")] = "\n".join(page.markdown() for page in pages)
        if number == 1 and (courses := with_new(read_courses(course), found, join_courses, number)):
            made[course] = csv_text(table_validations(courses))
    for path, markdown in ((make_ablation.CSV, ablation_markdown), (make_crowds.CSV, crowds_markdown)):
        if lines := read_csv(path):
            made |= {path: csv_text(lines), path.with_suffix(".md"): markdown(lines)}
    return made


if __name__ == "__main__":
    for path, text in texts(Path(sys.argv[1]) if len(sys.argv) > 1 else None).items():
        path.write_text(text)
    for path in RESULTS.glob("figure*.csv"):
        number, _, title, *_ = KINDS[path.stem.removeprefix("figure")]
        lines = table_validations(read_courses(path))
        save(validation_figure(lines, f"Table {number}, {title}"), path.with_suffix(".svg"))
