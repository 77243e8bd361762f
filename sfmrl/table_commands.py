"""The commands that make the paper's tables and its validation figure: `sfmrl table`, `sfmrl figure`."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from sfmrl.config import ConfigError
from sfmrl.console import err, new_file, out, print_sheet, say, say_result
from sfmrl.files import csv_text, write_text
from sfmrl.options import Overwrite, number_option, option
from sfmrl.study.tables import TABLES, make_jobs, parse_rows, parse_seeds
from sfmrl.variants import make_config

app = typer.Typer()

Number = Annotated[int, typer.Argument(help="1 (environments 1 and 2) or 2 (environments 2 to 5)", min=1, max=2)]
Seeds = Annotated[str, option("training seeds, 0-9 or 0,3,5-7 (default 0-9)")]
Rows = Annotated[str | None, option("rows, as sarl,sarl-sfm6 (default all of the paper's)")]
Preset = Annotated[str, option("schedule: quick or paper (default quick)")]
Folder = Annotated[Path, option("where the run folders are (default runs/tables)")]
TABLES_FOLDER = Path("runs/tables")


@app.command(epilog="Example: sfmrl table 1 --seeds 0-4 --jobs 2")
def table(
    number: Number,
    seeds: Seeds = "0-9",
    rows: Rows = None,
    preset: Preset = "quick",
    folder: Folder = TABLES_FOLDER,
    jobs: Annotated[int | None, number_option("trainings side by side (default one a core)", 1, 1024)] = None,
    on: Annotated[str, option("where to train: here, or ray (default here)")] = "here",
    print_jobs: Annotated[bool, option("print the trainings as commands, and run none", "--print-jobs")] = False,
    no_train: Annotated[bool, option("make the table from what is finished, train nothing", "--no-train")] = False,
    as_json: Annotated[bool, option("print JSON", "--json")] = False,
    csv: Annotated[Path | None, option("write a line a figure to this file")] = None,
    markdown: Annotated[Path | None, option("write the tables to this file, as Markdown")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Train and test the rows of one of the paper's tables, and show them beside the paper's figures.

    Give the same command again to go on after a stop; finished trainings are kept.
    """
    from sfmrl.study.sheets import csv_rows, sheets
    from sfmrl.study.statistics import contrasts, figures, summarise

    chosen, numbers = parse_rows(number, rows), parse_seeds(seeds)
    make_config(preset)  # which raises where there is none of that name
    if on not in ("here", "ray"):
        raise ConfigError(f"--on {on}: choose here or ray")
    for flag, path in (("csv", csv), ("markdown", markdown)):
        new_file(path, flag, overwrite)
    trainings = make_jobs(number, preset, numbers, chosen, folder)
    if print_jobs:
        for job in trainings:
            say_result(job.command)
        return
    if not no_train:
        _train(trainings, on, jobs)
    found = _read(folder, number, preset, chosen, numbers)
    missing = len(chosen) * len(numbers) - sum(len(tested.seeds) for tested in found.values())
    if missing:
        say(f"{missing} of {len(chosen) * len(numbers)} trainings are not finished, and left out")
    by_row = {row: figures(tested) for row, tested in found.items()}
    findings, changes = summarise(TABLES[number], by_row), contrasts(by_row) if number == 1 else []
    pages = sheets(findings, changes, f"Table {number}, {preset} preset, {TABLES[number].test_episodes} test episodes")
    if csv:
        write_text(csv, csv_text(csv_rows(findings, changes)))
    if markdown:
        write_text(markdown, "\n".join(page.markdown() for page in pages))
    if as_json:
        what = {"table": number, "preset": preset, "environment": TABLES[number].environment}
        say_result(json.dumps(what | {"rows": findings, "contrasts": changes}, indent=2))
        return
    for page in pages:
        print_sheet(page)


@app.command(epilog="Example: sfmrl figure 1 --svg validation.svg")
def figure(
    number: Number,
    seeds: Seeds = "0-9",
    rows: Rows = None,
    preset: Preset = "quick",
    folder: Folder = TABLES_FOLDER,
    csv: Annotated[Path | None, option("write a line a validation to this file")] = None,
    svg: Annotated[Path | None, option("write the figure to this file, as SVG")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Draw validation success over the trainings of a table: mean over seeds, and its 95 % interval shaded."""
    from rich.text import Text

    from sfmrl.replay import Frame, to_svg
    from sfmrl.study.curves import curve_rows, draw_curves

    make_config(preset)
    for flag, path in (("csv", csv), ("svg", svg)):
        new_file(path, flag, overwrite)
    lines = curve_rows(_read(folder, number, preset, parse_rows(number, rows), parse_seeds(seeds)))
    if csv:
        write_text(csv, csv_text(lines))
    if svg:
        picture = Frame(Text("\n").join(draw_curves(lines, 120, 48)), time=0.0)
        write_text(svg, to_svg([picture], f"Validation success, table {number}, {preset} preset"))
    for line in draw_curves(lines, max(out.width, 40), max(out.height - 2, 16)):
        out.print(line if out.is_terminal else line.plain, highlight=False)


def _train(trainings: list[Any], on: str, side_by_side: int | None) -> None:
    """Run what is not finished yet; raises Interrupted, or exits with 1 where some failed."""
    from sfmrl.lookahead import available_cores
    from sfmrl.progress import show_progress
    from sfmrl.stopping import Interrupted, StopSignal
    from sfmrl.study.cluster import put_right, run_on_ray
    from sfmrl.study.jobs import Failed, run_jobs

    with StopSignal(say) as stop:
        try:
            for job in trainings:
                put_right(job.folder)
            if on == "ray":
                run_on_ray(trainings, show_progress(err), stop, say)
            else:
                run_jobs(trainings, side_by_side or available_cores(), show_progress(err), stop, say)
        except (Interrupted, KeyboardInterrupt):
            raise Interrupted("go on with the same command") from None
        except Failed as error:
            say(f"sfmrl: {error}; the same command tries them again")
            raise typer.Exit(1) from None


def _read(folder: Path, number: int, preset: str, rows: list[str], seeds: list[int]) -> dict[str, Any]:
    """The finished runs of every row that has some; raises ConfigError where none has."""
    from sfmrl.study.results import read_row

    found = {row: read_row(folder, number, preset, row, seeds) for row in rows}
    found = {row: tested for row, tested in found.items() if tested}
    if not found:
        raise ConfigError(
            f"{folder} holds no finished run of table {number}, {preset} preset; "
            f"type sfmrl table {number} --preset {preset}, or name another --folder"
        )
    return found
