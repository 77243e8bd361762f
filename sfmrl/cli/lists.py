"""The commands that list what there is to play: `sfmrl models`, `sfmrl runs`."""

from pathlib import Path

import typer
from rich.table import Table
from rich.text import Text

from sfmrl.cli import options
from sfmrl.cli.console import one_line, print_sheet, print_table, say, say_json, say_result
from sfmrl.cli.options import command
from sfmrl.config import ConfigError, json_object, suggest
from sfmrl.runs.files import DamagedFile, read_checked, read_listed
from sfmrl.runs.folders import RUNS, facts_of, finished, in_training, newest_first


@command("sfmrl models sarl-sfm6")
def models(
    name: str | None = typer.Argument(None, help="print the card of this model (default list all)"),
    *,
    as_json: bool = options.JSON,
) -> None:
    """List the trained networks that come with sfmrl: the rows of the paper's tables, and a unicycle's."""
    from sfmrl.runs.weights import model_card, model_names
    from sfmrl.study.sheets import Sheet, card_lines, model_sheet

    names = model_names()
    if name is not None and name not in names:
        raise ConfigError(f"there is no model {name}; choose {', '.join(names)}{suggest(name, names)}")
    cards = {each: model_card(each) for each in names}
    if as_json:
        say_json(cards[name] if name else cards)
        return
    try:
        shown = card_lines(cards[name]) if name else model_sheet(cards)
    except (LookupError, TypeError, ValueError, AttributeError):
        raise DamagedFile("a model's card is not what sfmrl came with; install sfmrl again") from None
    if isinstance(shown, Sheet):
        print_sheet(shown)
    else:
        say_result("\n".join(shown))


@command("sfmrl runs runs/tables")
def runs(folder: Path = typer.Argument(RUNS, help="folder of run folders (default runs)", show_default=False)) -> None:
    """List the runs in a folder, the newest first, with the success of their final test.

    Success is measured with recovery if the run uses it, as in sfmrl eval. A run is running while a process trains it,
    done when it has finished, otherwise stopped: resume it with sfmrl il --resume or sfmrl rl --resume. It is damaged
    if its run.json, config.json or result.json has changed since it was written.
    """
    if folder != RUNS and not folder.is_dir():
        raise ConfigError(f"there is no folder {folder}; name one that holds run folders")
    if not (found := newest_first(folder)):
        say(f"there is no run in {folder}; sfmrl il makes one")
        return
    table = Table("folder", "kind", "variant", "seed", "state", "success", box=None, pad_edge=False)
    for column in table.columns:
        column.overflow = "fold"  # a long name goes on in the next line
    for run in found:
        table.add_row(*(Text(one_line(cell)) for cell in (run, *_run_cells(run))))
    print_table(table)


def _run_cells(folder: Path) -> list[str]:
    """Return kind, variant, seed, state and success of the run in a folder, "-" for what is not known."""
    facts, success = facts_of(folder), "-"
    try:
        facts, config = (json_object(read_checked(folder / name)) for name in ("run.json", "config.json"))
        if (folder / "result.json").exists():
            result = json_object(read_listed(folder / "result.json"))
            success = f"{result.get('with_recovery', result)['success']:.3f}"
        known = (facts["kind"], facts["variant"], config["seed"])
    except (OSError, LookupError, TypeError, ValueError, AttributeError, DamagedFile):
        return [str(facts.get("kind", "-")), str(facts.get("variant", "-")), "-", "damaged", "-"]
    done = finished(folder) or (folder / "weights.pt").exists()  # the latter before version 0.3
    return [*map(str, known), "running" if in_training(folder) else "done" if done else "stopped", success]
