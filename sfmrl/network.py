"""SARL: attention over the elements around the robot, and one number for what the situation is worth.

The value network of Chen et al., "Crowd-Robot Interaction" (2019), with CrowdNav's parameter names, so that its SARL
checkpoints load: each element's row goes through mlp1; its feature (mlp2) is weighted by a score (attention) that sees
the element and the mean of all; the weighted sum joins the robot's own columns in mlp3. Left out: the local map.
"""

import io
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import linear, relu

from sfmrl.config import Config, ConfigError
from sfmrl.files import read_checked, read_sums, write_atomically
from sfmrl.states import OWN, column_names

MLP1, MLP2, ATTENTION, MLP3 = (150, 100), (100, 50), (100, 100, 1), (150, 100, 100, 1)

PER_METRE, AT_GOAL, PRIOR = (
    0.9,
    0.3,
    0.8,
)  # of `value_prior`: fall-off, distance at which the goal counts as reached (m)


class ValueNetwork(nn.Module):
    """The value of robot-centred states: (B, K, F) -> (B,), F = 13 or, with `forces`, 17.

    An absent element is a row with NaN in its own columns. With `value_prior` the value is written as
    0.9^(goal distance - 0.3) (0.8 + network), so that it falls off with distance from the start. Parameters are drawn
    as torch's own layers do, from `seed`.
    """

    def __init__(self, forces: bool = False, value_prior: bool = False, seed: int = 0) -> None:
        super().__init__()
        self.forces, self.value_prior = forces, value_prior
        self.own = len(OWN) + 2 * forces  # how many of the columns are the robot's own
        generator = torch.Generator().manual_seed(seed)
        width = len(column_names(forces))
        self.mlp1 = _mlp(width, MLP1, generator, last_relu=True)
        self.mlp2 = _mlp(MLP1[-1], MLP2, generator)
        self.attention = _mlp(2 * MLP1[-1], ATTENTION, generator)
        self.mlp3 = _mlp(self.own + MLP2[-1], MLP3, generator)

    def forward(self, states: Tensor) -> Tensor:
        """Values (B,) of states (B, K, F)."""
        value = self._output_and_attention(states)[0]
        if self.value_prior:
            value = PER_METRE ** (states[:, 0, 0] - AT_GOAL).clamp(min=0.0) * (PRIOR + value)
        return value

    def _output_and_attention(self, states: Tensor) -> tuple[Tensor, Tensor]:
        """The last layer's output (B,), and the share of attention each element gets (B, K), 0 for absent ones."""
        batch, elements, width = states.shape
        own = states[:, 0, : self.own] if elements else states.new_zeros(batch, self.own)
        absent = torch.isnan(states[..., self.own])  # (B, K)
        all_here = elements > 0 and not bool(absent.any())
        if not all_here:
            states = torch.where(absent[..., None], 0.0, states)
        hidden = relu(self.mlp1[0](states.reshape(-1, width)), inplace=True)
        hidden = relu(self.mlp1[2](hidden), inplace=True)  # (B K, 100)
        feature = relu(self.mlp2[0](hidden), inplace=True).view(batch, elements, MLP2[0])  # (B, K, 100)

        per_element = hidden.view(batch, elements, MLP1[-1])
        if all_here:
            mean = per_element.mean(1)  # (B, 100)
        else:
            here = (~absent).to(states.dtype)[..., None]
            mean = (per_element * here).sum(1) / here.sum(1).clamp(min=1.0)
        # The first attention layer reads [element, mean]: the mean's half is the same for all elements of a state.
        first = self.attention[0]
        for_element, for_mean = first.weight.split(MLP1[-1], dim=1)
        score = linear(hidden, for_element).view(batch, elements, ATTENTION[0])
        score = relu(score + linear(mean, for_mean, first.bias)[:, None], inplace=True)  # (B, K, 100)
        score = self.attention[4](relu(self.attention[2](score), inplace=True))[..., 0]  # (B, K)
        if all_here:
            share = score.softmax(1)
        else:
            share = score.masked_fill(absent, -torch.inf).softmax(1).nan_to_num()  # nobody there at all: zeros
        # mlp2's last layer is linear, so it may follow the weighted sum: once a state instead of once an element.
        pooled = linear((share[:, None] @ feature)[:, 0], self.mlp2[2].weight)
        pooled = pooled + share.sum(1, keepdim=True) * self.mlp2[2].bias  # (B, 50)

        return self.mlp3(torch.cat((own, pooled), 1))[:, 0], share

    @torch.inference_mode()
    def evaluate(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (B,) and shares of attention (B, K) of states (B, K, F), from array to arrays, without gradients.

        A state's numbers do not depend on what shares its batch. For that the batch is filled up to a multiple of four
        states, at least eight, since matrix products treat a remainder of rows, or very few, in another way; and the
        power is NumPy's, since torch's has other bits in a remainder.
        """
        device = self.mlp1[0].weight.device
        count = len(states)
        if count < 8 or count % 4:
            filled = np.zeros((max(count + -count % 4, 8), *states.shape[1:]), dtype=np.float32)
            filled[:count] = states
        else:
            filled = states
        output, share = self._output_and_attention(torch.from_numpy(filled).to(device))
        value, share = output[:count].cpu().numpy(), share[:count].cpu().numpy()
        if self.value_prior:
            beyond = np.maximum(states[:, 0, 0] - np.float32(AT_GOAL), np.float32(0))
            value = np.float32(PER_METRE) ** beyond * (np.float32(PRIOR) + value)
        return value, share


def _mlp(width: int, sizes: tuple[int, ...], generator: torch.Generator, last_relu: bool = False) -> nn.Sequential:
    """Linear layers with ReLUs in between, drawn uniformly within 1 / sqrt(fan in) as torch does by default."""
    layers: list[nn.Module] = []
    for size in sizes:
        layer = nn.utils.skip_init(nn.Linear, width, size)
        bound = width**-0.5
        with torch.no_grad():
            layer.weight.uniform_(-bound, bound, generator=generator)
            layer.bias.uniform_(-bound, bound, generator=generator)
        layers += [layer, nn.ReLU(inplace=True)]
        width = size
    return nn.Sequential(*layers if last_relu else layers[:-1])


def network_from(state_dict: dict[str, Tensor], source: str, value_prior: bool = False) -> ValueNetwork:
    """The network whose parameters these are: sfmrl's own, or those of a CrowdNav SARL checkpoint.

    Raises ConfigError, naming `source`, where they are not a SARL network's.
    """
    if not isinstance(state_dict, dict):
        raise ConfigError(f"{source} does not hold a SARL network but a {type(state_dict).__name__}")
    for forces in (False, True):
        network = ValueNetwork(forces, value_prior)
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
        raise ConfigError(f"{path} is not a weights file that torch can load safely") from error
    if isinstance(content, dict) and {"weights", "config"} <= set(content):
        try:
            config = Config.from_json(content["config"])
        except ConfigError as error:
            raise ConfigError(f"the config in {path} cannot be used: {error}") from error
        return network_from(content["weights"], str(path), config.value_prior), config
    network = network_from(content, str(path))
    return network, Config(preset="paper", forces=network.forces)
