"""Command-line options: those made from the config's knobs, whose defaults and help texts are written once, in
`config.py`, and those that several commands share."""

import inspect
from collections.abc import Callable
from dataclasses import Field, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

from sfmrl.cli import completion
from sfmrl.config import EPISODES, SEED, Config, checked, in_range
from sfmrl.variants import MIXES, PRESETS, VARIANTS, make_config

# The sections of the config by the heading under which `--help` shows their knobs.
TITLES = {
    "": "Task",
    "simulation": "Simulation",
    "reward": "Reward",
    "planner": "Recovery",
    "imitation": "Schedule",
    "reinforcement": "Schedule",
}
SWITCHES = "Switches"  # on-off knobs of all sections: their --no-... is a column of its own, too wide beside long names
DEFAULTS = {preset: make_config(preset) for preset in PRESETS}


def option(help: str, *flags: str, **extra: Any) -> Any:
    """A Typer option whose help text says all there is to say of its default."""
    return typer.Option(*flags, help=help, show_default=False, **extra)


def number_option(help: str, low: float, high: float) -> Any:
    """A Typer option that takes a number from `low` to `high`."""

    def checked_value(parameter: typer.CallbackParam, value: float | None) -> float | None:
        return value if value is None else in_range(parameter.opts[0], value, low, high, whole=isinstance(value, int))

    return option(help, callback=checked_value)


Threads = Annotated[int | None, number_option("threads to use (default one a core)", 1, 1024)]
Episodes = Annotated[int, number_option("test episodes (default 500)", 1, EPISODES)]
Episode = Annotated[int, number_option("number of the test episode (default 0)", 0, 2**31 - 1)]
Seed = Annotated[int, number_option("seed of the test episodes (default 0)", 0, SEED)]
RunFolder = Annotated[Path | None, option("run folder to make (default a new one under runs/)")]
Resume = Annotated[
    Path | None,
    option(
        "go on with this run, to the same bits as if it had never stopped", autocompletion=completion.unfinished_runs
    ),
]
Continue = Annotated[
    bool, option("if --run is there already, go on with it; do nothing if it is finished", "--continue")
]
Overwrite = Annotated[bool, option("replace what is there already", "--overwrite")]
Variant = Annotated[
    str | None,
    option(f"the paper's variant: {', '.join(VARIANTS)} (default sarl)", autocompletion=completion.variants),
]
PolicyName = Annotated[
    str | None,
    typer.Argument(
        help="linear, orca, sfm, a model (sfmrl models), a run folder, a weights file (default the newest run)",
        autocompletion=completion.policies,
    ),
]
Environment = Annotated[
    str | None,
    option(
        f"1 to 5, circle, circle5, maps, {', '.join(MIXES)} or shares, 1:0.7,2:0.3 (default the policy's test mix)",
        autocompletion=completion.environments,
    ),
]
TrustReward = Annotated[
    bool,
    option(
        "run the Python code that a run or weights file names as its reward (default only what --reward names)",
        "--trust-reward",
    ),
]

MapFile = Annotated[
    Path | None,
    option("a text file that draws the scene: # squares, R robot, G its goal, 1-9 people, a-i their goals", "--map"),
]
Humans = Annotated[
    int | None,
    number_option(
        "number of humans, on the circle, instead of the environment's own; from 11 on, its radius grows from 4 m by "
        "0.4 m each, so that they start equally close (default the environment's)",
        0,
        200,
    ),
]
HumanSpeed = Annotated[
    float | None, number_option("preferred speed of the humans, m/s (default 1; the robot's is 1)", 0, 10)
]


def settings_options(*sections: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command an option for every knob of some sections of the config ("" is its top level).

    The command gets those that were set as its argument `settings`, nested as `config.override` takes them.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        knobs = [  # sections and their fields, one an option
            (section, item)
            for section in sections
            for item in fields(_section(Config(), section))
            if not is_dataclass(item.default_factory)
        ]
        parameters = [_parameter(section, item) for section, item in knobs]
        own = [p for p in inspect.signature(command).parameters.values() if p.name != "settings"]

        @wraps(command)
        def wrapper(**given: Any) -> None:
            settings: dict[str, Any] = {}
            for section, item in knobs:
                if (value := given.pop(item.name)) is not None:
                    (settings.setdefault(section, {}) if section else settings)[item.name] = checked(item, value)
            command(**given, settings=settings)

        wrapper.__signature__ = inspect.Signature([*own, *parameters])
        wrapper.__annotations__ = {p.name: p.annotation for p in (*own, *parameters)}
        return wrapper

    return decorate


def _section(config: Config, name: str) -> Any:
    return getattr(config, name) if name else config


def _parameter(section: str, item: Field) -> inspect.Parameter:
    """The option of one knob: None where it is not given, its presets' values in the help text."""
    shown = {preset: _text(getattr(_section(config, section), item.name)) for preset, config in DEFAULTS.items()}
    alike = item.name == "preset" or len(set(shown.values())) == 1
    default = f"default {shown['quick']}" if alike else ", ".join(f"{name} {value}" for name, value in shown.items())
    choices = f" ({' | '.join(item.metadata['choices'])})" if item.metadata["choices"] else ""
    flag, switch = item.name.replace("_", "-"), isinstance(item.default, bool)
    made = option(
        f"{item.metadata['help']}{choices} ({default})",
        f"--{flag}/--no-{flag}" if switch else f"--{flag}",
        rich_help_panel=SWITCHES if switch else TITLES[section],
        autocompletion=_completion(item.name, item.metadata["choices"]),
    )
    kind = Annotated[type(item.default) | None, made]
    return inspect.Parameter(item.name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kind)


def _completion(name: str, choices: tuple[str, ...]) -> completion.Completion | None:
    """What the shell completes a knob to; None where any number or text can follow."""
    if choices:
        return completion.among(*choices)
    environments = completion.environments
    return {"reward": completion.rewards, "environment": environments, "test_environment": environments}.get(name)


def _text(value: Any) -> str:
    """A knob's value as the help text shows it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value)
