"""Files of trained networks (.npz, with the config), and where to find one by name.

The networks that come with sfmrl are in sfmrl/models, a weights file and a model card each, named after the rows of
the paper's tables. A card says how its network was made (variant, preset, seed, commands, versions), how well it does
(rates with intervals), and the SHA-256 of its weights.
"""

import io
from pathlib import Path
from typing import Any, cast

import numpy as np

from sfmrl.config import Config, ConfigError, json_object, suggest
from sfmrl.fast import FastNetwork
from sfmrl.policies import POLICIES
from sfmrl.runs.crowdnav import CHECKPOINT, read_foreign, sarl_parameters, unwrapped
from sfmrl.runs.files import DamagedFile, read_arrays, read_listed, read_regular, sha256, write_atomically
from sfmrl.runs.folders import WEIGHTS, facts_of, finished, why_unfinished
from sfmrl.runs.run import open_run

MODELS = Path(__file__).parent.parent / "models"


def weights_file(network: FastNetwork, config: Config) -> bytes:
    """The bytes of a weights file (.npz): a network, and the config it was trained under."""
    buffer, parameters = io.BytesIO(), cast(dict[str, Any], network.state_dict())  # none is named as an option of savez
    np.savez(buffer, config=config.to_json(), **parameters)
    return buffer.getvalue()


def save_weights(network: FastNetwork, config: Config, path: Path) -> str:
    """Write a weights file (.npz) with a network and the config it was trained under; returns its SHA-256.

    Raises ConfigError if the config's `forces` or `value_prior` are not the network's.
    """
    for name in ("forces", "value_prior"):
        if getattr(network, name) != getattr(config, name):
            differ = f"the config has {name} {getattr(config, name)}, the network {getattr(network, name)}"
            raise ConfigError(f"{differ}; give the config that the network was trained with")
    return write_atomically(Path(path), weights_file(network, config))


def load_weights(path: Path) -> tuple[FastNetwork, Config]:
    """Load the network and config of a weights file, or of a CrowdNav SARL checkpoint.

    A checkpoint gets `Config(preset="paper")`: CrowdNav's reward, but solid squares, where `make_config("paper")` has
    discs. Raises DamagedFile if the file differs from its digest in the folder's SHA256SUMS or model card, ConfigError
    if it holds no such network.
    """
    path = Path(path)
    content = _content(_read(path), path)
    if not isinstance(content, dict) or not {"weights", "config"} <= set(content):
        network = network_from(content, str(path))
        return network, Config(preset="paper", forces=network.forces)
    config = Config.from_json(content["config"], f"the config in {path}")
    network = network_from(content["weights"], str(path), config.value_prior)
    if network.forces != config.forces:
        raise ConfigError(f"the config in {path} cannot be used: its network reads other columns than it says")
    return network, config


def reward_digest(path: Path) -> str | None:
    """The SHA-256 of the user's own reward, from the run.json beside the weights; None without one."""
    digest = facts_of(path.parent).get("own_reward")
    return digest if isinstance(digest, str) else None


def _read(path: Path) -> bytes:
    """Read a weights file; raises DamagedFile if it differs from its digest."""
    if path.parent != MODELS or path.stem not in model_names():
        return read_listed(path)
    expected = model_card(path.stem).get("sha256")
    if path.exists() and sha256(data := path.read_bytes()) == expected:
        return data
    raise DamagedFile(f"{path} is not what sfmrl came with; install sfmrl again")


def _content(data: bytes, path: Path) -> Any:
    """What a weights file holds: {"weights": ..., "config": ...} if it is sfmrl's, otherwise what torch reads."""
    try:
        weights = read_arrays(data)
        return {"config": str(weights.pop("config")), "weights": weights}
    except Exception:  # damaged or foreign bytes can raise anything in NumPy
        return read_foreign(data, path)


def network_from(parameters: Any, source: str, value_prior: bool = False) -> FastNetwork:
    """Make a network from parameters, whose shapes decide its layers' sizes; raises ConfigError, naming `source`."""
    try:
        return FastNetwork(sarl_parameters(unwrapped(parameters)), value_prior)
    except ValueError as error:
        raise ConfigError(f"{source} holds no SARL network that can be used: {error}") from None


def find_weights(name_or_path: str | Path) -> Path:
    """Find the weights file of a model's name, a run folder, the output folder of CrowdNav's training, or a path.

    Raises ConfigError if there is none, or only of an earlier version; DamagedFile if a run is damaged.
    """
    models, path = model_names(), Path(name_or_path)
    if path.suffix == ".py":
        raise ConfigError(f"{path} is Python code; name the policy in it, {path}:FUNCTION")
    if str(name_or_path) in models:
        return MODELS / f"{name_or_path}.npz"
    if not path.exists():
        raise ConfigError(
            f"there is no policy {name_or_path}; name {', '.join(POLICIES)}, a model (see sfmrl models), a run folder, "
            f"a weights file or file.py:function{suggest(path, [*POLICIES, *models])}"
        )
    if not path.is_dir():
        return path
    if (path / "run.json").exists():
        open_run(path)
        if finished(path):
            return path / WEIGHTS
        raise ConfigError(why_unfinished(path))
    for name in (CHECKPOINT, WEIGHTS):
        if (path / name).exists():
            return path / name
    missing = f"it has none of run.json, {CHECKPOINT} and {WEIGHTS}"
    raise ConfigError(f"{path} holds no network: {missing}; name a folder that has one")


def model_names() -> list[str]:
    """The names of the networks that come with sfmrl, which `load_policy` takes."""
    return sorted(path.stem for path in MODELS.glob("*.json"))


def model_card(name: str) -> dict[str, Any]:
    """The card of a network that comes with sfmrl; raises DamagedFile if it is not a JSON object."""
    path = MODELS / f"{name}.json"
    try:
        return json_object(read_regular(path))
    except ValueError:
        raise DamagedFile(f"{path} is not what sfmrl came with; install sfmrl again") from None
