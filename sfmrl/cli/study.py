"""The commands that make tables and figures: `sfmrl table`, `sfmrl figure`, `sfmrl plot`."""

import os
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, cast

import typer

from sfmrl.cli import completion, options
from sfmrl.cli.console import check_new_files, err, print_sheet, saving, say, say_json, say_result
from sfmrl.cli.options import command, number_option, option
from sfmrl.cli.session import TestOptions, exclude
from sfmrl.config import Config, ConfigError, counted, override
from sfmrl.runs.files import csv_text, write_text
from sfmrl.variants import make_config


@dataclass(frozen=True)
class Selection:
    """The options that select trainings of a table."""

    seeds: str = option("0-9", "training seeds, e.g. 0-4 or 0,3,5-7 (default 0-9)")
    rows: str | None = option(None, "rows, e.g. sarl,sarl-sfm6 (default all of the paper's)")
    preset: str = option("quick", "settings: quick or paper (default quick)")
    folder: Path = option(Path("runs/tables"), "where the run folders are (default runs/tables)")
    episodes: int | None = number_option(None, "training episodes of each run (default the preset's)", 1, 10_000_000)
    validation_interval: int | None = number_option(
        None, "episodes between validations (default quick 250, paper 1000)", 1, 10_000_000
    )
    overwrite: bool = options.OVERWRITE

    def given(self) -> list[str]:
        """Return the flags that select trainings and are not at their defaults."""
        values = {field: getattr(self, field.name) for field in fields(self) if field.name != "overwrite"}
        changed = [field for field, value in values.items() if value != cast(Any, field.default).default]
        return [f"--{field.name.replace('_', '-')}" for field in changed]

    def rows_and_seeds(self, number: int) -> tuple[list[str], list[int]]:
        """Return the names of the rows and the seeds; raises ConfigError on unknown rows, seeds or presets."""
        from sfmrl.study.tables import parse_rows, parse_seeds

        make_config(self.preset)
        return parse_rows(number, self.rows), parse_seeds(self.seeds)

    def of_each_row(self, read: Callable[..., Any], number: int) -> dict[str, Any]:
        """Call `tables.read_row` or `tables.finished_runs` for each row."""
        rows, seeds = self.rows_and_seeds(number)
        schedule = {"episodes": self.episodes, "interval": self.validation_interval}
        return {row: read(self.folder, number, self.preset, row, seeds, **schedule) for row in rows}

    def finished(self, number: int) -> dict[str, Any]:
        """Read the finished runs of each row that has some; raises ConfigError if there are none at all."""
        from sfmrl.study.tables import read_row

        runs = self.of_each_row(read_row, number)
        if not any(runs.values()):
            raise ConfigError(
                f"{self.folder} holds no finished run of table {number}, {self.preset} preset, with these options; "
                f"train them with sfmrl table {number} and the same options, or name another --folder"
            )
        wanted = len(runs) * len(self.rows_and_seeds(number)[1])
        if missing := wanted - sum(len(trained.seeds) for trained in runs.values() if trained):
            say(f"{missing} of {wanted} trainings are not finished and are left out")
        return {row: trained for row, trained in runs.items() if trained}


@command("sfmrl table 1 --seeds 0-4 --jobs 2")
def table(
    number: int = typer.Argument(..., help="1 (environments 1 and 2) or 2 (environments 2 to 5)", min=1, max=2),
    *,
    selection: Selection,
    jobs: int | None = number_option(None, "trainings side by side (default one per core)", 1, 1024),
    on: str = option("here", "where to train: here, or ray (default here)"),
    print_jobs: bool = option(False, "print the trainings as commands, and run none", "--print-jobs"),
    no_train: bool = option(False, "make the table from finished trainings, train nothing", "--no-train"),
    as_json: bool = options.JSON,
    csv: Path | None = option(None, "write every number of every seed to this file, one per line"),
    markdown: Path | None = option(None, "write the tables to this file, as Markdown"),
) -> None:
    """Train and test the rows of one of the paper's tables, and show them beside the paper's numbers.

    To continue after a stop, type the same command again; finished trainings are kept.
    """
    from sfmrl.study.tables import finished_runs, make_jobs

    rows, seeds = selection.rows_and_seeds(number)
    if on not in ("here", "ray"):
        raise ConfigError(f"--on {on}: choose here or ray")
    for flag, value in {"--no-train": no_train, "--json": as_json, "--csv": csv, "--markdown": markdown}.items():
        exclude({"--print-jobs": print_jobs, flag: value})
    check_new_files(selection.overwrite, csv=csv, markdown=markdown)
    which = (number, selection.preset, seeds, rows, selection.folder)
    trainings = make_jobs(*which, selection.episodes, selection.validation_interval)
    if print_jobs:
        say_result("\n".join(job.command for job in trainings))
        return
    if not no_train:
        selection.of_each_row(finished_runs, number)  # raises ConfigError now, not after hours
        _train(trainings, on, jobs)
    _report(number, selection.preset, selection.finished(number), as_json, csv, markdown)


def _train(trainings: list[Any], on: str, side_by_side: int | None) -> None:
    """Run the unfinished trainings; raises Interrupted, or exits with 1 if some failed."""
    from sfmrl.policies import available_cores
    from sfmrl.runs.progress import Interrupted, StopSignal, show_progress
    from sfmrl.study.jobs import Failed, Processes, RayWorkers, run_jobs

    with StopSignal(say) as stop:
        try:
            workers = RayWorkers() if on == "ray" else Processes(side_by_side or available_cores())
            run_jobs(trainings, workers, show_progress(err), stop, say)
        except (Interrupted, KeyboardInterrupt):
            raise Interrupted("to continue, type the same command again") from None
        except Failed as error:
            say(f"sfmrl: {error}; to try them again, type the same command")
            raise typer.Exit(1) from None


def _report(
    number: int, preset: str, runs: dict[str, Any], as_json: bool, csv: Path | None, markdown: Path | None
) -> None:
    """Print the statistics of a table's rows, and write them to files."""
    from sfmrl.study.sheets import csv_rows, sheets
    from sfmrl.study.statistics import contrasts, summarise
    from sfmrl.study.tables import TABLES, figures

    paper = TABLES[number]
    rows = {row: figures(trained) for row, trained in runs.items()}
    summary, effects = summarise(paper, rows), contrasts(rows) if number == 1 else []
    tested = next(iter(rows.values())).test_episodes
    pages = sheets(summary, effects, f"Table {number}, {preset} preset, {counted(tested, 'test episode')}")
    as_markdown = "\n".join(page.markdown() for page in pages)
    with saving(as_markdown, markdown), saving(csv_text(csv_rows(summary, effects)), csv):
        if as_json:
            what = {"table": number, "preset": preset, "environment": paper.environment}
            say_json(what | {"rows": summary, "contrasts": effects})
            return
        for page in pages:
            print_sheet(page)


@command("sfmrl figure 1 --out validation.svg")
def figure(
    targets: list[str] = typer.Argument(..., help="1 or 2 for a table, or run folders", autocompletion=completion.runs),
    *,
    out: Path | None = option(None, "write the figure to this file, .svg, .png or .pdf"),
    csv: Path | None = option(None, "write one line per validation to this file"),
    selection: Selection,
) -> None:
    """Plot validation success during training: means over a table's seeds with 95 % intervals, or single runs.

    Needs matplotlib: pip install matplotlib.
    """
    from sfmrl.study.validations import run_validations, table_validations

    _check_picture(out)
    check_new_files(selection.overwrite, out=out, csv=csv)
    tables = [target for target in targets if target in ("1", "2")]
    if tables and len(targets) > 1:
        raise ConfigError(f"figure draws one table, or runs; it got {', '.join(targets)}")
    if len({os.path.realpath(target) for target in targets}) < len(targets):
        raise ConfigError(f"figure takes each run once; it got {', '.join(targets)}")
    if not tables and (given := selection.given()):
        raise ConfigError(f"{given[0]} selects trainings of a table; leave it out to draw runs")
    lines = table_validations(selection.finished(int(tables[0]))) if tables else run_validations(targets)
    if not (out or csv):
        raise ConfigError("figure writes files; name one, such as --out validation.svg or --csv validation.csv")
    title = f"Table {tables[0]}, {selection.preset} preset" if tables else ""
    if out:
        from sfmrl.study.plots import save, validation_figure

        save(validation_figure(lines, title), out)
        say(f"wrote {out}")
    if csv:
        write_text(csv, csv_text(lines))
        say(f"wrote {csv}")


@command("sfmrl plot sarl --environment 2 --episode 3 --out episode.png", "simulation", "reward", "planner", plays=True)
def plot(
    policy: str | None = options.POLICY,
    *,
    out: Path = option(
        Path("episode.svg"), "file to write: .svg, .png, .pdf, or for a film .gif, .mp4, .html (default episode.svg)"
    ),
    episode: int = options.EPISODE,
    test: TestOptions,
    settings: dict[str, Any],
    scenes: bool = option(False, "draw a sample of each environment, and play nothing", "--scenes"),
) -> None:
    """Draw a test episode in metres, each path with a disc every second, or make a film of it.

    Needs matplotlib: pip install matplotlib.
    """
    from sfmrl.episodes import play_episodes

    if scenes and policy:
        raise ConfigError(f"--scenes plays nothing; leave out the policy {policy}")
    _check_picture(out, films=not scenes)
    check_new_files(test.overwrite, out=out)
    from sfmrl.study.plots import draw_episode, save, scenes_figure

    if scenes:
        names, config = "12345" if test.place is None else [test.place], override(Config(), settings)
        save(scenes_figure([test.scene(name, episode, config) for name in names]), out)
    else:
        chosen, _, config = test.choose(policy, settings)
        scene = test.scene(test.where(config), episode, config)
        draw_episode(play_episodes(scene, chosen, config.reward, config.simulation, discount=config.discount), out)
    say(f"wrote {out}")


def _check_picture(path: Path | None, films: bool = False) -> None:
    """Raise ConfigError if matplotlib is missing, or if the file's name is not a picture's."""
    if path is None:
        return
    from sfmrl.study.plots import FILMS, STILLS

    known = (*STILLS, *(FILMS if films else ()))
    if path.suffix not in known:
        raise ConfigError(f"--out is {path}; its name must end in {', '.join(known)}")
