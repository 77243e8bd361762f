"""Rewards and policies that users write as Python functions: load them, check what they return, explain their errors.

Their arguments are read-only, so that they cannot change a result. A reward that only a run or weights file names is
`Untrusted` and is not run, since opening a file must not run code.
"""

import hashlib
import importlib
import runpy
import shlex
import traceback
from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sfmrl.config import Config, ConfigError, Reward, Settings, Untrusted, override, suggest


class UntrustedReward(ConfigError):
    """A reward that is not run, because only a file names it, not the user."""


def read_only(thing: Any, copy: bool = True) -> Any:
    """A read-only copy of an array or of a dataclass of arrays, with views of the arrays in nested dataclasses.

    The owner of a view can make it writeable again. Nested dataclasses (parts of a world) decide no outcome.
    """
    if isinstance(thing, np.ndarray):
        thing = np.array(thing) if copy else thing.view()
        thing.flags.writeable = False
    elif is_dataclass(thing) and not isinstance(thing, Settings):
        parts = {item.name: getattr(thing, item.name) for item in fields(thing)}
        thing = replace(thing, **{name: read_only(part, not is_dataclass(part)) for name, part in parts.items()})
    return thing


def remedy(error: BaseException, arguments: str) -> str:
    """How to correct a user's function, called where `error` was caught; "" if the error itself says it."""
    if isinstance(error, FrozenInstanceError) or "read-only" in str(error):
        return "; what it is given is read-only: work on a copy, as numpy.array(...) makes one"
    if isinstance(error, TypeError) and error.__traceback__.tb_next is None:  # the call failed, nothing in the function
        return f"; define it with two arguments, {arguments}"
    if "truth value of an array" in str(error):
        return "; it is given whole arrays: choose with numpy.where or numpy.select instead of if"
    return "" if isinstance(error, Exception) else "; it must return, and not end the program"


def fault(who: str, function: Callable, error: BaseException, remedy: str) -> ConfigError:
    """The error to raise if a user's function has raised `error`: one line, with the number of its line of code."""
    file = getattr(getattr(function, "__code__", None), "co_filename", "")
    return ConfigError(f"{who}{_summary('failed', error, file)}{remedy}")


def checked_array(who: str, function: Callable, returned: Any, shape: tuple[int, ...], meaning: str) -> np.ndarray:
    """What a user's function returned, as floats; raises ConfigError unless they are finite and of this shape."""
    if hasattr(function, "__code__"):
        who += f" (line {function.__code__.co_firstlineno})"
    try:
        array = np.asarray(returned, dtype=float)
    except (TypeError, ValueError, RuntimeError):  # RuntimeError: a tensor that requires a gradient
        array = np.array(np.nan)
    if array.shape != shape:
        what = f"an array of shape {array.shape}" if array.ndim else kind(returned)
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
    """The function that "file.py:function" or "package.module:function" names.

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
        raise ConfigError(f"reward {name}{_summary('cannot be imported', error, str(file))}") from error
    if not callable(known.get(function)):
        raise ConfigError(f"reward {name}: {place} has no function {function!r}{suggest(function, known)}")
    return known[function]


def trusted(config: Config, trust: bool | str) -> Config:
    """The config, its reward allowed to be run if `trust` is True or names the same reward."""
    name = config.reward.reward
    named = type(trust) is str and absolute(trust) == absolute(name)  # an Untrusted name is a file's
    return override(config, {"reward": {"reward": str(name)}}) if trust is True or named else config


def absolute(name: str) -> str:
    """A reward's name with an absolute path, if it has a path, so that the file is found from any folder."""
    place, colon, function = name.rpartition(":")
    return f"{Path(place).resolve()}{colon}{function}" if place.endswith(".py") else name


def reward_digest(settings: Reward) -> str | None:
    """The SHA-256 of the file with a user's reward; None without a file. Raises ConfigError if it is missing."""
    file = _file(settings.reward)
    return hashlib.sha256(file.read_bytes()).hexdigest() if file else None


def _file(name: str) -> Path | None:
    place = Path(name.rpartition(":")[0])
    if place.suffix != ".py":
        return None
    if not place.is_file():
        raise ConfigError(f"reward {name}: there is no file {place}; put it there, or write its path as seen from here")
    return place


def _summary(what: str, error: BaseException, file: str) -> str:
    """An error in one line, after its line number in `file` (if it was raised there) and `what` happened."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    lines += [error.lineno] if isinstance(error, SyntaxError) and error.filename == file else []
    where = f" (line {lines[-1]})" if lines else ""
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return f"{where} {what}: {text}".rstrip(": ")
