"""CrowdNav's SARL checkpoints (.pth, torch's format): read and check them, and write a network as one.

Checkpoints of other programs that train the same network are read, too: layers may have any sizes, and parameters may
be wrapped in dictionaries or have a prefix. torch is imported inside functions, since that takes seconds.
"""

import configparser
import io
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from sfmrl.config import ConfigError
from sfmrl.fast import as_fast
from sfmrl.fast.parameters import Parameters, Sizes, layer_shapes
from sfmrl.runs.files import DamagedFile, read_regular, write_atomically
from sfmrl.states import OWN, column_names

CHECKPOINT = "rl_model.pth"  # in the output folder of CrowdNav's training
WRAPPERS = ("state_dict", "model_state_dict", "model")  # keys under which a file may hold its parameters
MAX_WRAPPERS = 4  # nested in each other
PREFIXES = ("module.", "model.")  # that DataParallel and wrapping modules put before every name
MAX_UNITS = 4096  # in a layer
OTHERS = {"value_network.": "CADRL, which looks at one person at a time", "lstm.": "LSTM-RL"}  # by parameters' prefix
NOT_WEIGHTS = {  # first bytes of files that are often mistaken for weights
    b"version https://git-lfs": "is a git-lfs pointer, not the file itself; fetch that with git lfs pull",
    b"<!doctype html": "is a web page (HTML), not the file itself; download that",
    b"<html": "is a web page (HTML), not the file itself; download that",
}


def read_foreign(data: bytes, path: Path) -> Any:
    """Read a file's bytes with torch, without running any code in them; raises ConfigError, naming `path`."""
    if not data:
        raise ConfigError(f"{path} is empty; put back a copy")
    for start, what in NOT_WEIGHTS.items():
        if data[:200].lstrip().lower().startswith(start):
            raise ConfigError(f"{path} {what}")
    file = io.BytesIO(data)
    if zipfile.is_zipfile(file) and (damaged := _damaged_part(file)):
        raise ConfigError(
            f"{path} is damaged: the checksum of {damaged} in it is wrong; put back a copy, or save it with "
            "checksums (torch.serialization.set_crc32_options(True))"
        )
    try:
        import torch
    except ImportError as error:
        said = f"is not a weights file of sfmrl; to read one of CrowdNav, install torch ({error})"
        raise ConfigError(f"{path} {said}") from None

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # damaged or foreign bytes can raise anything in torch
        reason = "is not a weights file that can be read safely; name a run folder, or its weights.npz"
        if "Unsupported global" in str(error) or "Unsupported class" in str(error):
            reason = "holds Python objects, which could run code; save only its state_dict()"
        raise ConfigError(f"{path} {reason}") from error


def _damaged_part(file: io.BytesIO) -> str | None:
    """The first part of a zip file whose checksum is wrong, which torch does not notice; None if none was found."""
    try:
        with zipfile.ZipFile(file) as parts:
            unpacked = sum(part.file_size for part in parts.infolist())
            return None if unpacked > len(file.getbuffer()) else parts.testzip()  # torch's own are not compressed
    except Exception:  # no zip file after all, of which torch tells
        return None


def unwrapped(content: Any) -> Any:
    """Take parameters out of the usual wrappers: {"state_dict": ...} and the like, and "module." before every name."""
    for _ in range(MAX_WRAPPERS):  # a bound, since a dictionary can contain itself
        keys = [key for key in WRAPPERS if isinstance(content, dict) and isinstance(content.get(key), dict)]
        content = content[keys[0]] if keys else content
    if not isinstance(content, dict):
        return content
    for prefix in PREFIXES:
        if content and all(str(name).startswith(prefix) for name in content):
            content = {name.removeprefix(prefix): value for name, value in content.items()}
    return content


def sarl_parameters(parameters: Any) -> Parameters:
    """The parameters of a SARL network, with layers of any size, as float32 arrays in the order of its layers.

    Raises ValueError, with the reason, if they are those of another network or of none, or not finite.
    """
    if not isinstance(parameters, dict):
        raise ValueError(f"it is a {type(parameters).__name__}, not parameters by name")
    names = [str(name) for name in parameters]
    for start, what in OTHERS.items():
        if any(name.startswith(start) for name in names):
            raise ValueError(f"it is another network of CrowdNav's, {what}")
    known = list(layer_shapes(False))
    if absent := [name for name in known if name not in parameters]:
        raise ValueError(f"there is no {absent[0]}" + (f"; its first layer is {names[0]}" if names else ""))
    if others := [name for name in names if name not in known]:
        raise ValueError(f"there is {others[0]}, too")
    arrays = {}
    for name in known:
        array = _dense(parameters[name])
        if array is None or array.ndim != (2 if name.endswith("weight") else 1):
            raise ValueError(f"{name} is not a plain tensor of floating-point numbers")
        if not 0 < min(array.shape) <= max(array.shape) <= MAX_UNITS:
            raise ValueError(f"{name} is {array.shape}; a layer has 1 to {MAX_UNITS} units")
        arrays[name] = array.astype(np.float32)
        if not np.isfinite(arrays[name]).all():
            remedy = "train it again with a smaller learning rate"
            raise ValueError(f"{name} holds numbers that are not finite, so its training diverged; {remedy}")
    _check_shapes(arrays)
    return arrays


def _dense(value: Any) -> np.ndarray | None:
    """A dense tensor or array of floating-point numbers as an array; None for anything else."""
    if isinstance(value, np.ndarray):
        return value if value.dtype.kind == "f" else None
    try:
        return value.detach().float().numpy() if value.is_floating_point() else None
    except Exception:  # sparse, quantized and nested tensors, and what is no tensor, raise different errors
        return None


def _check_shapes(arrays: Parameters) -> None:
    """Raise ValueError, naming the difference, if the layers' shapes do not fit together as SARL's do."""
    names = list(arrays)  # weight and bias of each layer: mlp1 (2 layers), mlp2 (2), attention (3), mlp3 (4)
    units, inputs = ([arrays[name].shape[k] for name in names[::2]] for k in (0, 1))
    sizes = Sizes(tuple(units[:2]), tuple(units[2:4]), (*units[4:6], 1), (*units[7:10], 1))
    if inputs[0] > len(column_names(False)) and inputs[7] == len(OWN) + sizes.mlp2[-1]:
        raise ValueError(f"it is OM-SARL: mlp1.0.weight reads {inputs[0]} columns, with those of an occupancy map")
    if inputs[4] == sizes.mlp1[-1]:
        raise ValueError("attention.0.weight does not read the mean of all people (with_global_state = false)")
    for name, shape in layer_shapes(inputs[0] == len(column_names(True)), sizes).items():
        if arrays[name].shape != shape:
            raise ValueError(f"{name} is {arrays[name].shape}, not {shape}")


def export_weights(network: Any, path: Path) -> str:
    """Write a network as a checkpoint that CrowdNav's SARL loads (.pth, torch's format); returns its SHA-256.

    `network` is a FastNetwork or a ValueNetwork. Raises ConfigError if it has `value_prior`, which CrowdNav would not
    add.
    """
    if network.value_prior:
        raise ConfigError(
            "the network's value has a prior, without which CrowdNav would choose other actions; train one with "
            "--no-value-prior"
        )
    import torch

    buffer = io.BytesIO()
    torch.save({name: torch.from_numpy(value) for name, value in as_fast(network).state_dict().items()}, buffer)
    return write_atomically(Path(path), buffer.getvalue(), checked=False)


def differing_settings(path: Path, robot_visible: bool, kinematics: str = "holonomic") -> list[str]:
    """Warnings where CrowdNav's config files beside a checkpoint differ from how it is played here."""
    policy, world = (_read_ini(path.with_name(name)) for name in ("policy.config", "env.config"))
    theirs = policy.get("action_space", "kinematics", fallback="holonomic")
    unseen = world.get("robot", "visible", fallback="true").lower() in ("false", "no", "off", "0")
    moves = "was trained for a robot that turns; --kinematics unicycle plays it so"
    sees = "was trained among people who did not see the robot; --no-robot-visible plays it so"
    notes = {moves: theirs == "unicycle" and kinematics == "holonomic", sees: unseen and robot_visible}
    return [f"{path} {note}" for note, holds in notes.items() if holds]


def _read_ini(path: Path) -> configparser.ConfigParser:
    """Read one of CrowdNav's config files; an empty config if there is none that can be read."""
    config = configparser.ConfigParser(interpolation=None, strict=False)
    try:
        config.read_string(read_regular(path).decode())
    except (OSError, DamagedFile, UnicodeDecodeError, configparser.Error):
        return configparser.ConfigParser()
    return config
