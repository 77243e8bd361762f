"""Recompute tutorials/results from the values of every seed in its CSV files: `python tests/make_tables.py`.

The trainings take hours and their run folders are not kept; the values of every seed are. Statistics follow from them.
"""

import csv
from pathlib import Path
from types import SimpleNamespace

import make_ablation
import make_crowds
import numpy as np
from make_ablation import ablation_markdown
from make_crowds import crowds_markdown

from sfmrl.runs.files import csv_text
from sfmrl.study.plots import save, validation_figure
from sfmrl.study.sheets import csv_rows, sheets
from sfmrl.study.statistics import contrasts, summarise
from sfmrl.study.tables import TABLES, Figures
from sfmrl.study.validations import table_validations

FOLDER = Path(__file__).parents[1] / "tutorials" / "results"


def read_csv(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


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


def table_texts(number: int, preset: str) -> dict[Path, str]:
    """A table's Markdown and CSV files."""
    path, episodes = FOLDER / f"table{number}-{preset}.csv", TABLES[number].test_episodes
    rows = read_figures(path, episodes)
    found, changes = summarise(TABLES[number], rows), contrasts(rows) if number == 1 else []
    pages = sheets(found, changes, f"Table {number}, {preset} preset, {episodes} test episodes")
    markdown = "\n".join(page.markdown() for page in pages)
    return {path: csv_text(csv_rows(found, changes)), path.with_suffix(".md"): markdown}


def figure_lines(preset: str) -> list[dict]:
    """The lines of figure 1's CSV file."""
    rows: dict[str, list[dict[str, str]]] = {}
    for line in read_csv(FOLDER / f"figure1-{preset}.csv"):
        rows.setdefault(line["row"], []).append(line)
    courses = {}
    for name, lines in rows.items():
        columns = [key for key in lines[0] if key.startswith("seed ")]
        courses[name] = SimpleNamespace(
            seeds=[int(key.removeprefix("seed ")) for key in columns],
            episodes=[int(line["episode"]) for line in lines],
            validation=np.array([[float(line[key]) for line in lines] for key in columns]),
        )
    return table_validations(courses)


def texts() -> dict[Path, str]:
    """All Markdown and CSV files of the folder."""
    made = table_texts(1, "quick") | table_texts(1, "paper") | table_texts(2, "quick")
    made |= {FOLDER / f"figure1-{p}.csv": csv_text(figure_lines(p)) for p in ("quick", "paper")}
    for path, markdown in ((make_ablation.CSV, ablation_markdown), (make_crowds.CSV, crowds_markdown)):
        if path.exists():
            lines = read_csv(path)
            made |= {path: csv_text(lines), path.with_suffix(".md"): markdown(lines)}
    return made


if __name__ == "__main__":
    for path, text in texts().items():
        path.write_text(text)
    for preset in ("quick", "paper"):
        save(validation_figure(figure_lines(preset), f"Table 1, {preset} preset"), FOLDER / f"figure1-{preset}.svg")
