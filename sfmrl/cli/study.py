"""The commands that make the paper's tables and its validation figure: `sfmrl table`, `sfmrl figure`."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from sfmrl.cli.console import err, new_file, out, print_sheet, say, say_result
from sfmrl.cli.options import Overwrite, number_option, option
from sfmrl.config import ConfigError
from sfmrl.runs.files import csv_text, write_text
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
    episodes: Annotated[
        int | None, number_option("training episodes of each run (default the preset's)", 1, 10_000_000)
    ] = None,
    validation_interval: Annotated[
        int | None, number_option("episodes between validations (default quick 250, paper 1000)", 1, 10_000_000)
    ] = None,
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
    from sfmrl.study.tables import figures, make_jobs, parse_rows, parse_seeds

    chosen, numbers = parse_rows(number, rows), parse_seeds(seeds)
    make_config(preset)  # raises ConfigError on a preset that is not there
    if on not in ("here", "ray"):
        raise ConfigError(f"--on {on}: choose here or ray")
    new_file(csv, "csv", overwrite)
    new_file(markdown, "markdown", overwrite)
    trainings = make_jobs(number, preset, numbers, chosen, folder, episodes, validation_interval)
    if print_jobs:
        say_result("\n".join(job.command for job in trainings))
        return
    if not no_train:
        _train(trainings, on, jobs)
    runs = _read(folder, number, preset, chosen, numbers)
    wanted, finished = len(chosen) * len(numbers), sum(len(trained.seeds) for trained in runs.values())
    if finished < wanted:
        say(f"{wanted - finished} of {wanted} trainings are not finished, and left out")
    _report(number, preset, {row: figures(trained) for row, trained in runs.items()}, as_json, csv, markdown)


def _report(
    number: int, preset: str, rows: dict[str, Any], as_json: bool, csv: Path | None, markdown: Path | None
) -> None:
    """Print the statistics of a table's rows, and write them to files."""
    from sfmrl.study.sheets import csv_rows, sheets
    from sfmrl.study.statistics import contrasts, summarise
    from sfmrl.study.tables import TABLES

    table = TABLES[number]
    summary, effects = summarise(table, rows), contrasts(rows) if number == 1 else []
    pages = sheets(summary, effects, f"Table {number}, {preset} preset, {table.test_episodes} test episodes")
    if csv:
        write_text(csv, csv_text(csv_rows(summary, effects)))
    if markdown:
        write_text(markdown, "\n".join(page.markdown() for page in pages))
    if as_json:
        what = {"table": number, "preset": preset, "environment": table.environment}
        say_result(json.dumps(what | {"rows": summary, "contrasts": effects}, indent=2))
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
    from sfmrl.study.tables import parse_rows, parse_seeds

    make_config(preset)
    new_file(csv, "csv", overwrite)
    new_file(svg, "svg", overwrite)
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
    from sfmrl.runs.progress import Interrupted, StopSignal, show_progress
    from sfmrl.study.jobs import Failed, Processes, RayWorkers, run_jobs

    with StopSignal(say) as stop:
        try:
            workers = RayWorkers() if on == "ray" else Processes(side_by_side or available_cores())
            run_jobs(trainings, workers, show_progress(err), stop, say)
        except (Interrupted, KeyboardInterrupt):
            raise Interrupted("go on with the same command") from None
        except Failed as error:
            say(f"sfmrl: {error}; the same command tries them again")
            raise typer.Exit(1) from None


def _read(folder: Path, number: int, preset: str, rows: list[str], seeds: list[int]) -> dict[str, Any]:
    """The finished runs of every row that has some; raises ConfigError where none has."""
    from sfmrl.study.tables import read_row

    runs = {row: read_row(folder, number, preset, row, seeds) for row in rows}
    if not any(runs.values()):
        raise ConfigError(
            f"{folder} holds no finished run of table {number}, {preset} preset; "
            f"type sfmrl table {number} --preset {preset}, or name another --folder"
        )
    return {row: trained for row, trained in runs.items() if trained}
