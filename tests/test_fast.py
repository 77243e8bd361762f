"""The network in NumPy against autograd of its definition; a value's bits do not depend on its batch."""

import os
import pickle
import subprocess
import sys
from copy import copy, deepcopy

import numpy as np
import pytest
import torch
from conftest import environment
from test_network import OTHER_SIZES, random_states
from torch.nn.functional import mse_loss

from sfmrl.fast import FastNetwork, Sizes, as_fast, kernels
from sfmrl.fast.parameters import layer_shapes
from sfmrl.network import ValueNetwork


def batch(network: ValueNetwork, count: int, elements: int, absent: bool) -> tuple[np.ndarray, np.ndarray]:
    states = random_states(count, elements, network.forces, seed=count)
    states[..., 0] = abs(states[..., 0]) * 4  # metres to the goal
    if absent:
        states[::3, 1:4, network.own :] = np.nan
        states[-1, :, network.own :] = np.nan  # nobody at all
    return states, np.random.default_rng(count).random(count, dtype=np.float32)


@pytest.mark.parametrize("absent", [False, True], ids=["all there", "some absent"])
@pytest.mark.parametrize(
    ("forces", "value_prior", "elements", "sizes"),
    [(False, False, 10, Sizes()), (True, False, 4, Sizes()), (False, True, 5, OTHER_SIZES)],
)
@pytest.mark.parametrize("count", [1, 8, 37, 100])
def test_values_and_gradients_are_autograd_s_of_the_definition(count, forces, value_prior, elements, sizes, absent):
    network = ValueNetwork(forces, value_prior, count, sizes)
    states, values = batch(network, count, elements, absent)
    defined = network(torch.from_numpy(states))
    loss = mse_loss(defined, torch.from_numpy(values))
    names, parameters = zip(*network.named_parameters(), strict=True)
    expected = dict(zip(names, torch.autograd.grad(loss, parameters), strict=True))
    fast = as_fast(network)
    assert {name: value.shape for name, value in fast.state_dict().items()} == layer_shapes(forces, sizes)
    np.testing.assert_allclose(fast.evaluate(states)[0], defined.detach().numpy(), rtol=1e-5, atol=1e-6)
    found_loss, found = fast.loss_and_gradients(states, values)
    assert found_loss == pytest.approx(float(loss.detach()), rel=1e-5)
    assert list(found) == list(expected)
    for name, gradient in expected.items():
        size = float(gradient.abs().max())
        np.testing.assert_allclose(found[name].T, gradient, rtol=1e-3, atol=1e-5 * size + 1e-8, err_msg=name)


def test_parameters_are_parts_of_one_array_and_copies_have_their_own():
    network = as_fast(ValueNetwork(value_prior=True, seed=2))
    states = random_states(8, 4)
    before = network.evaluate(states)[0]
    for copied in (copy(network), deepcopy(network), pickle.loads(pickle.dumps(network))):
        np.testing.assert_array_equal(copied.evaluate(states)[0], before)
        copied.flat[:] = 0.0
        assert not any(parameter.any() for parameter in copied.parameters.values())
        np.testing.assert_array_equal(network.evaluate(states)[0], before)


def test_episodes_of_states_have_the_values_of_single_states():
    network = as_fast(ValueNetwork(seed=3))
    states = random_states(5 * 81, 7)
    value, share = network.evaluate(states.reshape(5, 81, 7, 13))
    np.testing.assert_allclose(value.ravel(), network.evaluate(states)[0], rtol=1e-5, atol=1e-6)
    assert (value.shape, share.shape) == ((5, 81), (5, 81, 7))


def differing(network: FastNetwork, states: np.ndarray, sizes: tuple[int, ...]) -> list[tuple[int, int]]:
    """Sizes and beginnings of batches, cut from states (B, ...), in which a value has other bits than in the whole."""
    whole = network.evaluate(states)
    found = []
    for size in sizes:
        for first in {0, 1, 5, len(states) // 2, len(states) - size}:
            part = network.evaluate(states[first : first + size])
            if not all(np.array_equal(a, b[first : first + size]) for a, b in zip(part, whole, strict=True)):
                found.append((size, first))
    return found


@pytest.mark.parametrize(("forces", "elements"), [(False, 1), (False, 10), (True, 4), (False, 7)])
def test_a_value_has_the_same_bits_whatever_shares_its_batch(forces, elements):
    network = as_fast(ValueNetwork(forces, value_prior=True))
    states = random_states(40 * 81, elements, forces)
    states[..., 0] = np.random.default_rng(1).uniform(0, 9, (len(states), 1))  # goal distances, in metres
    states[::5, elements // 2 :, network.own :] = np.nan
    assert differing(network, states[:700], (1, 2, 3, 7, 8, 31, 81, 162, 511)) == []
    assert differing(network, states.reshape(40, 81, *states.shape[1:]), (1, 2, 3, 4, 7, 13, 32)) == []


@pytest.mark.skipif(kernels() == "unknown", reason="NumPy without OpenBLAS")
def test_with_the_processor_s_own_kernels_and_threads_the_bits_do_not_depend_on_the_batch_either():
    """This machine's settings may choose other kernels, or start OpenBLAS with one thread."""
    around = {name: value for name, value in environment().items() if not name.startswith(("OPENBLAS", "OMP"))}
    code = (
        "import numpy, sfmrl.fast, test_fast as t\n"
        "assert sfmrl.fast.blas._openblas('get_num_threads')() == 1\n"
        "for wide, elements in ((False, 1), (False, 5), (False, 10), (True, 4)):\n"
        "    t.test_a_value_has_the_same_bits_whatever_shares_its_batch(wide, elements)"
    )
    around["PYTHONPATH"] += os.pathsep + os.path.dirname(__file__)
    done = subprocess.run([sys.executable, "-c", code], env=around, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
