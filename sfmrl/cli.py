"""The command line: thin commands that parse, call and print. Results on standard output, all else on standard error.

Exit codes: 0 done, 1 failed, 2 wrong use, 130 interrupted. NumPy and torch are imported by the commands that need them.
"""

import sys

import typer

from sfmrl import evaluation_commands, replay_commands, table_commands, teaching_commands, training_commands
from sfmrl.config import ConfigError
from sfmrl.console import say
from sfmrl.files import DamagedFile

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Teach a robot to cross a crowd: imitate ORCA, then reinforce, with and without social forces.",
)
for commands in (training_commands, evaluation_commands, replay_commands, table_commands, teaching_commands):
    app.add_typer(commands.app)


def main() -> None:
    """The `sfmrl` command: every expected failure is one line on standard error."""
    try:
        code = app(standalone_mode=False)
    except typer.TyperException as error:
        where = getattr(getattr(error, "ctx", None), "command_path", "sfmrl")
        code, reason = 2, f"{error.format_message().rstrip('.')}; see {where} --help"
    except (ConfigError, DamagedFile) as error:
        code, reason = 2, str(error)
    except (KeyboardInterrupt, typer.Abort):
        code, reason = 130, "interrupted"
    except OSError as error:
        code, reason = 1, f"{error.filename or ''}: {error.strerror or error}".strip(": ")
    else:
        reason = ""
    if reason:
        say(f"sfmrl: {reason}")
    sys.exit(code or 0)
