"""Rewards and policies that users write as Python functions: load them, check what they return, explain their errors.

Their arguments are read-only copies, so that they cannot change a result. A reward that only a run or weights file
names is `Untrusted` and is not run, since opening a file must not run code; `trust.py` says who may allow it.
"""

import copy
import importlib
import runpy
import traceback
from collections.abc import Callable
from dataclasses import is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sfmrl.config import ConfigError, Untrusted, as_typed, suggest

READ_ONLY = "its arguments are read-only: work on a copy, such as numpy.array(...)"
NO_MODULE = "No module named"
HINTS = {  # what to change in a user's function, by a part of the error that it raises
    "read-only": READ_ONLY,
    "cannot assign to field": READ_ONLY,
    "positional argument": "define it with the arguments {arguments}",
    NO_MODULE: "a file cannot import the files beside it: copy what it needs into it, or install that as a package",
    "truth value of an array": "its arguments are whole arrays: use numpy.where or numpy.select instead of if",
}

ARGUMENTS = {
    "reward": "(transition, settings)",
    "policy": "(world, crowd_velocity)",
    "explain": "(world, crowd_velocity)",
    "begin": "(scenes, simulation)",
    "attention": "(world)",
}


class UntrustedReward(ConfigError):
    """A reward that is not run, because only a file names it, not the user."""


def read_only(thing: Any) -> Any:
    """A read-only copy of an array, or of a frozen dataclass of arrays and such dataclasses."""
    if isinstance(thing, np.ndarray):
        thing = np.array(thing)  # not a view, which its owner could make writeable again
        thing.flags.writeable = False
        return thing
    parts = vars(thing).items()
    arrays = {name: part for name, part in parts if isinstance(part, np.ndarray)}
    batches = {name: part for name, part in parts if is_dataclass(part) and hasattr(part, "take")}
    return replace(thing, **{name: read_only(part) for name, part in (arrays | batches).items()})


def guarded(who: str, what: str, file: str, call: Callable[[], Any]) -> Any:
    """What `call` returns; raises ConfigError if it raises anything, with the line in `file` where that happened."""
    try:
        return call()
    except (Exception, SystemExit) as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
        lines += [error.lineno] if isinstance(error, SyntaxError) and error.filename == file else []
        where = f" (line {lines[-1]})" if lines else ""
        text = " ".join(f"{type(error).__name__}: {error}".rstrip(": ").split())
        hint = next((f"; {hint}" for part, hint in HINTS.items() if part in text and (file or part != NO_MODULE)), "")
        hint = hint.replace("{arguments}", ARGUMENTS[who.partition(" ")[0]])
        raise ConfigError(f"{who}{where} {what}: {text}{hint}") from error


def checked_array(who: str, function: Callable, returned: Any, shape: tuple[int, ...], meaning: str) -> np.ndarray:
    """What a user's function returned, as floats; raises ConfigError unless they are finite and of this shape."""
    if hasattr(function, "__code__"):
        who += f" (line {function.__code__.co_firstlineno})"
    try:
        array = np.asarray(returned, dtype=float)
    except (TypeError, ValueError, RuntimeError):  # RuntimeError: a tensor that requires a gradient
        array = np.array(np.nan)
    if array.shape != shape:
        what = f"an array of shape {array.shape}" if array.ndim else described(returned)
        raise ConfigError(f"{who} returned {what}; it must return an array of shape {shape}, {meaning}")
    if not np.isfinite(array).all():
        raise ConfigError(f"{who} returned NaN or infinity; it must return finite numbers, {meaning}")
    return array


def checked_action(policy: Callable, returned: Any, episodes: int) -> np.ndarray:
    """The velocities (E, 2) that a policy returned, as `checked_array` returns them."""
    meaning = "a velocity (x, y) in m/s for each episode"
    return checked_array(f"policy {name_of(policy)}", policy, returned, (episodes, 2), meaning)


def name_of(function: Callable) -> str:
    """The name of a function, or of another callable's type, for error messages."""
    return getattr(function, "__name__", type(function).__name__)


def described(thing: Any) -> str:
    """A value of the wrong type, for error messages: text and numbers themselves, the type of all else."""
    return repr(thing) if isinstance(thing, (str, int, float, type(None))) else f"a {type(thing).__name__}"


class OwnPolicy:
    """A user's policy by its name, "file.py:function", or "file.py:make()" for what `make` returns.

    Its errors become ConfigError with the line; what else the policy has (`begin`, `batch` ...) is passed on.
    """

    def __init__(self, name: str) -> None:
        made = name.endswith("()")
        self.own = load(name.removesuffix("()"), "policy")
        self.__name__, self._file = name, source(self.own)
        if made:
            self.own = guarded(f"policy {name}", "failed", self._file, self.own)
            if not callable(self.own):
                raise ConfigError(
                    f"policy {name} returned {described(self.own)}; it must return a policy, {ARGUMENTS['policy']}"
                )

    def __repr__(self) -> str:
        return f"OwnPolicy({self.__name__})"

    def __call__(self, world: Any, crowd_velocity: np.ndarray) -> Any:
        return self._run(f"policy {self.__name__}", self.own, world, crowd_velocity)

    def __getattr__(self, name: str) -> Any:
        if name == "own":  # copy.copy() asks before __init__ has run
            raise AttributeError(name)
        part = getattr(self.own, name)
        called = name in ("begin", "explain", "attention")
        return partial(self._run, f"{name} of policy {self.__name__}", part) if called else part

    def around(self, other: Callable) -> "OwnPolicy":
        """The same wrapper, which turns errors into one line, around another policy."""
        wrapper = copy.copy(self)
        wrapper.own = other
        return wrapper

    def _run(self, who: str, function: Callable, *arguments: Any) -> Any:
        return guarded(who, "failed", self._file, lambda: function(*arguments))


def names_code(name: str) -> bool:
    """Whether a policy's name is one of Python code: file.py:function or package.module:function, also with ()."""
    place, _, function = name.rpartition(":")
    return function.removesuffix("()").isidentifier() and (
        place.endswith(".py") or all(part.isidentifier() for part in place.split("."))
    )


def source(function: Callable) -> str:
    """The file that a function stands in, "" for other callables."""
    return function.__code__.co_filename if hasattr(function, "__code__") else ""


def load(name: str, what: str = "reward") -> Callable:
    """The function that "file.py:function" or "package.module:function" names, a "reward" or a "policy".

    Raises UntrustedReward if only a file names it, ConfigError if there is no such function.
    """
    if isinstance(name, Untrusted):
        raise UntrustedReward(
            f"reward {name} is Python code that a run or weights file names, so it is not run; if you trust that code, "
            f"add --trust-reward, or --reward {as_typed([name])} (in Python: load_policy(..., trust_reward=True))"
        )
    place, _, function = name.rpartition(":")
    file = file_of(name, what)
    run = runpy.run_path if file else lambda module: vars(importlib.import_module(module))
    known = guarded(f"{what} {name}", "cannot be imported", file, lambda: run(file or place))
    if not callable(known.get(function)):
        raise ConfigError(f"{what} {name}: {place} has no function {function!r}{suggest(function, known)}")
    return known[function]


def file_of(name: str, what: str = "reward") -> str:
    """The file in a name of Python code, "" if it names none; raises ConfigError if it is missing."""
    place = name.rpartition(":")[0]
    if not place.endswith(".py"):
        return ""
    if not Path(place).is_file():
        remedy = "put it there" if isinstance(name, Untrusted) else "put it there, or give its full path"
        raise ConfigError(f"{what} {name}: there is no file {place}; {remedy}")
    return place
