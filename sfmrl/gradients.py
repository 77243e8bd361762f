"""The network's gradient, written out: the same numbers as torch's autograd, with fewer and larger operations.

Names as in `network.Trace`; the loss's gradient by a layer's output is called by the layer's name with `d_` before it.
A gradient of parameters is a sum over rows. It is taken as two halves side by side, so that it has the same bits on one
thread and on several, which would otherwise split the rows among themselves.
"""

import torch
from torch import Tensor

from sfmrl.network import ATTENTION, MLP1, MLP2, PRIOR, ValueNetwork

Gradients = dict[str, Tensor]
MANY = 256  # rows that threads would split among themselves


@torch.inference_mode()
def loss_and_gradients(network: ValueNetwork, states: Tensor, values: Tensor) -> tuple[Tensor, Gradients]:
    """The mean squared error of the values (B,) of states (B, K, F), and its gradient by each parameter's name."""
    if len(states) == 1:  # the same twice, since the products of a single row depend on the number of threads
        states, values = states.repeat(2, 1, 1), values.repeat(2)
    trace = network.trace(states)
    batch, elements = trace.share.shape
    weights, low, found = network.tensors, network.low, {}

    def through(name: str, d_output: Tensor, inputs: Tensor) -> Tensor:
        """Note a layer's gradients, and return the one by its inputs."""
        found[f"{name}.weight"] = _by_weight(d_output, inputs)
        found[f"{name}.bias"] = d_output.sum(0)
        return d_output @ weights[f"{name}.weight"].to(d_output.dtype)

    scale = network.scale(states) if network.value_prior else None
    error = (trace.output if scale is None else scale * (PRIOR + trace.output)) - values
    d_output = error * (2 / batch) if scale is None else error * scale * (2 / batch)

    last_1, last_2, last_3 = trace.last
    d_last = _relu(through("mlp3.6", d_output[:, None], last_3), last_3)
    d_last = _relu(through("mlp3.4", d_last, last_2), last_2)
    d_last = _relu(through("mlp3.2", d_last, last_1), last_1)
    d_summary = through("mlp3.0", d_last, trace.joint)[:, network.own :].contiguous()
    d_pooled = through("mlp2.2", d_summary, trace.pooled).to(low)[:, None]  # (B, 1, 100)
    if trace.here is not None:  # where nobody is, the bias has not been added either
        found["mlp2.2.bias"] = (d_summary * trace.here.sum(1).clamp(max=1.0)).sum(0)

    share, feature = trace.share, trace.feature.view(batch, elements, MLP2[0])
    d_share = (feature * d_pooled).sum(2).float()
    d_score = share * (d_share - (share * d_share).sum(1, keepdim=True))
    d_feature = _relu((share.to(low)[..., None] * d_pooled).view(-1, MLP2[0]), trace.feature)
    d_score_2 = _relu(through("attention.4", d_score.to(low).view(-1, 1), trace.score_2), trace.score_2)
    found["attention.4.bias"] = torch.zeros_like(weights["attention.4.bias"])  # the softmax sees no shift
    d_score_1 = _relu(through("attention.2", d_score_2, trace.score_1), trace.score_1)

    # Attention's first layer: a half by element, a half by state.
    by_element, by_mean = weights["attention.0.weight"].split(MLP1[-1], dim=1)
    d_both = d_score_1.view(batch, elements, ATTENTION[0]).sum(1).float()
    found["attention.0.weight"] = torch.cat((_by_weight(d_score_1, trace.hidden), _by_weight(d_both, trace.mean)), 1)
    found["attention.0.bias"] = d_both.sum(0)
    d_mean = d_both @ by_mean
    d_hidden = through("mlp2.0", d_feature, trace.hidden).addmm_(d_score_1, by_element.to(low))
    if trace.here is None:
        d_hidden.view(batch, elements, -1).add_((d_mean / elements).to(low)[:, None])
    else:
        part = trace.here / trace.here.sum(1, keepdim=True).clamp(min=1.0)
        d_hidden.view(batch, elements, -1).add_((part * d_mean[:, None]).to(low))

    d_first = _relu(through("mlp1.2", _relu(d_hidden, trace.hidden), trace.first), trace.first).float()
    found["mlp1.0.weight"], found["mlp1.0.bias"] = _by_weight(d_first, trace.rows), d_first.sum(0)
    loss = (error * error).mean()
    return loss, {name: found[name].float() for name in weights}


def _relu(gradient: Tensor, output: Tensor) -> Tensor:
    """The gradient by a ReLU's input, written over that by its output: zero where the output is."""
    if gradient.dtype == torch.bfloat16:  # as integers, see `network.relu_`
        gradient.view(torch.int16).mul_(output.view(torch.int16).sign())
        return gradient
    return torch.ops.aten.threshold_backward.grad_input(gradient, output, 0, grad_input=gradient)


def _by_weight(d_output: Tensor, inputs: Tensor) -> Tensor:
    """A layer's gradient by its weights (out, in), from that by its output (N, out) and its inputs (N, in)."""
    if len(inputs) < MANY:
        return d_output.t() @ inputs
    half = len(inputs) // 2
    halves = d_output[: 2 * half].view(2, half, -1).transpose(1, 2), inputs[: 2 * half].view(2, half, -1)
    found, other = torch.bmm(*halves)
    found += other
    if len(inputs) % 2:
        found += d_output[-1:].t() * inputs[-1:]
    return found
