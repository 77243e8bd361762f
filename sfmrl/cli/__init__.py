"""The command line: thin commands that parse, call and print. Results on standard output, all else on standard error.

Exit codes: 0 done, 1 failed, 2 wrong use, 130 interrupted (by Ctrl-C, SIGTERM or SIGHUP). NumPy and torch are imported
by the commands that need them.
"""

import io
import os
import sys

import typer

from sfmrl import __version__
from sfmrl.cli import lists, study, teach, test, train, watch  # noqa: F401 (they register their commands)
from sfmrl.cli.console import one_line, say, say_result
from sfmrl.cli.options import app
from sfmrl.config import ConfigError
from sfmrl.runs.files import DamagedFile
from sfmrl.runs.folders import as_words, finished, run_folders, why_unfinished
from sfmrl.runs.progress import Interrupted

INTERRUPTED = 130
LONGEST = 1000  # characters of an error's line: a given value may have thousands
ORDER = (  # in which `sfmrl --help` lists the commands
    *("il", "rl", "runs", "eval", "compare", "ascii-render"),
    *("plot", "explain", "models", "table", "figure", "verify", "doctor"),
)

app.registered_commands.sort(key=lambda command: ORDER.index(command.name))


@app.callback(invoke_without_command=True)
def start(
    context: typer.Context,
    version: bool = typer.Option(False, "--version", help="Show the version and exit."),
) -> None:
    """Teach a robot to cross a crowd: imitate ORCA, then reinforce, with and without social forces."""
    if version:
        say_result(f"sfmrl {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        say_result(greeting())


def greeting() -> str:
    """Return what to type next, with the newest finished run, or else a model, as the policy."""
    folders = run_folders()
    policy = next((as_words(folder) for folder in folders if finished(folder)), "sarl-sfm6")
    lines = [f"sfmrl {__version__} teaches a robot to cross a crowd."]
    if folders and not finished(folders[0]):
        lines.append(why_unfinished(folders[0]))
    commands = {
        "sfmrl il && sfmrl rl --reward sfm": "train a robot (one to three minutes)",
        f"sfmrl eval {policy}": "test it on 500 episodes",
        f"sfmrl ascii-render {policy}": "watch it",
        "sfmrl --help": "all commands",
    }
    width = max(map(len, commands))
    return "\n".join([*lines, *(f"  {command:{width}}  {words}" for command, words in commands.items())])


def main() -> None:
    """Run the `sfmrl` command; every expected failure is one line on standard error."""
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
        os.environ.setdefault(name, "1")  # before NumPy is imported, see `sfmrl.fast.blas`
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # letters that its encoding lacks; standard error escapes them
    try:
        # The name is given since completion would else be that of python, with python -m sfmrl.
        code = app(prog_name="sfmrl", standalone_mode=False)
        reason = "interrupted" if code == INTERRUPTED else ""
    except typer.TyperException as error:
        where = getattr(getattr(error, "ctx", None), "command_path", "sfmrl")
        code, reason = 2, f"{error.format_message().rstrip('.')}; see {where} --help"
    except (ConfigError, DamagedFile) as error:
        code, reason = 2, str(error)
    except Interrupted as error:
        code, reason = INTERRUPTED, f"interrupted; {error}"
    except (KeyboardInterrupt, typer.Abort):
        code, reason = INTERRUPTED, "interrupted"
    except MemoryError as error:
        said = "ask for fewer --episodes at a time, a shorter --time-limit, or a smaller --memory"
        code, reason = 1, f"out of memory; {said} ({error})"
    except OSError as error:
        code, reason = 1, f"{error.filename or ''}: {error.strerror or error}".strip(": ")
    if reason:
        line = one_line(reason)
        say(f"sfmrl: {line if len(line) <= LONGEST else line[:LONGEST] + ' ...'}")
    sys.exit(code or 0)
