"""Rewards and policies that users write as Python functions: load them, check what they return, explain their errors.

Their arguments are read-only, so that they cannot forge a result. Each mistake in them is reported in one line.
A reward that a run or a weights file names is `Untrusted` and is not run: opening a file must not run code.
"""

import hashlib
import importlib
import inspect
import runpy
import shlex
import traceback
from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sfmrl.config import Config, ConfigError, Reward, Untrusted, suggest


class UntrustedReward(ConfigError):
    """A reward that is not run, because only a file names it, not the user."""


def read_only(thing: Any, copy: bool = True) -> Any:
    """A copy of an array, or of a dataclass of arrays, that cannot be written to; nested dataclasses become views.

    A view would not do for the outer arrays, since its owner could make it writeable again. Nested dataclasses (the
    parts of a world) decide no outcome.
    """
    if isinstance(thing, np.ndarray):
        thing = np.array(thing) if copy else thing.view()
        thing.flags.writeable = False
    elif is_dataclass(thing):
        parts = {item.name: getattr(thing, item.name) for item in fields(thing)}
        copies = {name: read_only(part, copy and not is_dataclass(part)) for name, part in parts.items()}
        if any(copies[name] is not part for name, part in parts.items()):
            return replace(thing, **copies)
    return thing


def is_write(error: BaseException) -> bool:
    """Whether `error` was raised by an attempt to change something `read_only`."""
    return isinstance(error, FrozenInstanceError) or (type(error) is ValueError and "read-only" in str(error))


def takes_two(function: Callable) -> bool:
    """Whether a function takes two arguments, as rewards and policies must."""
    try:
        inspect.signature(function).bind(None, None)
    except TypeError:
        return False
    except ValueError:  # compiled, without a signature
        pass
    return True


def fault(who: str, function: Callable, error: BaseException, arguments: str) -> ConfigError:
    """Make the error to raise when a user's function has raised `error`: its line of code, and what to change."""
    if is_write(error):
        remedy = "what it is given is read-only: work on a copy, as numpy.array(...) makes one"
    elif isinstance(error, TypeError) and not takes_two(function):
        remedy = f"define it with two arguments, {arguments}"
    elif type(error) is ValueError and "truth value of an array" in str(error):
        remedy = "it is given whole arrays: choose with numpy.where or numpy.select instead of if"
    elif isinstance(error, Exception):
        remedy = "correct that line"
    else:
        remedy = "it must return, and not end the program"
    file = getattr(getattr(function, "__code__", None), "co_filename", "")
    return ConfigError(f"{who}{_line(error, file)} failed: {_text(error)}; {remedy}")


def checked_array(who: str, function: Callable, returned: Any, shape: tuple[int, ...], meaning: str) -> np.ndarray:
    """Convert what a user's function returned to floats; raises ConfigError if not finite and of this shape."""
    line = getattr(getattr(function, "__code__", None), "co_firstlineno", None)
    who += f" (line {line})" if line else ""
    try:
        array = None if returned is None else np.asarray(returned, dtype=float)
    except (TypeError, ValueError, RuntimeError):  # RuntimeError: a tensor that requires a gradient
        array = None
    if array is None or array.shape != shape:
        what = kind(returned) if array is None or not array.ndim else f"an array of shape {array.shape}"
        raise ConfigError(f"{who} returned {what}; it must return an array of shape {shape}, {meaning}")
    if not np.isfinite(array).all():
        raise ConfigError(f"{who} returned NaN or infinity; it must return finite numbers, {meaning}")
    return array


def name_of(function: Callable) -> str:
    """The name of a function, or of another callable's type, for error messages."""
    return getattr(function, "__name__", type(function).__name__)


def kind(thing: Any) -> str:
    """A value of the wrong type, for error messages: text and numbers themselves, the type of all else."""
    return repr(thing) if isinstance(thing, (str, int, float, type(None))) else f"a {type(thing).__name__}"


def load(name: str) -> Callable:
    """Load the function that "file.py:function" or "package.module:function" names.

    Raises UntrustedReward if only a file names it, ConfigError if there is no such function.
    """
    if isinstance(name, Untrusted):
        raise UntrustedReward(
            f"reward {name} is Python code that a run or weights file names, so it is not run; if you trust that code, "
            f"add --trust-reward, or --reward {shlex.quote(name)} (in Python: load_policy(..., trust_reward=True))"
        )
    place, _, function = name.rpartition(":")
    file = _file(name)
    try:
        known = runpy.run_path(str(file)) if file else vars(importlib.import_module(place))
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise ConfigError(f"reward {name}{_line(error, str(file))} cannot be imported: {_text(error)}") from error
    if not callable(known.get(function)):
        raise ConfigError(f"reward {name}: {place} has no function {function!r}{suggest(function, known)}")
    return known[function]


def trusted(config: Config, trust: bool | str) -> Config:
    """Allow the config's reward to be run if `trust` is True or names the same reward."""
    name = config.reward.reward
    named = type(trust) is str and absolute(trust) == absolute(name)
    return replace(config, reward=replace(config.reward, reward=str(name))) if trust is True or named else config


def absolute(name: str) -> str:
    """Make the path in a reward's name absolute, if it has one, so that the file is found from any folder."""
    place, colon, function = name.rpartition(":")
    return f"{Path(place).resolve()}{colon}{function}" if place.endswith(".py") else name


def reward_digest(settings: Reward) -> str | None:
    """The SHA-256 of the file with a user's reward; None without a file. Raises ConfigError if it is missing."""
    file = _file(settings.reward)
    return hashlib.sha256(file.read_bytes()).hexdigest() if file else None


def _file(name: str) -> Path | None:
    place = name.rpartition(":")[0]
    if not place.endswith(".py"):
        return None
    if not Path(place).is_file():
        raise ConfigError(f"reward {name}: there is no file {place}; put it there, or write its path as seen from here")
    return Path(place)


def _line(error: BaseException, file: str) -> str:
    """The line of `file` that raised an exception, as " (line 7)"; "" if none did."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    if isinstance(error, SyntaxError) and error.filename == file:
        lines.append(error.lineno)
    return f" (line {lines[-1]})" if lines else ""


def _text(error: BaseException) -> str:
    """An exception in one line."""
    return " ".join(f"{type(error).__name__}: {error}".rstrip(": ").split())
