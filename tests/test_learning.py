"""Learning against hand computations: schedules, one step of descent, memory, targets; and a training that improves."""

import math
from collections import deque
from itertools import chain

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sfmrl.config import Config, Imitation, Reinforcement, Simulation, override
from sfmrl.episodes import Record, play, returns_of
from sfmrl.evaluation import evaluate
from sfmrl.exploration import epsilon, explore, remember
from sfmrl.gradients import loss_and_gradients
from sfmrl.imitation import demonstrate, fill_memory, fit_memory, make_memory, new_fit
from sfmrl.learner import Learner, follow
from sfmrl.learning import OPTIMIZERS, SCHEDULES, Fit, forget, generator_state, learn, set_generator_state
from sfmrl.lookahead import SarlPolicy
from sfmrl.memory import Memory
from sfmrl.network import ValueNetwork
from sfmrl.progress import no_progress
from sfmrl.reinforcement import due
from sfmrl.scenarios import sample_scenes
from sfmrl.variants import make_config


def random_batch(seed: int, count: int = 6, elements: int = 3) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(count, elements, 13, generator=generator), torch.randn(count, generator=generator)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("constant", {0.0: 1.0, 0.5: 1.0, 1.0: 1.0}),
        ("linear", {0.0: 1.0, 0.25: 0.75, 1.0: 0.0}),
        ("one-cycle", {0.0: 1 / 25, 0.15: 0.52, 0.3: 1.0, 0.65: 0.5, 1.0: 0.0}),
    ],
)
def test_schedules_at_known_points(name, expected):
    for progress, factor in expected.items():
        assert SCHEDULES[name](progress) == pytest.approx(factor, abs=1e-12)


@given(st.sampled_from(sorted(SCHEDULES)), st.floats(0, 1))
def test_schedules_stay_between_nothing_and_the_whole_rate(name, progress):
    assert 0 <= SCHEDULES[name](progress) <= 1


def test_two_steps_of_sgd_equal_a_hand_computation():
    network, mirror = ValueNetwork(seed=1), ValueNetwork(seed=1)
    optimizer = OPTIMIZERS["sgd"](network)
    velocity = [torch.zeros_like(p) for p in mirror.parameters()]
    for number, rate in enumerate((0.05, 0.02)):
        states, values = random_batch(number)
        loss = learn(network, optimizer, rate, states, values)
        error = ((mirror(states) - values) ** 2).sum() / len(values)
        gradients = torch.autograd.grad(error, list(mirror.parameters()))
        assert float(loss) == pytest.approx(float(error.detach()), rel=1e-6)
        with torch.no_grad():
            for p, v, g in zip(mirror.parameters(), velocity, gradients, strict=True):
                v.mul_(0.9).add_(g)
                p -= rate * v
    for (name, p), q in zip(network.named_parameters(), mirror.parameters(), strict=True):
        torch.testing.assert_close(p, q, rtol=1e-5, atol=1e-7, msg=name)


def test_steps_of_sgd_have_the_bits_of_torch_s_own():
    ours, theirs = ValueNetwork(seed=3), ValueNetwork(seed=3)
    optimizer, reference = OPTIMIZERS["sgd"](ours), torch.optim.SGD([theirs.flat], momentum=0.9, fused=True)
    for number in range(6):
        states, values = random_batch(number, count=40)
        reference.param_groups[0]["lr"] = rate = 0.1 / (number + 1)
        learn(ours, optimizer, rate, states, values)
        loss_and_gradients(theirs, states, values)
        reference.step()
        assert torch.equal(ours.flat, theirs.flat)
    assert torch.equal(optimizer.state[ours.flat]["momentum_buffer"], reference.state[theirs.flat]["momentum_buffer"])


def test_a_step_of_adam_equals_a_hand_computation():
    network, mirror = ValueNetwork(seed=2), ValueNetwork(seed=2)
    states, values = random_batch(5)
    learn(network, OPTIMIZERS["adam"](network), 1e-3, states, values)
    gradients = torch.autograd.grad(((mirror(states) - values) ** 2).mean(), list(mirror.parameters()))
    for (name, p), q, g in zip(network.named_parameters(), mirror.parameters(), gradients, strict=True):
        if name == "attention.4.bias":  # a shift of all scores changes nothing: autograd's number is rounding alone
            assert torch.equal(p, q)
            continue
        # In the first step both moments, corrected for their start at 0, are the gradient's own.
        torch.testing.assert_close(p, q - 1e-3 * g / (g.abs() + 1e-8), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("name", ["sgd", "adam"])
def test_forgetting_spares_denormal_numbers_and_changes_no_parameter(name):
    def train(forgetting: bool) -> tuple[ValueNetwork, torch.Tensor]:
        network = ValueNetwork(seed=4)
        with torch.no_grad():
            network.mlp1[0].bias[:40] = -100.0  # forty units that are active only at first
        optimizer = OPTIMIZERS[name](network)
        for number in range(1200):
            states, values = random_batch(number % 7, count=2, elements=2)
            learn(network, optimizer, 1e-3, states * (50.0 if number < 3 else 1.0), values)
            if forgetting and number % 200 == 0:
                forget(optimizer)
        state = optimizer.state[network.flat]
        return network, state["momentum_buffer" if name == "sgd" else "exp_avg"]

    (plain, before), (spared, after) = train(False), train(True)
    assert torch.equal(plain.flat, spared.flat)
    denormal = torch.finfo(torch.float32).tiny
    assert ((before != 0) & (before.abs() < denormal)).sum() > 100
    assert not ((after != 0) & (after.abs() < denormal)).any()


@settings(max_examples=100)
@given(st.integers(1, 12), st.lists(st.integers(0, 15), max_size=8))
def test_memory_keeps_the_newest_as_a_deque_does(capacity, pushes):
    memory, expected = Memory(capacity, 1, 3, own=2), deque(maxlen=capacity)
    number = 0
    for count in pushes:
        values = np.arange(number, number + count, dtype=np.float32)
        states = np.repeat(values, 3).reshape(count, 1, 3)
        memory.push(states, values)
        expected.extend(values.tolist())
        number += count
        assert len(memory) == len(expected)
    states, values = memory.take(np.arange(len(memory)))
    assert sorted(values.tolist()) == sorted(expected)
    assert (states[:, 0, :] == values[:, None]).all()


def test_memory_fills_up_with_absent_elements_that_change_no_value():
    memory, network = Memory(10, 5, 13, own=6), ValueNetwork()
    states, values = (t.numpy() for t in random_batch(3))
    states[..., :6] = states[:, :1, :6]
    memory.push(states, values)
    stored, _ = memory.take(np.arange(6))
    assert torch.isnan(stored[:, 3:, 6:]).all()
    np.testing.assert_allclose(network.evaluate(stored.numpy())[0], network.evaluate(states)[0], atol=1e-6)


def test_memory_goes_on_from_what_it_saved():
    one = Memory(5, 3, 13, own=6)
    for seed in range(3):
        one.push(*(t.numpy() for t in random_batch(seed, count=3)))
    other = Memory(5, 3, 13, own=6)
    other.load_state_dict(one.state_dict())
    for memory in (one, other):
        memory.push(*(t.numpy() for t in random_batch(9, count=2)))
    for a, b in zip(one.take(np.arange(5)), other.take(np.arange(5)), strict=True):
        assert torch.equal(a, b)


def test_a_generator_s_state_goes_through_text():
    one, other = np.random.default_rng(3), np.random.default_rng(4)
    one.random(5)
    set_generator_state(other, generator_state(one))
    np.testing.assert_array_equal(one.random(7), other.random(7))


def test_an_epoch_takes_every_state_once_in_another_order_each_time(monkeypatch):
    seen = []

    def note(network, optimizer, rate, states, values):
        seen.append(values.tolist())
        return torch.zeros(())

    monkeypatch.setattr("sfmrl.learning.learn", note)
    memory = Memory(25, 3, 13, own=6)
    states, _ = random_batch(0, count=25)
    memory.push(states.numpy(), np.arange(25, dtype=np.float32))
    fit = Fit(ValueNetwork(), Imitation(batch_size=10, epochs=2), np.random.default_rng(0))
    fit.run_epoch(memory, lambda count: None)
    fit.run_epoch(memory, lambda count: None)
    assert [len(batch) for batch in seen] == [10, 10, 5] * 2
    first, second = (list(chain(*seen[part])) for part in (slice(3), slice(3, 6)))
    assert sorted(first) == sorted(second) == list(range(25))
    assert first != second


def test_epsilon_falls_in_a_straight_line_and_then_stays():
    found = epsilon(Reinforcement(), np.array([0, 1000, 2000, 4000, 9999]))
    np.testing.assert_allclose(found, [0.5, 0.4, 0.3, 0.1, 0.1])


def tiny_config(**reinforcement) -> Config:
    changes = {"reinforcement": {"episodes": 40, "environment": "1", "test_environment": "1"} | reinforcement}
    return make_config("paper", simulation={"time_limit": 12.0}, **changes)


def played(config: Config) -> tuple[Record, np.ndarray]:
    """A few episodes by ORCA, with steps said to be random."""
    record = play(sample_scenes("1", 12, seed=3), "orca", reward=config.reward, discount=config.discount)
    return record, np.random.default_rng(0).random(record.reward.shape) < 0.3


@pytest.mark.parametrize("keep_timeouts", [False, True])
@pytest.mark.parametrize("targets", ["td", "returns"])
def test_targets_equal_a_naive_loop(targets, keep_timeouts):
    config = tiny_config(targets=targets, keep_timeouts=keep_timeouts)
    learner = Learner(ValueNetwork(seed=1), make_memory(config), config)
    with torch.no_grad():  # the network has moved on from its target
        for p in learner.network.parameters():
            p.add_(0.05)
    record, random_steps = played(config)
    assert {"success", "timeout"} <= set(record.outcome)
    remember(learner, record, random_steps)

    expected = []
    gamma = 0.9**0.25
    for e, steps in enumerate(record.steps):
        if record.outcome[e] == "timeout" and not keep_timeouts:
            continue
        states = record.take(np.array([e])).states(False)
        value = learner.target.evaluate(states)[0]
        for t in range(steps):
            goal, factor = 0.0, 1.0
            for u in range(t, steps):
                goal += factor * record.reward[e, u]
                factor *= gamma
                if u + 1 == steps:
                    break
                if targets == "td" or random_steps[e, u + 1]:
                    goal += factor * value[u + 1]
                    break
            expected.append(goal)
    states, values = learner.memory.take(np.arange(len(learner.memory)))
    np.testing.assert_allclose(values, expected, rtol=1e-5, atol=1e-6)
    kept = record.take(np.flatnonzero(keep_timeouts | (record.outcome != "timeout")))
    np.testing.assert_array_equal(states, kept.states(False))


def test_demonstrations_enter_with_their_own_returns_and_without_timeouts():
    config = make_config("paper", "sarl-sfm2")
    record = play(sample_scenes("1", 12, seed=3), "orca")  # played under another reward
    memory = make_memory(config)
    fill_memory(memory, record, config)
    again = play(sample_scenes("1", 12, seed=3), "orca", reward="sfm")
    kept = again.take(again.outcome != "timeout")
    assert 0 < len(kept.steps) < 12
    expected = returns_of(kept.reward, np.full(len(kept.steps), 0.9**0.25))[kept.played]
    np.testing.assert_allclose(memory.take(np.arange(len(memory)))[1], expected, rtol=1e-6, atol=1e-7)


def test_the_target_network_is_renewed_at_its_interval_whatever_is_played_side_by_side():
    config = tiny_config(target_interval=50)
    learner = Learner(ValueNetwork(), make_memory(config), config)
    before = learner.target.mlp3[0].bias.clone()
    with torch.no_grad():
        learner.network.mlp3[0].bias.add_(1.0)
    learner.advance(32)
    assert torch.equal(learner.target.mlp3[0].bias, before)
    learner.advance(32)  # past 50
    assert torch.equal(learner.target.mlp3[0].bias, before + 1.0)
    assert learner.episode == 64


def test_the_average_follows_the_network():
    one, other = ValueNetwork(seed=1), ValueNetwork(seed=2)
    expected = [0.75 * p + 0.25 * q for p, q in zip(one.parameters(), other.parameters(), strict=True)]
    follow(one, other, 0.25)
    for p, q in zip(one.parameters(), expected, strict=True):
        torch.testing.assert_close(p, q)


def test_validations_are_due_at_their_interval_once_and_at_the_end():
    config = tiny_config(validation_interval=20, episodes=50)
    learner = Learner(ValueNetwork(), make_memory(config), config)
    for episode, expected in ((0, True), (10, False), (20, True), (40, True), (50, True)):
        learner.episode = episode
        assert due(learner, config.reinforcement) is expected
        learner.validations.append({"episode": episode})
        assert not due(learner, config.reinforcement)


def test_exploration_does_not_depend_on_what_is_played_side_by_side():
    config = tiny_config(epsilon_start=0.8, epsilon_end=0.8)
    policy = SarlPolicy(ValueNetwork(), config)
    together, random_together = explore(policy, config, range(6))
    for e in (1, 4):
        alone, random_alone = explore(policy, config, [e])
        steps = alone.steps[0]
        np.testing.assert_array_equal(together.position[e, : steps + 1], alone.position[0])
        np.testing.assert_array_equal(random_together[e, :steps], random_alone[0, :steps])
    share = random_together[together.played].mean()
    assert share == pytest.approx(0.8, abs=4 * math.sqrt(0.16 / together.played.sum()))


def test_without_exploration_every_action_is_the_network_s():
    config = tiny_config(epsilon_start=0.0, epsilon_end=0.0)
    policy = SarlPolicy(ValueNetwork(), config)
    record, random_steps = explore(policy, config, range(2))
    assert not random_steps.any()
    worlds = record.worlds()
    moves = np.nan_to_num(record.velocity[:, 1:][record.played])
    np.testing.assert_array_equal(policy(worlds, moves), record.transition.velocity[record.played])


def test_nothing_in_memory_means_nothing_to_learn():
    config = tiny_config()
    learner = Learner(ValueNetwork(), make_memory(config), config)
    before = learner.network.mlp1[0].weight.clone()
    assert math.isnan(learner.learn(3))
    assert torch.equal(learner.network.mlp1[0].weight, before)


def test_imitation_improves_on_the_untrained_network():
    """Sixty demonstrations: the error on unseen ones falls by half at least, and the robot reaches its goal."""
    schedule = {"episodes": 60, "epochs": 6, "batch_size": 50}
    config = override(make_config("quick", imitation=schedule), {"value_prior": False})
    memory, held_out = make_memory(config), make_memory(config)
    fill_memory(memory, demonstrate(config, no_progress), config)
    fill_memory(held_out, demonstrate(override(config, {"seed": 1}), no_progress), config)
    states, values = held_out.take(np.arange(len(held_out)))

    def held_out_error(network: ValueNetwork) -> float:
        return float(np.mean((network.evaluate(states.numpy())[0] - values.numpy()) ** 2))

    fit = new_fit(config)
    before = held_out_error(fit.network)
    rows = []
    fit_memory(fit, memory, no_progress, rows.append)
    assert held_out_error(fit.network) < before / 2
    assert rows[-1]["loss"] < rows[0]["loss"] / 2

    task = {"environment": "circle", "episodes": 12, "simulation": Simulation(time_limit=15.0)}
    fitted = evaluate(SarlPolicy(fit.network, config), **task)
    untrained = evaluate(SarlPolicy(new_fit(config).network, config), **task)
    assert fitted["success"] >= untrained["success"] + 0.5
