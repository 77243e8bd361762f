"""The gradient that is written out, against autograd, and what must not matter to it."""

import pytest
import torch
from test_network import OTHER_SIZES, random_states
from torch.nn.functional import mse_loss

from sfmrl.gradients import Gradients, loss_and_gradients
from sfmrl.network import Sizes, ValueNetwork

BATCHES = (1, 8, 37, 100, 200)  # 370 rows are many enough, and odd enough when halved


def batch(network: ValueNetwork, count: int, elements: int = 10, absent: bool = False) -> tuple[torch.Tensor, ...]:
    states = random_states(count, elements, network.forces, seed=count)
    states[..., 0] = abs(states[..., 0]) * 4  # metres to the goal
    if absent:
        states[::3, 1:4, network.own :] = float("nan")
        states[-1, :, network.own :] = float("nan")  # nobody at all
    values = torch.rand(count, generator=torch.Generator().manual_seed(count))
    return torch.from_numpy(states), values


def by_autograd(network: ValueNetwork, states: torch.Tensor, values: torch.Tensor) -> tuple[torch.Tensor, Gradients]:
    loss = mse_loss(network(states), values)
    names, parameters = zip(*network.named_parameters(), strict=True)
    return loss.detach(), dict(zip(names, torch.autograd.grad(loss, parameters), strict=True))


@pytest.mark.parametrize("absent", [False, True], ids=["all there", "some absent"])
@pytest.mark.parametrize(
    ("forces", "value_prior", "sizes"),
    [(False, False, Sizes()), (True, False, Sizes()), (False, True, Sizes()), (True, False, OTHER_SIZES)],
)
@pytest.mark.parametrize("count", BATCHES)
def test_the_gradient_is_autograd_s(count, forces, value_prior, sizes, absent):
    network = ValueNetwork(forces, value_prior, seed=count, sizes=sizes)
    states, values = batch(network, count, absent=absent)
    loss, found = loss_and_gradients(network, states, values)
    expected_loss, expected = by_autograd(network, states, values)
    torch.testing.assert_close(loss, expected_loss)
    assert found.keys() == expected.keys()
    for name, gradient in expected.items():
        size = float(gradient.abs().max())
        torch.testing.assert_close(found[name], gradient, rtol=1e-3, atol=1e-5 * size + 1e-8, msg=name)


@pytest.mark.parametrize("absent", [False, True], ids=["all there", "some absent"])
@pytest.mark.parametrize("count", BATCHES)
def test_bfloat16_changes_the_gradient_by_its_rounding_alone(count, absent):
    """The whole gradient points the same way; single parameters may differ by bfloat16's two to three digits."""
    exact, low = ValueNetwork(value_prior=True, seed=4), ValueNetwork(value_prior=True, seed=4, precision="bf16")
    states, values = batch(exact, count, absent=absent)
    loss, expected = loss_and_gradients(exact, states, values)
    low_loss, found = loss_and_gradients(low, states, values)
    one, other = (torch.cat([part.view(-1) for part in whole.values()]) for whole in (expected, found))
    assert all(gradient.dtype == torch.float32 for gradient in found.values())
    assert float(low_loss) == pytest.approx(float(loss), rel=0.02)
    assert float(torch.nn.functional.cosine_similarity(one, other, dim=0)) > 0.999
    assert float((one - other).norm() / one.norm()) < 0.05


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
@pytest.mark.parametrize("count", [*BATCHES, 36, 52, 60, 104])
def test_the_gradient_has_the_same_bits_on_one_thread_and_on_two(count, precision):
    network = ValueNetwork(value_prior=True, seed=count, precision=precision)
    states, values = batch(network, count)
    results = []
    for threads in (1, 2, 1, 2):
        torch.set_num_threads(threads)
        loss, found = loss_and_gradients(network, states, values)
        results.append((loss, {name: gradient.clone() for name, gradient in found.items()}))
    torch.set_num_threads(1)
    for loss, found in results[1:]:
        assert torch.equal(loss, results[0][0])
        assert [name for name in found if not torch.equal(found[name], results[0][1][name])] == []


def test_descent_on_one_batch_fits_it_in_either_precision():
    for precision in ("fp32", "bf16"):
        network = ValueNetwork(seed=1, precision=precision)
        states, values = batch(network, 40)
        optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
        losses = []
        for _ in range(150):
            loss, found = loss_and_gradients(network, states, values)
            for name, parameter in network.named_parameters():
                parameter.grad = found[name]
            optimizer.step()
            losses.append(float(loss))
        assert losses[-1] < 0.05 * losses[0], precision
