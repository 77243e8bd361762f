"""The network's gradient, written out: the same numbers as torch's autograd, with fewer and larger operations.

Names as in `network.Trace`; the loss's gradient by a layer's output is called by the layer's name with `d_` before it.
A gradient of parameters is a sum over rows. It is taken as two halves side by side, so that it has the same bits on one
thread and on several, which would otherwise split the rows among themselves.
"""

import torch
from torch import Tensor

from sfmrl.network import PRIOR, ValueNetwork

Gradients = dict[str, Tensor]
RELU_BACKWARD = torch.ops.aten.threshold_backward.grad_input  # has no name in torch itself
MANY = 256  # rows that threads would split among themselves


@torch.inference_mode()
def loss_and_gradients(network: ValueNetwork, states: Tensor, values: Tensor) -> tuple[Tensor, Gradients]:
    """The mean squared error of the values (B,) of states (B, K, F), and its gradient by each parameter's name.

    The gradients are the parts of `network.flat.grad`, where the next call overwrites them.
    """
    if len(states) == 1:  # the same twice, since the products of a single row depend on the number of threads
        states, values = states.repeat(2, 1, 1), values.repeat(2)
    trace = network.trace(states)
    batch, elements = trace.share.shape
    weights, low, found = network.tensors, network.low, network.gradients
    (per_first, per_hidden), (per_feature, _), (per_score, *_) = network.sizes[:3]

    def through(name: str, d_output: Tensor, inputs: Tensor, out: Tensor | None = None) -> Tensor:
        """Note a layer's gradients, and return the one by its inputs, written to `out` if that has its size."""
        out = None if out is None or out.shape[1] != inputs.shape[1] else out
        _by_weight(d_output, inputs, found[name + ".weight"])
        _by_bias(d_output, found[name + ".bias"])
        weight = (weights if d_output.dtype == torch.float32 else trace.low_weights)[name + ".weight"]
        return torch.mul(d_output, weight, out=out) if len(weight) == 1 else torch.mm(d_output, weight, out=out)

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
        _by_bias(d_summary * trace.here.sum(1).clamp(max=1.0), found["mlp2.2.bias"])

    # From here on, what is not needed any more makes room for what is new: it is still in the processor's cache.
    share, feature = trace.share, trace.feature.view(batch, elements, per_feature)
    room = trace.first.new_empty(batch * elements, max(per_first, per_feature))
    d_feature = room.view(-1)[: feature.numel()].view_as(feature)
    d_share = torch.mul(feature, d_pooled, out=d_feature).sum(2).float()
    d_score = share * (d_share - (share * d_share).sum(1, keepdim=True))
    torch.mul(share.to(low)[..., None], d_pooled, out=d_feature)
    d_feature = _relu(d_feature.view(-1, per_feature), trace.feature)
    d_score_2 = through("attention.4", d_score.to(low).view(-1, 1), trace.score_2, out=trace.feature)
    d_score_2 = _relu(d_score_2, trace.score_2)
    found["attention.4.bias"].zero_()  # the softmax sees no shift
    d_score_1 = _relu(through("attention.2", d_score_2, trace.score_1, out=trace.score_2), trace.score_1)

    # Attention's first layer: a half by element, a half by state.
    d_both = d_score_1.view(batch, elements, per_score).sum(1).float()
    _by_weight(d_score_1, trace.hidden, found["attention.0.weight"][:, :per_hidden])
    _by_weight(d_both, trace.mean, found["attention.0.weight"][:, per_hidden:])
    _by_bias(d_both, found["attention.0.bias"])
    d_mean = d_both @ weights["attention.0.weight"][:, per_hidden:]
    d_hidden = through("mlp2.0", d_feature, trace.hidden, out=d_score_2)
    d_hidden.addmm_(d_score_1, trace.low_weights["attention.0.weight"][:, :per_hidden])
    if trace.here is None:
        d_hidden.view(batch, elements, -1).add_((d_mean / elements).to(low)[:, None])
    else:
        part = trace.here / trace.here.sum(1, keepdim=True).clamp(min=1.0)
        d_hidden.view(batch, elements, -1).add_((part * d_mean[:, None]).to(low))

    d_first = through("mlp1.2", _relu(d_hidden, trace.hidden), trace.first, out=room)
    d_first = _relu(d_first, trace.first).float()
    _by_weight(d_first, trace.rows, found["mlp1.0.weight"])
    _by_bias(d_first, found["mlp1.0.bias"])
    return (error * error).mean(), found


def _relu(gradient: Tensor, output: Tensor) -> Tensor:
    """The gradient by a ReLU's input, written over that by its output: zero where the output is, which is lost."""
    if gradient.dtype == torch.bfloat16:  # as integers, see `network.relu_`
        gradient.view(torch.int16).mul_(output.view(torch.int16).clamp_(max=1))
        return gradient
    return RELU_BACKWARD(gradient, output, 0, grad_input=gradient)


def _by_bias(d_output: Tensor, out: Tensor) -> None:
    """Write a layer's gradient by its bias (out,) to `out`, from that by its output (N, out)."""
    if d_output.dtype == out.dtype:
        torch.sum(d_output, 0, out=out)
    else:
        out.copy_(d_output.sum(0))


def _by_weight(d_output: Tensor, inputs: Tensor, out: Tensor) -> None:
    """Write a layer's gradient by its weights (out, in) to `out`, from that by its output (N, out) and its inputs."""
    if len(inputs) < MANY:
        out.copy_(d_output.t() @ inputs)
        return
    half, odd = divmod(len(inputs), 2)
    d, x = (d_output[:-1], inputs[:-1]) if odd else (d_output, inputs)
    parts = torch.bmm(d.view(2, half, -1).transpose(1, 2), x.view(2, half, -1))
    if odd:
        parts[0] += parts[1]
        parts[1] = d_output[-1:].t() * inputs[-1:]
    torch.add(parts[0], parts[1], out=out)
