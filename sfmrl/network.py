"""SARL: attention over the elements around the robot, and the value of the situation.

The value network of Chen et al., "Crowd-Robot Interaction" (2019), as a plain torch module with CrowdNav's parameter
names, so that its SARL checkpoints load. This is the definition; `sfmrl.fast` computes the same in NumPy, for playing
and learning. Left out: the local map.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn

from sfmrl.fast.network import AT_GOAL, PER_METRE, PRIOR
from sfmrl.fast.parameters import Sizes, drawn_parameters
from sfmrl.states import column_names, own_columns


class ValueNetwork(nn.Module):
    """The value of robot-centred states: (B, K, F) -> (B,), F = 13 or, with `forces`, 17.

    An absent element is a row with NaN in its own columns. With `value_prior` the value is computed as
    0.9^(goal distance - 0.3) (0.8 + network), so that it decreases with distance before any training. `sizes` are the
    numbers of units; the parameters are drawn from `seed`.
    """

    def __init__(self, forces: bool = False, value_prior: bool = False, seed: int = 0, sizes: Sizes = Sizes()) -> None:
        super().__init__()
        self.forces, self.value_prior = forces, value_prior
        self.own = own_columns(forces)
        hidden, crowd = sizes.mlp1[-1], sizes.mlp2[-1]
        self.mlp1 = _mlp(len(column_names(forces)), *sizes.mlp1).append(nn.ReLU())
        self.mlp2 = _mlp(hidden, *sizes.mlp2)
        self.attention = _mlp(2 * hidden, *sizes.attention)
        self.mlp3 = _mlp(self.own + crowd, *sizes.mlp3)
        drawn = drawn_parameters(forces, seed, sizes)
        self.load_state_dict({name: torch.from_numpy(value) for name, value in drawn.items()})

    def forward(self, states: Tensor) -> Tensor:
        """Values (B,) of states (B, K, F)."""
        here = ~states[..., self.own].isnan()  # (B, K)
        hidden = self.mlp1(states.where(here[..., None], 0.0))  # (B, K, 100)
        mean = _masked_mean(hidden, here)  # (B, 1, 100), the crowd as a whole
        score = self.attention(torch.cat((hidden, mean.expand_as(hidden)), -1))[..., 0]  # (B, K)
        share = _masked_softmax(score, here)  # (B, K), attention
        crowd = (share[..., None] * self.mlp2(hidden)).sum(1)  # (B, 50)
        value = self.mlp3(torch.cat((states[:, 0, : self.own], crowd), 1))[:, 0]  # (B,)
        if self.value_prior:
            beyond = (states[:, 0, 0] - float(AT_GOAL)).clamp(min=0.0)  # m to go
            value = float(PER_METRE) ** beyond * (float(PRIOR) + value)
        return value


def _mlp(width: int, *sizes: int) -> nn.Sequential:
    """Linear layers with ReLUs in between."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise((width, *sizes)):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def _masked_mean(x: Tensor, here: Tensor) -> Tensor:
    """The mean (B, 1, C) over the elements that are `here`; zeros if none is."""
    return (x * here[..., None]).sum(1, keepdim=True) / here.sum(1).clamp(min=1)[:, None, None]


def _masked_softmax(score: Tensor, here: Tensor) -> Tensor:
    """The softmax (B, K) over the elements that are `here`; zeros if none is."""
    return torch.softmax(score.masked_fill(~here, -1e30), 1) * here
