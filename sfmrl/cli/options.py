"""How commands declare their options, and which of them `--help` shows.

Each parameter of a command is an option. A parameter whose type is a dataclass stands for one option per field, so that
commands can share options. The parameter `settings` stands for the knobs of some sections of the config; their defaults
and help texts are in `config.py`. Options without a section are those that most people use.
"""

import inspect
import re
from collections.abc import Callable
from copy import copy
from dataclasses import Field, fields, is_dataclass
from functools import wraps
from typing import Any, cast

import typer
from typer.core import TyperCommand

from sfmrl import config
from sfmrl.cli import completion
from sfmrl.config import Config, checked, in_range
from sfmrl.variants import PRESETS, make_config

KEYWORD = inspect.Parameter.KEYWORD_ONLY
# The knobs that `--help` shows, in this order. The others appear under the heading of their section of the config.
COMMON = ("preset", "reward", "forces", "environment", "episodes", "seed", "recover")
TITLES = {
    "": "Task",
    "simulation": "Simulation",
    "reward": "Reward",
    "planner": "Recovery",
    "imitation": "Schedule",
    "reinforcement": "Schedule",
}
DEFAULTS = {preset: make_config(preset) for preset in PRESETS}

app = typer.Typer(pretty_exceptions_enable=False, context_settings={"help_option_names": ["-h", "--help"]})


class Command(TyperCommand):
    """A command whose `--help` shows the options without a section, and whose `--help-all` shows all of them."""

    def format_help(self, context: Any, formatter: Any, everything: bool = False) -> None:
        """Print the help."""
        shown: Any = copy(self)
        everything = everything or all(each.name != "help_all" for each in self.params)
        shown.params = [
            _as_shown(each) for each in cast(list[Any], self.params) if everything or not each.rich_help_panel
        ]
        if len(shown.params) < len(self.params):
            shown.epilog += f"\n\n{context.command_path} --help-all shows all {len(self.params)} options, by section."
        TyperCommand.format_help(shown, context, formatter)


def _as_shown(parameter: Any) -> Any:
    """A parameter as the help shows it: a flag without a type, and --x/--no-x as --[no-]x."""
    shown = copy(parameter)
    if getattr(parameter, "is_flag", False):
        shown.metavar = ""
    if parameter.secondary_opts:
        shown.opts, shown.secondary_opts = [parameter.opts[0].replace("--", "--[no-]")], []
    return shown


def option(default: Any, help: str, *flags: str, **extra: Any) -> Any:
    """A Typer option whose help text describes its default."""
    return typer.Option(default, *flags, help=help, show_default=False, **extra)


def number_option(default: float | None, help: str, low: float, high: float) -> Any:
    """A Typer option that takes a number from `low` to `high`."""

    def checked_value(parameter: typer.CallbackParam, value: float | None) -> float | None:
        return value if value is None else in_range(parameter.opts[0], value, low, high, whole=isinstance(value, int))

    return option(default, help, callback=checked_value)


def _show_all(context: typer.Context, asked: bool) -> None:
    if asked:
        cast(Command, context.command).format_help(context, context.make_formatter(), everything=True)
        raise typer.Exit


HELP_ALL = option(False, "Show all options, by section, and exit.", "--help-all", is_eager=True, callback=_show_all)
POLICY = typer.Argument(
    None,
    help="linear, orca, sfm, a model, a run folder, a weights file, file.py:function (default the newest run)",
    autocompletion=completion.policies,
)
MAP = option(
    None, "text file that draws the scene: # squares, R robot, G its goal, 1-9 people, a-i their goals", "--map"
)
EPISODE = number_option(0, "number of the test episode (default 0)", 0, 2**31 - 1)
EPISODES = number_option(500, "number of test episodes (default 500)", 1, config.MOST_EPISODES)
JSON = option(False, "print JSON", "--json")
OVERWRITE = option(False, "replace existing files", "--overwrite")
THREADS = number_option(None, "threads to use (default one per core)", 1, 1024)
TRUST_REWARD = option(
    False,
    "run the Python code that a run or weights file names as its reward (default off)",
    "--trust-reward",
    rich_help_panel=TITLES["reward"],
)


def command(example: str, *sections: str, plays: bool = False) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a function as the command that the example shows, with the knobs of `sections` ("": the top level).

    The function gets the knobs that were given as `settings`, nested as `config.override` takes them. If it `plays` a
    policy, they are by default that policy's own.
    """

    def register(function: Callable[..., None]) -> Callable[..., None]:
        text = inspect.cleandoc(function.__doc__ or "")
        text = re.sub(r"(?<!\n)\n(?!\n)", " ", text)  # Typer would keep the line ends of all paragraphs but the first
        how: dict[str, Any] = {"cls": Command, "help": text, "epilog": f"Example: {example}"}
        app.command(example.split()[1], **how)(_with_options(function, sections, plays))
        return function

    return register


def _with_options(function: Callable[..., None], sections: tuple[str, ...], plays: bool) -> Callable[..., None]:
    """Return what Typer calls: it takes each option as a parameter, and calls `function` with groups and settings."""
    knobs = _knobs(sections)
    groups: dict[str, Any] = {}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name == "settings":
            parameters += [_parameter(section, item, plays) for section, item in knobs]
            parameters.append(inspect.Parameter("help_all", KEYWORD, default=HELP_ALL, annotation=bool))
        elif is_dataclass(parameter.annotation):
            groups[parameter.name] = parameter.annotation
            parameters += inspect.signature(groups[parameter.name]).parameters.values()
        else:
            parameters.append(parameter)

    @wraps(function)
    def wrapper(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{item.name: given.pop(item.name) for item in fields(group)})
        given.pop("help_all", None)
        if knobs:
            given["settings"] = _settings(knobs, given)
        function(**given)

    signature = inspect.Signature([parameter.replace(kind=KEYWORD) for parameter in parameters])
    wrapper.__signature__ = signature  # type: ignore[attr-defined]  # functions may have any attribute
    wrapper.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return wrapper


def _knobs(sections: tuple[str, ...]) -> list[tuple[str, Field]]:
    """The fields of these sections of the config, each with its section; those in COMMON come first."""
    knobs = [
        (section, item)
        for section in sections
        for item in fields(_section(Config(), section))
        if not is_dataclass(item.default_factory)
    ]
    return sorted(knobs, key=lambda knob: COMMON.index(knob[1].name) if knob[1].name in COMMON else len(COMMON))


def _settings(knobs: list[tuple[str, Field]], given: dict[str, Any]) -> dict[str, Any]:
    """Take the knobs out of the `given` options, and return those that were set, nested as the config is."""
    settings: dict[str, Any] = {}
    for section, item in knobs:
        if (value := given.pop(item.name)) is not None:
            place = settings.setdefault(section, {}) if section else settings
            place[item.name] = checked(item, value)
    return settings


def _section(config: Config, name: str) -> Any:
    return getattr(config, name) if name else config


def _parameter(section: str, item: Field, plays: bool) -> inspect.Parameter:
    """The option of a knob: None if it is not given.

    The help text says its value in each preset; where the command `plays` a policy, its own is the default.
    """
    values = {preset: _text(getattr(_section(config, section), item.name)) for preset, config in DEFAULTS.items()}
    alike = item.name == "preset" or len(set(values.values())) == 1
    default = f"default {values['quick']}" if alike else ", ".join(f"{name} {value}" for name, value in values.items())
    if plays:
        default = f"default the policy's, else {_text(item.default)}"
    choices, flag = item.metadata["choices"], item.name.replace("_", "-")
    listed = f" ({' | '.join(choices)})" if choices else ""
    made = option(
        None,
        f"{item.metadata['help']}{listed} ({default})",
        f"--{flag}/--no-{flag}" if isinstance(item.default, bool) else f"--{flag}",
        rich_help_panel=None if item.name in COMMON else TITLES[section],
        autocompletion=completion.among(*choices) if choices else completion.KNOBS.get(item.name),
    )
    return inspect.Parameter(item.name, KEYWORD, default=made, annotation=type(item.default) | None)


def _text(value: Any) -> str:
    """A knob's value as the help text shows it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value)
