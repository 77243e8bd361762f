"""Code that run folders and weights files name: when it may be run, and whether it is still the same code.

Opening a file must not run code. So a reward that comes from a config.json is `Untrusted`, and is run only if the user
names the same one or trusts them all.
"""

import hashlib
import sys
from pathlib import Path

from sfmrl.config import Config, ConfigError, override
from sfmrl.own_code import file_of, names_code


def trusted(config: Config, trust: bool | str, digest: str | None = None) -> Config:
    """The config, its reward allowed to be run if `trust` is True or names the same reward.

    If the config's file is gone, a copy of it elsewhere counts as the same, if its SHA-256 is `digest`; raises
    ConfigError if it is another.
    """
    name = config.reward.reward
    if type(trust) is not str:  # also Untrusted, which only a file names
        return override(config, {"reward": {"reward": str(name)}}) if trust is True else config
    place, _, function = name.rpartition(":")
    moved = place.endswith(".py") and not Path(place).is_file() and trust.endswith(f".py:{function}")
    if moved and digest:
        if code_digest(trust) != digest:
            raise ConfigError(f"{trust} is not the reward that the network was trained with, {name}; put that one back")
        name = trust
    return override(config, {"reward": {"reward": str(name)}}) if absolute(trust) == absolute(name) else config


def absolute(name: str) -> str:
    """A reward's name with an absolute path, if it has a path, so that the file is found from any folder."""
    place, colon, function = name.rpartition(":")
    return f"{Path(place).resolve()}{colon}{function}" if place.endswith(".py") else name


def code_digest(name: str) -> str | None:
    """The SHA-256 of the file with the named code, CRLF read as LF; None if no file is found.

    Raises ConfigError if the name has a path, and there is no such file.
    """
    file = file_of(name) or (_module_file(name.rpartition(":")[0]) if names_code(name) else "")
    return hashlib.sha256(Path(file).read_bytes().replace(b"\r\n", b"\n")).hexdigest() if file else None


def check_unchanged(name: str, digest: str | None) -> None:
    """Raise ConfigError if the file of the named code no longer has its SHA-256 of the run's beginning, `digest`."""
    now = code_digest(name)
    if digest and now and digest != now:
        raise ConfigError(f"{name} has changed since the run began; put that file back and resume, or start a new run")


def _module_file(module: str) -> str:
    """The file of a module in one of the folders of sys.path, "" if there is none; imports nothing."""
    for folder in sys.path:
        place = Path(folder, *module.split("."))
        for file in (place / "__init__.py", place.with_suffix(".py")):
            if file.is_file():
                return str(file)
    return ""
