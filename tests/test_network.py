"""The SARL network against CrowdNav's and a naive loop; order and absent elements do not change its value."""

import numpy as np
import pytest
import torch
from conftest import DATA
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from sfmrl.fast import Sizes, as_fast
from sfmrl.network import ValueNetwork
from sfmrl.states import OWN, column_names


@pytest.fixture(scope="module")
def crowdnav() -> dict[str, np.ndarray]:
    with np.load(DATA / "crowdnav_sarl.npz") as data:
        return dict(data)


@pytest.fixture(scope="module")
def crowdnav_weights(crowdnav) -> dict[str, torch.Tensor]:
    return {n.removeprefix("weights/"): torch.from_numpy(v) for n, v in crowdnav.items() if n.startswith("weights/")}


def random_states(count: int, elements: int, forces: bool = False, seed: int = 0) -> np.ndarray:
    """States (B, K, F) with the robot's own columns alike in every row of an episode."""
    states = np.random.default_rng(seed).normal(size=(count, elements, len(column_names(forces)))).astype(np.float32)
    own = len(OWN) + 2 * forces
    states[..., :own] = states[:, :1, :own]
    return states


def test_value_and_attention_equal_crowdnav_s_with_its_weights(crowdnav, crowdnav_weights):
    network = ValueNetwork()
    network.load_state_dict(crowdnav_weights)
    value, attention = as_fast(network).evaluate(crowdnav["rotated"])
    np.testing.assert_allclose(value, crowdnav["value"], rtol=0, atol=1e-5)
    np.testing.assert_allclose(attention, crowdnav["attention"], rtol=0, atol=1e-5)


OTHER_SIZES = Sizes((50, 30), (70, 20), (40, 25, 1), (60, 80, 35, 1))


@pytest.mark.parametrize("sizes", [Sizes(), OTHER_SIZES], ids=["the paper's", "others"])
def test_value_by_a_naive_loop_over_states_and_elements(sizes):
    """The definition with torch's plain layers, one state and one element at a time; 17 columns, one absent element."""
    network = ValueNetwork(forces=True, seed=5, sizes=sizes)
    states = random_states(6, 4, forces=True)
    states[2, 1, 8:] = np.nan
    value, attention = as_fast(network).evaluate(states)
    for b in range(6):
        rows = [torch.from_numpy(row) for row in states[b] if not np.isnan(row).any()]
        with torch.no_grad():
            hidden = [network.mlp1(row) for row in rows]
            mean = sum(hidden) / len(hidden)
            scores = torch.stack([network.attention(torch.cat((h, mean)))[0] for h in hidden])
            share = scores.exp() / scores.exp().sum()
            pooled = sum(s * network.mlp2(h) for s, h in zip(share, hidden, strict=True))
            expected = network.mlp3(torch.cat((rows[0][:8], pooled)))[0]
        assert value[b] == pytest.approx(float(expected), abs=1e-5)
        here = [k for k in range(4) if (b, k) != (2, 1)]
        np.testing.assert_allclose(attention[b, here], share, atol=1e-5)
    assert attention[2, 1] == 0.0


def test_the_prior_scales_the_value_by_the_distance_to_the_goal():
    plain, prior = ValueNetwork(seed=1), ValueNetwork(value_prior=True, seed=1)
    states = random_states(5, 3)
    states[..., 0] = np.array([0.1, 0.3, 1.0, 4.0, 8.0], dtype=np.float32)[:, None]
    expected = 0.9 ** np.maximum(states[:, 0, 0] - 0.3, 0) * (0.8 + as_fast(plain).evaluate(states)[0])
    np.testing.assert_allclose(as_fast(prior).evaluate(states)[0], expected, rtol=1e-5, atol=1e-6)


def test_layers_have_the_sizes_of_the_paper_s_base():
    shapes = {name: tuple(value.shape) for name, value in ValueNetwork(forces=True).state_dict().items()}
    weights = {name: shape for name, shape in shapes.items() if name.endswith("weight")}
    assert list(weights.values()) == [
        *[(150, 17), (100, 150)],
        *[(100, 100), (50, 100)],
        *[(100, 200), (100, 100), (1, 100)],
        *[(150, 58), (100, 150), (100, 100), (1, 100)],
    ]


def test_parameters_come_from_the_seed_alone_and_lie_in_torch_s_own_range():
    torch.manual_seed(3)
    one = ValueNetwork(seed=7).state_dict()
    torch.manual_seed(4)
    again, other = ValueNetwork(seed=7).state_dict(), ValueNetwork(seed=8).state_dict()
    for name, value in one.items():
        assert torch.equal(value, again[name])
        assert not torch.equal(value, other[name])
    reference = nn.Linear(100, 150)
    bound = reference.weight.abs().max()
    assert float(one["mlp2.0.weight"].abs().max()) == pytest.approx(float(bound.detach()), rel=0.01)


@settings(max_examples=20)
@given(st.integers(0, 1000), st.permutations(range(5)), st.booleans())
def test_the_order_of_the_elements_does_not_matter(seed, order, forces):
    network = ValueNetwork(forces)
    states = random_states(4, 5, forces, seed)
    states[1, 2, network.own :] = np.nan
    value, attention = as_fast(network).evaluate(states)
    shuffled, shares = as_fast(network).evaluate(np.ascontiguousarray(states[:, order]))
    np.testing.assert_allclose(shuffled, value, atol=1e-5)
    np.testing.assert_allclose(shares, attention[:, order], atol=1e-5)


@pytest.mark.parametrize("forces", [False, True])
def test_absent_elements_change_nothing(forces):
    network = ValueNetwork(forces)
    states = random_states(8, 3, forces)
    padded = random_states(8, 6, forces, seed=1)
    padded[:, :, : network.own] = states[:, :1, : network.own]
    padded[:, [0, 2, 5]] = states
    padded[:, [1, 3, 4], network.own :] = np.nan
    value, attention = as_fast(network).evaluate(states)
    with_absent, shares = as_fast(network).evaluate(padded)
    np.testing.assert_allclose(with_absent, value, atol=1e-6)
    np.testing.assert_allclose(shares[:, [0, 2, 5]], attention, atol=1e-6)
    assert (shares[:, [1, 3, 4]] == 0).all()


def test_a_robot_alone_still_knows_where_its_goal_is():
    network = ValueNetwork()
    states = random_states(8, 2)
    states[:, :, network.own :] = np.nan
    value, attention = as_fast(network).evaluate(states)
    assert np.isfinite(value).all()
    assert len(np.unique(value)) == 8
    assert (attention == 0).all()
    assert as_fast(network).evaluate(np.empty((0, 2, 13), dtype=np.float32))[0].shape == (0,)
