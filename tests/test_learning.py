"""Learning against hand computations: learning rates, descent, memory, targets; and a training that improves."""

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
from sfmrl.evaluation import evaluate, evaluation_record, metrics
from sfmrl.exploration import epsilon, explore, remember
from sfmrl.fast import FastNetwork, new_network
from sfmrl.fast.optimizers import OPTIMIZERS, flush_negligible
from sfmrl.imitation import Fit, demonstrate, fill_memory, fit_memory, make_memory
from sfmrl.learning import Learner, Memory, learn
from sfmrl.lookahead import SarlPolicy
from sfmrl.recovery import RecoveringPolicy
from sfmrl.recovery.remembering import RememberingPolicy
from sfmrl.reinforcement import reinforce
from sfmrl.runs import training
from sfmrl.runs.create import create_run
from sfmrl.runs.explorer import Explorer
from sfmrl.runs.progress import StopSignal, no_progress
from sfmrl.runs.training import needs_fit, validation_due
from sfmrl.runs.weights import load_weights
from sfmrl.scenes import sample_scenes
from sfmrl.states import robot_states
from sfmrl.variants import make_config


def random_batch(seed: int, count: int = 6, elements: int = 3) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((count, elements, 13), np.float32), rng.standard_normal(count, np.float32)


def plain_network(seed: int = 0) -> FastNetwork:
    return new_network(Config(), seed)


def test_adam_s_learning_rate_falls_to_nothing_and_sgd_s_stays():
    sgd, adam = (OPTIMIZERS[name](plain_network()) for name in ("sgd", "adam"))
    for progress, share in {0.0: 1.0, 0.25: 0.75, 1.0: 0.0}.items():
        assert adam.rate(0.02, progress) == pytest.approx(0.02 * share)
        assert sgd.rate(0.02, progress) == 0.02


TORCH_S = {"sgd": lambda flat: torch.optim.SGD([flat], momentum=0.9), "adam": lambda flat: torch.optim.Adam([flat])}


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_steps_of_descent_are_those_of_torch_s_optimizers(name):
    network, mirror = plain_network(1), plain_network(1)
    optimizer, flat = OPTIMIZERS[name](network), torch.from_numpy(mirror.flat)
    flat.grad = torch.from_numpy(mirror.gradient)
    reference = TORCH_S[name](flat)
    for number in range(20):
        states, values = random_batch(number)
        reference.param_groups[0]["lr"] = rate = 1e-3 / (number + 1)
        mirror.flat[:] = network.flat  # so that rounding does not add up
        loss = learn(optimizer, rate, states, values)
        assert loss == mirror.loss_and_gradients(states, values)[0]
        before = mirror.flat.copy()
        reference.step()
        np.testing.assert_allclose(network.flat - before, mirror.flat - before, rtol=1e-3, atol=1e-8)


@pytest.mark.parametrize("name", ["sgd", "adam"])
def test_flushing_negligible_gradients_spares_denormal_numbers_and_changes_no_parameter(name):
    def train(flushing: bool) -> tuple[FastNetwork, np.ndarray]:
        network = plain_network(4)
        network.parameters["mlp1.0.bias"][:40] = -100.0  # forty units that are active only at first
        optimizer = OPTIMIZERS[name](network)
        for number in range(1200):
            states, values = random_batch(number % 7, count=2, elements=2)
            learn(optimizer, 1e-3, states * np.float32(50.0 if number < 3 else 1.0), values)
            if flushing and number % 200 == 0:
                flush_negligible(optimizer)
        return network, optimizer.moments[0]

    (plain, before), (spared, after) = train(False), train(True)
    np.testing.assert_array_equal(plain.flat, spared.flat)
    denormal = np.finfo(np.float32).tiny
    assert ((before != 0) & (abs(before) < denormal)).sum() > 100
    assert not ((after != 0) & (abs(after) < denormal)).any()


@settings(max_examples=100)
@given(st.integers(1, 12), st.lists(st.integers(0, 15), max_size=8), st.integers(0, 8))
def test_memory_keeps_the_newest_as_a_deque_does_also_after_it_was_saved(capacity, pushes, saved_after):
    memory, expected = Memory(capacity, 1), deque(maxlen=capacity)
    number = 0
    for pushed, count in enumerate(pushes):
        if pushed == saved_after:
            saved, memory = memory.state_dict(), Memory(capacity, 1)
            memory.load_state_dict(saved)
        values = np.arange(number, number + count, dtype=np.float32)
        states = np.repeat(values, 13).reshape(count, 1, 13)
        memory.push(states, values)
        expected.extend(values.tolist())
        number += count
        assert len(memory) == len(expected)
    states, values = memory.take(np.arange(len(memory)))
    assert sorted(values.tolist()) == sorted(expected)
    assert (states[:, 0, :] == values[:, None]).all()


def test_memory_fills_up_with_absent_elements_that_change_no_value():
    memory, network = Memory(10, 5), plain_network()
    states, values = random_batch(3)
    states[..., :6] = states[:, :1, :6]
    memory.push(states, values)
    stored, _ = memory.take(np.arange(6))
    assert np.isnan(stored[:, 3:, 6:]).all()
    np.testing.assert_allclose(network.evaluate(stored)[0], network.evaluate(states)[0], atol=1e-6)


@pytest.mark.parametrize("forces", [False, True])
def test_every_other_state_of_a_batch_is_that_of_the_mirrored_world(forces):
    rng = np.random.default_rng(2)
    position, velocity = rng.normal(0, 3, (2, 8, 4, 2))
    goal = rng.normal(0, 3, (8, 2))

    def states_of(sign: list[float]) -> np.ndarray:
        robot = (position[:, 0] * sign, velocity[:, 0] * sign, goal * sign, 0.3, 1.0)
        return robot_states(*robot, position[:, 1:] * sign, velocity[:, 1:] * sign, np.full((8, 3), 0.3), forces=forces)

    plain, other = states_of([1.0, 1.0]), states_of([1.0, -1.0])
    memory = Memory(8, 3, forces=forces, mirror=True)
    memory.push(plain, np.zeros(8))
    taken, _ = memory.take(np.arange(8))
    np.testing.assert_allclose(taken[::2], other[::2], atol=1e-5)
    np.testing.assert_array_equal(taken[1::2], plain[1::2])
    np.testing.assert_array_equal(memory.states, plain)


def test_a_fit_goes_on_to_the_same_bits_from_what_it_saved():
    config, memory = Config(imitation=Imitation(batch_size=10, epochs=2)), Memory(25, 3)
    memory.push(*random_batch(0, count=25))
    whole, resumed = Fit(config), Fit(config)
    list(fit_memory(whole, memory))
    next(fit_memory(resumed, memory))
    saved = resumed.state_dict()
    resumed = Fit(override(config, {"seed": 1}))
    resumed.load_state_dict(saved)
    assert resumed.batches_left(memory) == 3
    list(fit_memory(resumed, memory))
    np.testing.assert_array_equal(resumed.network.flat, whole.network.flat)


def test_an_epoch_takes_every_state_once_in_another_order_each_time(monkeypatch):
    seen = []

    def note(optimizer, rate, states, values):
        seen.append(values.tolist())
        return 0.0

    monkeypatch.setattr("sfmrl.learning.learn", note)
    memory = Memory(25, 3)
    states, _ = random_batch(0, count=25)
    memory.push(states, np.arange(25, dtype=np.float32))
    fit = Fit(Config(imitation=Imitation(batch_size=10, epochs=2)))
    list(fit_memory(fit, memory))
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


@pytest.mark.parametrize("targets", ["td", "returns"])
def test_targets_equal_a_naive_loop(targets):
    config, keep_timeouts = tiny_config(targets=targets), targets == "returns"
    learner = Learner(plain_network(1), make_memory(config), config)
    learner.network.flat += 0.05  # it has moved on from its target
    record, random_steps = played(config)
    assert {"success", "timeout"} <= set(record.outcome)
    remember(learner, record, random_steps)

    expected = []
    gamma = 0.9**0.25
    for e, steps in enumerate(record.steps):
        if record.outcome[e] == "timeout" and not keep_timeouts:
            continue
        states = record.take(np.array([e])).states(config)
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
    np.testing.assert_array_equal(states, kept.states(config))


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
    learner = Learner(plain_network(), make_memory(config), config)
    before = learner.target.flat.copy()
    learner.network.flat += 1.0
    learner.advance(32)
    np.testing.assert_array_equal(learner.target.flat, before)
    learner.advance(32)  # past 50
    np.testing.assert_array_equal(learner.target.flat, learner.network.flat)
    assert learner.episode == 64


def test_validations_are_due_at_their_interval_once_and_at_the_end():
    config = tiny_config(validation_interval=20, episodes=50)
    learner = Learner(plain_network(), make_memory(config), config)
    for episode, expected in ((0, True), (10, False), (20, True), (40, True), (50, True)):
        learner.episode = episode
        assert validation_due(learner, config.reinforcement) is expected
        learner.validations.append({"episode": episode})
        assert not validation_due(learner, config.reinforcement)


def test_exploration_does_not_depend_on_what_is_played_side_by_side():
    config = tiny_config(epsilon_start=0.9, epsilon_end=0.1, epsilon_episodes=5)
    policy = SarlPolicy(plain_network(), config)
    together, random_together = explore(policy, config, range(6))
    for e in (1, 4):
        alone, random_alone = explore(policy, config, [e])
        steps = alone.steps[0]
        np.testing.assert_array_equal(together.position[e, : steps + 1], alone.position[0])
        np.testing.assert_array_equal(random_together[e, :steps], random_alone[0, :steps])
    for e, expected in ((0, 0.9), (5, 0.1)):
        share = random_together[e, : together.steps[e]].mean()
        assert share == pytest.approx(expected, abs=4 * math.sqrt(0.09 / together.steps[e]))


def test_without_exploration_every_action_is_the_network_s():
    config = tiny_config(epsilon_start=0.0, epsilon_end=0.0)
    policy = SarlPolicy(plain_network(), config)
    record, random_steps = explore(policy, config, range(2))
    assert not random_steps.any()
    worlds = record.worlds()
    moves = np.nan_to_num(record.velocity[:, 1:][record.played])
    np.testing.assert_array_equal(policy(worlds, moves), record.transition.velocity[record.played])


def test_time_outs_alone_leave_the_memory_empty_and_nothing_to_learn():
    config = tiny_config()
    learner = Learner(plain_network(), make_memory(config), config)
    record, random_steps = played(config)
    late = record.outcome == "timeout"
    remember(learner, record.take(late), random_steps[late])
    assert len(learner.memory) == 0
    before = learner.network.flat.copy()
    assert math.isnan(learner.learn(3))
    np.testing.assert_array_equal(learner.network.flat, before)


def test_imitation_improves_on_the_untrained_network():
    """Sixty demonstrations: the error on unseen ones falls by half at least, and the robot reaches its goal."""
    schedule = {"episodes": 60, "epochs": 6, "batch_size": 50}
    config = override(make_config("quick", imitation=schedule), {"value_prior": False})
    memory, held_out = make_memory(config), make_memory(config)
    fill_memory(memory, demonstrate(config), config)
    fill_memory(held_out, demonstrate(override(config, {"seed": 1})), config)
    states, values = held_out.take(np.arange(len(held_out)))

    def held_out_error(network: FastNetwork) -> float:
        return float(np.mean((network.evaluate(states)[0] - values) ** 2))

    fit = Fit(config)
    before = held_out_error(fit.network)
    rows = list(fit_memory(fit, memory))
    assert held_out_error(fit.network) < before / 2
    assert rows[-1]["loss"] < rows[0]["loss"] / 2

    task = {"environment": "circle", "episodes": 12, "simulation": Simulation(time_limit=15.0)}
    fitted = evaluate(SarlPolicy(fit.network, config), **task)
    untrained = evaluate(SarlPolicy(Fit(config).network, config), **task)
    assert fitted["success"] >= untrained["success"] + 0.5


def test_the_paper_s_preset_fits_every_reward_and_quick_only_another_state():
    for preset, expected in (("paper", True), ("quick", False)):
        il = make_config(preset)
        assert not needs_fit(il, il)
        assert needs_fit(il, make_config(preset, "sarl-sfm2")) is expected
        assert needs_fit(il, make_config(preset, "sarl-sfm5"))


def test_validations_and_tests_have_their_own_episodes_for_every_seed_and_the_best_network_is_kept(
    tmp_path, monkeypatch
):
    few = {"validation_episodes": 3, "test_episodes": 2}
    config = make_config(seed=5, simulation={"time_limit": 2.0}, reinforcement=few)
    run, how, kept = create_run("rl", config, tmp_path / "run"), [], []
    learner, rates = Learner(new_network(config), make_memory(config), config), iter([0.5, 0.75, 0.75, 0.25])

    def noting(policy, **settings) -> Record:
        how.append((type(policy), settings["phase"], settings["seed"], settings["episodes"]))
        return evaluation_record(policy, **settings)

    monkeypatch.setattr(training, "evaluation_record", noting)
    with monkeypatch.context() as patched:
        patched.setattr(training, "metrics", lambda record: metrics(record) | {"success": next(rates)})
        for number in range(4):
            learner.network.parameters["mlp3.6.bias"][:] = learner.episode = number
            training.validate(run, learner, StopSignal(), lambda text: None, 1)
            kept.append(float(load_weights(run.folder / "best.npz")[0].parameters["mlp3.6.bias"][0]))
    training.test(run, learner, no_progress, 1)
    assert kept == [0, 1, 2, 2]  # of equally good ones the latest
    tests = [(RememberingPolicy, "test", 0, 2), (RecoveringPolicy, "test", 0, 2)]
    assert how == [(SarlPolicy, "validation", 0, 3)] * 4 + tests


@pytest.mark.parametrize("mixed", [False, True])
def test_a_training_plays_the_scenes_of_its_own_phase_and_seed(mixed):
    places = {"imitation": {"episodes": 3, "environment": "circle5"}, "reinforcement": {"environment": "square5"}}
    config = make_config(seed=3, simulation={"time_limit": 2.0, "random_attributes": mixed}, **places)
    explored, _ = explore(SarlPolicy(new_network(config), config), config, range(4, 7))
    demonstrated = demonstrate(config)
    for record, place, numbers, phase in (
        (demonstrated, "circle5", 3, "imitation"),
        (explored, "square5", range(4, 7), "train"),
    ):
        expected = sample_scenes(place, numbers, 3, phase=phase, random_attributes=mixed)
        for name in ("start", "goal", "radius", "v_pref", "episode"):
            np.testing.assert_array_equal(getattr(record.scenes, name), getattr(expected, name))


def test_every_part_of_a_training_draws_from_its_seed():
    configs = [override(tiny_config(epsilon_start=0.5, epsilon_end=0.5), {"seed": seed}) for seed in (0, 1)]
    drawn = [
        (
            Fit(config).network.flat[:9].tolist(),
            Fit(config).rng.random(),
            Learner(plain_network(), make_memory(config), config).rng.random(),
            explore(SarlPolicy(plain_network(), config), config, range(4))[1][:, :8].tolist(),
        )
        for config in configs
    ]
    assert all(one != other for one, other in zip(*drawn, strict=True))


@pytest.mark.parametrize("parallel", [1, 2])
def test_one_episode_is_played_with_all_that_was_learnt_and_a_round_with_what_was_a_round_ago(parallel, monkeypatch):
    config = tiny_config(targets="returns", parallel=parallel, episodes=6, batches=5, batch_size=20)
    learner, seen = Learner(plain_network(), make_memory(config), config), []

    def noting(policy, *rest):
        seen.append(policy.network.flat.copy())
        return explore(policy, *rest)

    monkeypatch.setattr("sfmrl.runs.explorer.explore", noting)
    learnt = [learner.network.flat.copy()]
    with Explorer(config, 1, aside=False) as explorer:
        for _ in reinforce(learner, explorer.start, 6):
            learnt.append(learner.network.flat.copy())
    assert len({flat.tobytes() for flat in learnt}) == len(learnt)
    for number, flat in enumerate(seen):
        np.testing.assert_array_equal(flat, learnt[max(0, number - (parallel > 1))])
