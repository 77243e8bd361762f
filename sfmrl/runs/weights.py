"""Files of trained networks: sfmrl's own (.npz, with the config), and where to find one by name.

The networks that come with sfmrl are in sfmrl/models, a weights file and a model card each, named after the rows of
the paper's tables. A card says how its network was made (variant, preset, seed, commands, versions), how well it does
(rates with intervals), and the SHA-256 of its weights.
"""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from sfmrl.config import Config, ConfigError, json_object, suggest
from sfmrl.fast import FastNetwork
from sfmrl.policies import POLICIES
from sfmrl.runs.crowdnav import CHECKPOINT, read_foreign, sarl_parameters, unwrapped
from sfmrl.runs.files import DamagedFile, digest_of, read_checked, read_listed, read_regular, write_atomically
from sfmrl.runs.folders import OLD, WEIGHTS, unfinished

MODELS = Path(__file__).parent.parent / "models"


def weights_file(network: FastNetwork, config: Config) -> bytes:
    """The bytes of a weights file (.npz): a network, and the config it was trained under."""
    buffer = io.BytesIO()
    np.savez(buffer, config=config.to_json(), **network.state_dict())
    return buffer.getvalue()


def save_weights(network: FastNetwork, config: Config, path: Path) -> str:
    """Write a weights file (.npz) with a network and the config it was trained under; returns its SHA-256."""
    return write_atomically(path, weights_file(network, config))


def load_weights(path: Path) -> tuple[FastNetwork, Config]:
    """Load the network and config of a weights file, or of a CrowdNav SARL checkpoint.

    A checkpoint gets a config with CrowdNav's reward and the paper's preset. A file that is listed in its folder's
    SHA256SUMS must match its digest there. Raises DamagedFile, or ConfigError if the file holds no such network.
    """
    path = Path(path)
    content = _content(read_listed(path), path)
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


def _content(data: bytes, path: Path) -> Any:
    """Read the bytes of a file: {"weights": ..., "config": ...} if it is sfmrl's, otherwise what torch reads."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            own = "config.npy" in archive.namelist()
        if own:
            with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
                weights = {name: arrays[name] for name in arrays.files if name != "config"}
                return {"weights": weights, "config": str(arrays["config"])}
    except Exception:  # damaged or foreign bytes can raise anything in zipfile and NumPy
        pass
    return read_foreign(data, path)


def network_from(parameters: Any, source: str, value_prior: bool = False) -> FastNetwork:
    """Make a network from its parameters: sfmrl's, or those of a CrowdNav SARL checkpoint, wrapped or not.

    The shapes of the parameters decide the sizes of the layers. Raises ConfigError, naming `source`, if they are not a
    SARL network's (it names the first layer that differs) or not finite.
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


def find_weights(name_or_path: str | Path) -> Path:
    """Find the weights file of a model's name, a run folder, the output folder of CrowdNav's training, or a path.

    Raises ConfigError if there is none, DamagedFile if a model or a run's run.json or config.json has been changed.
    """
    models = model_names()
    path = model_weights(str(name_or_path)) if str(name_or_path) in models else Path(name_or_path)
    if not path.exists():
        known = [*POLICIES, *models]
        raise ConfigError(
            f"there is no policy {name_or_path}; name {', '.join(POLICIES)}, a model (see sfmrl models), a run folder "
            f"or a weights file{suggest(path, known)}"
        )
    if not path.is_dir():
        return path
    if (path / CHECKPOINT).exists() and not (path / "run.json").exists():
        return path / CHECKPOINT
    if not any((path / name).exists() for name in ("run.json", WEIGHTS, OLD[0])):
        raise ConfigError(f"{path} is not a run folder: it has neither run.json nor {WEIGHTS}; name one that has")
    for name in ("run.json", "config.json") if (path / "run.json").exists() else ():
        read_checked(path / name)
    for name in (WEIGHTS, OLD[0]):
        if (path / name).exists():
            return path / name
    raise ConfigError(unfinished(path))


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


def model_weights(name: str) -> Path:
    """The weights file of a network that comes with sfmrl; raises DamagedFile if its digest is not the card's."""
    path = MODELS / f"{name}.npz"
    if not path.exists() or digest_of(path) != model_card(name).get("sha256"):
        raise DamagedFile(f"{path} is not what sfmrl came with; install sfmrl again")
    return path
