"""Networks in files: sfmrl's own, which hold the config too, and CrowdNav's SARL checkpoints."""

import io
from pathlib import Path

import torch
from torch import Tensor

from sfmrl.config import Config, ConfigError
from sfmrl.files import read_checked, read_sums, write_atomically
from sfmrl.network import ValueNetwork


def network_from(
    state_dict: dict[str, Tensor], source: str, value_prior: bool = False, precision: str = "fp32"
) -> ValueNetwork:
    """The network whose parameters these are: sfmrl's own, or those of a CrowdNav SARL checkpoint.

    Raises ConfigError, naming `source`, where they are not a SARL network's.
    """
    if not isinstance(state_dict, dict):
        raise ConfigError(f"{source} does not hold a SARL network but a {type(state_dict).__name__}")
    for forces in (False, True):
        network = ValueNetwork(forces, value_prior, precision=precision)
        wanted = {name: value.shape for name, value in network.state_dict().items()}
        if wanted == {name: getattr(value, "shape", None) for name, value in state_dict.items()}:
            network.load_state_dict(state_dict)
            return network
    first = getattr(state_dict.get("mlp1.0.weight"), "shape", None)
    what = f"mlp1.0.weight is {tuple(first)}, not (150, 13) or (150, 17)" if first else "there is no mlp1.0.weight"
    raise ConfigError(f"{source} does not hold a SARL network without local map: {what}, or other layers differ")


def save_weights(network: ValueNetwork, config: Config, path: Path) -> str:
    """Write a network and the config it was trained under to a file of their own; returns its SHA-256."""
    content = {"weights": network.state_dict(), "config": config.to_json()}
    return write_atomically(path, lambda file: torch.save(content, file))


def load_weights(path: Path) -> tuple[ValueNetwork, Config]:
    """The network and config of a weights file; for a CrowdNav checkpoint, CRI's reward under the paper's preset.

    A file listed in its folder's SHA256SUMS is held to it. Raises DamagedFile, or ConfigError where there is no such
    network in the file.
    """
    path = Path(path)
    data = read_checked(path) if path.name in read_sums(path.parent) else path.read_bytes()
    try:
        content = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # torch's reader raises whatever the bytes lead it to
        raise ConfigError(
            f"{path} is not a weights file that torch can load safely; name a run folder, or its weights.pt"
        ) from error
    if isinstance(content, dict) and {"weights", "config"} <= set(content):
        try:
            config = Config.from_json(content["config"])
        except ConfigError as error:
            raise ConfigError(f"the config in {path} cannot be used: {error}") from error
        # A processor without bfloat16 only has to imitate it, which is slow: it plays in float32 what others trained.
        precision = "auto" if config.precision == "bf16" else config.precision
        return network_from(content["weights"], str(path), config.value_prior, precision), config
    network = network_from(content, str(path))
    return network, Config(preset="paper", forces=network.forces)
