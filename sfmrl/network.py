"""SARL: attention over the elements around the robot, and one number for what the situation is worth.

The value network of Chen et al., "Crowd-Robot Interaction" (2019), with CrowdNav's parameter names, so that its SARL
checkpoints load: each element's row goes through mlp1; its feature (mlp2) is weighted by a score (attention) that sees
the element and the mean of all; the weighted sum joins the robot's own columns in mlp3. Left out: the local map.

Two things are arranged for speed. Attention's first layer reads [element, mean]: the mean's half is the same for all
elements of a state, so it is computed once. And mlp2's last layer is linear, so it may follow the weighted sum.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from sfmrl.config import Config
from sfmrl.states import OWN, column_names


class Sizes(NamedTuple):
    """How many units each layer has; the defaults are the paper's and CrowdNav's."""

    mlp1: tuple[int, int] = (150, 100)
    mlp2: tuple[int, int] = (100, 50)
    attention: tuple[int, int, int] = (100, 100, 1)
    mlp3: tuple[int, int, int, int] = (150, 100, 100, 1)


# Of `value_prior`: the fall-off per metre, and the distance at which the goal counts as reached, m.
PER_METRE, AT_GOAL, PRIOR = 0.9, 0.3, 0.8

LEAST, TINY = -1e30, 1e-30  # a score below all, and a number that makes 0 of 0 / 0


def _fused() -> Callable[..., Tensor] | None:
    """A layer with ReLU by oneDNN, which torch has no public name for; None where it does not compute here."""
    try:
        one = torch.zeros(1, 1, dtype=torch.bfloat16)
        torch.ops.mkldnn._linear_pointwise(one, one, one[0], "relu", [], "")
    except (AttributeError, RuntimeError):
        return None
    return torch.ops.mkldnn._linear_pointwise


FUSED = _fused()


class Trace(NamedTuple):
    """What every layer gives on the way from states (B, K, F) to values; N = B K rows, one an element.

    Shapes are those of the default `Sizes`.
    """

    rows: Tensor  # (N, F)
    here: Tensor | None  # (B, K, 1), 1 where the element is there and 0 where it is absent; None: all are there
    first: Tensor  # (N, 150), mlp1's first layer; from here to score_2 all are in the network's `precision`
    hidden: Tensor  # (N, 100), mlp1
    feature: Tensor  # (N, 100), mlp2 up to its last layer
    mean: Tensor  # (B, 100), of the hidden rows of a state
    score_1: Tensor  # (N, 100), attention's first layer
    score_2: Tensor  # (N, 100), its second
    share: Tensor  # (B, K), the share of attention each element gets, 0 for absent ones
    pooled: Tensor  # (B, 100), the features' sum by share
    joint: Tensor  # (B, 56) or (B, 58), the robot's own columns and mlp2's last layer
    last: tuple[Tensor, Tensor, Tensor]  # (B, 150), (B, 100), (B, 100), mlp3 up to its last layer
    output: Tensor  # (B,)
    low_weights: dict[str, Tensor]  # what `low_tensors` gave


class ValueNetwork(nn.Module):
    """The value of robot-centred states: (B, K, F) -> (B,), F = 13 or, with `forces`, 17.

    An absent element is a row with NaN in its own columns. With `value_prior` the value is written as
    0.9^(goal distance - 0.3) (0.8 + network), so that it falls off with distance from the start. Parameters are drawn
    as torch's own layers do, from `seed`. They are float32 in any `precision`; in "bf16", the layers with a row an
    element, but for the first, compute in bfloat16 ("auto": where the processor has it).
    """

    def __init__(
        self,
        forces: bool = False,
        value_prior: bool = False,
        seed: int = 0,
        precision: str = "fp32",
        sizes: Sizes = Sizes(),
    ) -> None:
        super().__init__()
        self.sizes = sizes
        self.forces, self.value_prior, self.precision = forces, value_prior, resolved(precision)
        self.own = len(OWN) + 2 * forces  # how many of the columns are the robot's own
        generator = torch.Generator().manual_seed(seed)
        width = len(column_names(forces))
        self.mlp1 = _mlp(width, sizes.mlp1, generator, last_relu=True)
        self.mlp2 = _mlp(sizes.mlp1[-1], sizes.mlp2, generator)
        self.attention = _mlp(2 * sizes.mlp1[-1], sizes.attention, generator)
        self.mlp3 = _mlp(self.own + sizes.mlp2[-1], sizes.mlp3, generator)
        self._lay_out()

    def _lay_out(self) -> None:
        """Put all parameters into one long tensor, `flat`, and their gradients into its `grad`, so that an optimizer's
        step is a single operation."""
        self.tensors = dict(self.named_parameters())  # at hand: nn.Module takes its time to look them up
        self.flat = torch.cat([parameter.detach().reshape(-1) for parameter in self.tensors.values()])
        self.flat.grad = torch.zeros_like(self.flat)
        self.gradients = self._parts(self.flat.grad)
        for name, part in self._parts(self.flat).items():
            self.tensors[name].data = part
        self._low_flat = self.flat.to(self.low)
        self._low = self._parts(self._low_flat)

    def _parts(self, flat: Tensor) -> dict[str, Tensor]:
        """What belongs to each parameter in a tensor that is laid out like `flat`, by name."""
        parts = flat.split([parameter.numel() for parameter in self.tensors.values()])
        return {name: part.view_as(self.tensors[name]) for name, part in zip(self.tensors, parts, strict=True)}

    def _apply(self, *args, **options):
        """What `to` and its like do, after which the parameters are tensors of their own."""
        super()._apply(*args, **options)
        self._lay_out()
        return self

    def __deepcopy__(self, memo) -> "ValueNetwork":
        copy = ValueNetwork(self.forces, self.value_prior, precision=self.precision, sizes=self.sizes).to(self.device)
        copy.load_state_dict(self.state_dict())
        return copy

    def forward(self, states: Tensor) -> Tensor:
        """Values (B,) of states (B, K, F)."""
        output = self.trace(states).output
        return self.scale(states) * (PRIOR + output) if self.value_prior else output

    @property
    def device(self) -> torch.device:
        """Where the parameters are."""
        return self.tensors["mlp1.0.weight"].device

    @property
    def low(self) -> torch.dtype:
        """The type of the layers between the first with a row an element and the last."""
        return torch.bfloat16 if self.precision == "bf16" else torch.float32

    def low_tensors(self) -> dict[str, Tensor]:
        """The parameters in the type `low`, by name."""
        if self.low == torch.float32:
            return self.tensors
        if torch.is_grad_enabled():
            return {name: parameter.to(self.low) for name, parameter in self.tensors.items()}
        self._low_flat.copy_(self.flat)  # if several threads do it, all write the same
        return self._low

    @staticmethod
    def scale(states: Tensor) -> Tensor:
        """What `value_prior` multiplies the output by, (B,)."""
        return PER_METRE ** (states[:, 0, 0] - AT_GOAL).clamp(min=0.0)

    def trace(self, states: Tensor) -> Trace:
        """All layers' outputs for states (B, K, F)."""
        batch, elements, width = states.shape
        own = states[:, 0, : self.own] if elements else states.new_zeros(batch, self.own)
        absent = torch.isnan(states[..., self.own])  # (B, K)
        here = None
        if not elements or bool(absent.any()):
            here = (~absent).float()[..., None]
            states = torch.where(absent[..., None], 0.0, states)
        per_hidden, per_feature, per_score = self.sizes.mlp1[-1], self.sizes.mlp2[0], self.sizes.attention[0]
        low, p, q, rows = self.low, self.tensors, self.low_tensors(), states.reshape(-1, width)

        if low == torch.float32:
            first = linear_relu(rows, p["mlp1.0.weight"], p["mlp1.0.bias"])
        else:  # numbers as large as metres need more than one bfloat16 each: what the first leaves goes into a second
            coarse = rows.to(low)
            both = torch.cat((coarse, (rows - coarse).to(low)), 1)
            first = linear_relu(both, q["mlp1.0.weight"].repeat(1, 2), q["mlp1.0.bias"])
        hidden = linear_relu(first, q["mlp1.2.weight"], q["mlp1.2.bias"])
        feature = linear_relu(hidden, q["mlp2.0.weight"], q["mlp2.0.bias"])
        count = elements if here is None else here.sum(1)  # (B, 1)
        present = hidden.new_ones(batch, 1, elements) if here is None else here.to(low).transpose(1, 2)
        total = (present @ hidden.view(batch, elements, per_hidden))[:, 0].float()
        mean = total / (count if here is None else count.clamp(min=1.0))  # (B, 100)

        for_element, for_mean = q["attention.0.weight"][:, :per_hidden], p["attention.0.weight"][:, per_hidden:]
        from_mean = linear(mean, for_mean, p["attention.0.bias"])  # (B, 100)
        score_1 = hidden.new_empty(batch, elements, per_score).copy_(from_mean[:, None]).view(-1, per_score)
        score_1 = relu_(score_1.addmm_(hidden, for_element.t()))
        score_2 = linear_relu(score_1, q["attention.2.weight"], q["attention.2.bias"])
        score = _one(score_2, q["attention.4.weight"], q["attention.4.bias"]).float()
        score = score.view(batch, elements)
        if here is not None:
            score = score.masked_fill(absent, -torch.inf)
        share = _softmax(score)

        pooled = (share.to(low)[:, None] @ feature.view(batch, elements, per_feature))[:, 0].float()
        summary = linear(pooled, p["mlp2.2.weight"])  # (B, 50)
        summary = summary + (p["mlp2.2.bias"] if here is None else count.clamp(max=1.0) * p["mlp2.2.bias"])
        joint = torch.cat((own, summary), 1)
        last_1 = linear_relu(joint, p["mlp3.0.weight"], p["mlp3.0.bias"])
        last_2 = linear_relu(last_1, p["mlp3.2.weight"], p["mlp3.2.bias"])
        last_3 = linear_relu(last_2, p["mlp3.4.weight"], p["mlp3.4.bias"])
        output = _one(last_3, p["mlp3.6.weight"], p["mlp3.6.bias"])
        last = last_1, last_2, last_3
        return Trace(rows, here, first, hidden, feature, mean, score_1, score_2, share, pooled, joint, last, output, q)

    @torch.inference_mode()
    def evaluate(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (B,) and shares of attention (B, K) of states (B, K, F), from array to arrays, without gradients.

        A state's numbers do not depend on what shares its batch. For that the batch is filled up to a multiple of four
        states, at least eight, since matrix products treat a remainder of rows, or very few, in another way; and the
        power is NumPy's, since torch's has other bits in a remainder.
        """
        count = len(states)
        if count < 8 or count % 4:
            filled = np.zeros((max(count + -count % 4, 8), *states.shape[1:]), dtype=np.float32)
            filled[:count] = states
        else:
            filled = states
        trace = self.trace(torch.from_numpy(filled).to(self.device))
        value, share = trace.output[:count].cpu().numpy(), trace.share[:count].cpu().numpy()
        if self.value_prior:
            beyond = np.maximum(states[:, 0, 0] - np.float32(AT_GOAL), np.float32(0))
            value = np.float32(PER_METRE) ** beyond * (np.float32(PRIOR) + value)
        return value, share


def linear_relu(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """A linear layer and ReLU: (N, in) -> (N, out). In bfloat16, oneDNN does both in one pass, with the same bits."""
    if FUSED is None or x.dtype != torch.bfloat16 or x.device.type != "cpu" or torch.is_grad_enabled():
        return relu_(linear(x, weight, bias))
    return FUSED(x, weight, bias, "relu", [], "")


def relu_(x: Tensor) -> Tensor:
    """ReLU in place. Without autograd to follow, numbers in bfloat16 are taken for the integers that their bits are."""
    if x.dtype != torch.bfloat16 or torch.is_grad_enabled():
        return x.relu_()
    x.view(torch.int16).clamp_(min=0)  # negative numbers are negative integers too, and integers are five times faster
    return x


def _softmax(score: Tensor) -> Tensor:
    """Shares (B, K) of scores (B, K), zeros where all are -inf: torch's own takes five times as long for such few."""
    if not score.shape[1]:
        return score
    share = torch.exp(score - score.amax(1, keepdim=True).clamp(min=LEAST))
    return share / share.sum(1, keepdim=True).clamp(min=TINY)


def _one(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """A layer with one output, (N, in) -> (N,). Computed as two: a single column is summed up in another order where
    the number of rows leaves a remainder, and so would depend on how many threads share them."""
    return linear(x, weight.expand(2, -1), bias.expand(2))[:, 0]


def resolved(precision: str) -> str:
    """The precision that "auto" stands for on this machine, "bf16" where the processor has it; others as they are."""
    if precision != "auto":
        return precision
    has = getattr(torch.cpu, "get_capabilities", dict)()
    fast = any(has.get(name) for name in ("amx_bf16", "avx512_bf16", "bf16"))
    return "bf16" if fast and FUSED is not None else "fp32"  # oneDNN may have been told to do without


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


def new_network(config: Config, seed: int = 0, sizes: Sizes = Sizes()) -> ValueNetwork:
    """The network that a config asks for, drawn from `seed`."""
    return ValueNetwork(config.forces, config.value_prior, seed, config.precision, sizes)
