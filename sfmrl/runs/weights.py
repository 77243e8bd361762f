"""Networks in files: sfmrl's own in NumPy's format, with the config, and CrowdNav's SARL checkpoints in torch's."""

import configparser
import io
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from sfmrl.config import Config, ConfigError
from sfmrl.fast import FastNetwork
from sfmrl.fast.layers import Parameters, Sizes, layer_shapes
from sfmrl.runs.files import DamagedFile, read_listed, read_regular, write_atomically
from sfmrl.states import OWN, column_names

WRAPPERS = ("state_dict", "model_state_dict", "model")  # keys under which a file may hold its parameters
PREFIXES = ("module.", "model.")  # before all names: of DataParallel, of a network that is a part of something
MOST_WRAPPERS = 4
UNITS = 4096  # of a layer at most
CADRL, LSTM_RL = "value_network.", "lstm."  # beginnings of the parameters' names of CrowdNav's other networks
NO_WEIGHTS = {  # beginnings of files that are something else
    b"version https://git-lfs": "is a git-lfs pointer, not the file itself; fetch that with git lfs pull",
    b"<!doctype html": "is a web page (HTML), not the file itself; download that",
    b"<html": "is a web page (HTML), not the file itself; download that",
}


def network_from(parameters: Any, source: str, value_prior: bool = False) -> FastNetwork:
    """The network whose parameters these are: sfmrl's own, or those of a CrowdNav SARL checkpoint, wrapped or not.

    Its layers have the sizes of the parameters. Raises ConfigError, naming `source` and the first layer that differs,
    where they are not a SARL network's, and where they are not finite.
    """
    try:
        arrays = sarl_parameters(unwrapped(parameters))
    except ValueError as error:
        raise ConfigError(f"{source} does not hold a SARL network: {error}") from None
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise ConfigError(
                f"{source} cannot be used: {name} holds numbers that are not finite, so its training diverged; "
                "train it again with a smaller learning rate"
            )
    return FastNetwork(arrays, value_prior)


def unwrapped(content: Any) -> Any:
    """What the usual wrappers hold: {"state_dict": ...} and the like, and "module." before every name."""
    for _ in range(MOST_WRAPPERS):  # one may hold itself
        keys = [key for key in WRAPPERS if isinstance(content, dict) and isinstance(content.get(key), dict)]
        content = content[keys[0]] if keys else content
    for prefix in PREFIXES * isinstance(content, dict):
        if content and all(str(name).startswith(prefix) for name in content):
            content = {name.removeprefix(prefix): value for name, value in content.items()}
    return content


def sarl_parameters(parameters: Any) -> Parameters:
    """The parameters of a SARL network, with layers of any size, as float32 arrays in the order of its layers.

    Raises ValueError, with the reason, where they are those of another network or of none.
    """
    if not isinstance(parameters, dict):
        raise ValueError(f"it is a {type(parameters).__name__}, not parameters by name")
    names = [str(name) for name in parameters]
    for beginning, what in ((CADRL, "CADRL, which looks at one person at a time"), (LSTM_RL, "LSTM-RL")):
        if any(name.startswith(beginning) for name in names):
            raise ValueError(f"it is another network of CrowdNav's, {what}")
    known = list(layer_shapes(False))
    if absent := [name for name in known if name not in parameters]:
        raise ValueError(f"there is no {absent[0]}" + (f"; its first layer is {names[0]}" if names else ""))
    if others := [name for name in names if name not in known]:
        raise ValueError(f"there is {others[0]}, too")
    arrays = {}
    for name in known:
        array = _plain(parameters[name])
        if array is None or array.ndim != (2 if name.endswith("weight") else 1):
            raise ValueError(f"{name} is not a plain tensor of floating-point numbers")
        if not 0 < min(array.shape) <= max(array.shape) <= UNITS:
            raise ValueError(f"{name} is {array.shape}; a layer has 1 to {UNITS} units")
        arrays[name] = array.astype(np.float32)
    units, inputs = ([arrays[name].shape[k] for name in known[::2]] for k in (0, 1))
    sizes = Sizes(tuple(units[:2]), tuple(units[2:4]), (*units[4:6], 1), (*units[7:10], 1))
    if inputs[0] > len(column_names(False)) and inputs[7] == len(OWN) + sizes.mlp2[-1]:
        raise ValueError(f"it is OM-SARL: mlp1.0.weight reads {inputs[0]} columns, with those of an occupancy map")
    if inputs[4] == sizes.mlp1[-1]:
        raise ValueError("attention.0.weight does not read the mean of all people (with_global_state = false)")
    for name, shape in layer_shapes(inputs[0] == len(column_names(True)), sizes).items():
        if arrays[name].shape != shape:
            raise ValueError(f"{name} is {arrays[name].shape}, not {shape}")
    return arrays


def _plain(value: Any) -> np.ndarray | None:
    """A dense array, or a dense tensor as one, of floating-point numbers; None for all else."""
    if not isinstance(value, np.ndarray):
        try:  # a tensor that is sparse, quantised, nested or on no device cannot be an array
            value = value.detach().float().numpy() if value.is_floating_point() else value
        except (AttributeError, RuntimeError, TypeError, NotImplementedError):
            return None
    return value if isinstance(value, np.ndarray) and value.dtype.kind == "f" else None


def weights_file(network: FastNetwork, config: Config) -> bytes:
    """The bytes of a file (.npz) with a network and the config it was trained under."""
    buffer = io.BytesIO()
    np.savez(buffer, config=config.to_json(), **network.state_dict())
    return buffer.getvalue()


def save_weights(network: FastNetwork, config: Config, path: Path) -> str:
    """Write a network and the config it was trained under to a file of their own (.npz); returns its SHA-256."""
    return write_atomically(path, weights_file(network, config))


def export_weights(network: FastNetwork, path: Path) -> str:
    """Write a network as a checkpoint that CrowdNav's SARL loads (.pth, torch's format); returns its SHA-256."""
    import torch

    buffer = io.BytesIO()
    torch.save({name: torch.from_numpy(value) for name, value in network.state_dict().items()}, buffer)
    return write_atomically(Path(path), buffer.getvalue(), checked=False)


def load_weights(path: Path) -> tuple[FastNetwork, Config]:
    """The network and config of a weights file; for a CrowdNav checkpoint, CrowdNav's reward under the paper's preset.

    A file listed in its folder's SHA256SUMS is held to it. Raises DamagedFile, or ConfigError where there is no such
    network in the file.
    """
    path = Path(path)
    content = read_content(read_listed(path), path)
    if not isinstance(content, dict) or not {"weights", "config"} <= set(content):
        network = network_from(content, str(path))
        return network, Config(preset="paper", forces=network.forces)
    try:
        config = Config.from_json(content["config"])
    except ConfigError as error:
        raise ConfigError(f"the config in {path} cannot be used: {error}") from error
    network = network_from(content["weights"], str(path), config.value_prior)
    if network.forces != config.forces:
        raise ConfigError(f"the config in {path} cannot be used: its network reads other columns than it says")
    return network, config


def read_content(data: bytes, path: Path) -> Any:
    """What is in the bytes of a weights file: {"weights": ..., "config": ...} of sfmrl's, or what torch finds in it."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            own = "config.npy" in archive.namelist()
        if own:
            with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
                weights = {name: arrays[name] for name in arrays.files if name != "config"}
                return {"weights": weights, "config": str(arrays["config"])}
    except Exception:  # whatever the bytes lead the readers to
        pass
    return read_foreign(data, path)


def read_foreign(data: bytes, path: Path) -> Any:
    """What torch finds in the bytes of a file, without running any code in it; raises ConfigError, naming `path`."""
    if not data:
        raise ConfigError(f"{path} is empty; put back a copy")
    for beginning, what in NO_WEIGHTS.items():
        if data[:200].lstrip().lower().startswith(beginning):
            raise ConfigError(f"{path} {what}")
    import torch  # takes seconds: only for files in its format

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # torch's reader raises whatever the bytes lead it to
        if "Unsupported global" in str(error) or "Unsupported class" in str(error):
            said = "holds Python objects, which could run code; save no more than its state_dict()"
        else:
            said = "is not a weights file that can be read safely; name a run folder, or its weights.npz"
        raise ConfigError(f"{path} {said}") from error


def other_habits(path: Path, robot_visible: bool) -> list[str]:
    """What the CrowdNav configs beside a checkpoint say that is otherwise here, in sentences."""
    policy, world = (_ini(path.with_name(name)) for name in ("policy.config", "env.config"))
    found = []
    kinematics = policy.get("action_space", "kinematics", fallback="holonomic")
    if kinematics != "holonomic":
        found.append(
            f"{path} was trained for a robot whose kinematics are {kinematics}; here it moves in any direction"
        )
    unseen = world.get("robot", "visible", fallback="true").lower() in ("false", "no", "off", "0")
    if unseen and robot_visible:
        found.append(f"{path} was trained among people who did not see the robot; --no-robot-visible plays it so")
    return found


def _ini(path: Path) -> configparser.ConfigParser:
    """A config of CrowdNav's; an empty one where there is none that can be read."""
    found = configparser.ConfigParser(interpolation=None, strict=False)
    try:
        found.read_string(read_regular(path).decode())
    except (OSError, DamagedFile, UnicodeDecodeError, configparser.Error):
        return configparser.ConfigParser()
    return found
