"""Does sfmrl compute here what it should: small tests of its parts, some ten seconds in all.

Each returns what it found, or raises Failure. Nothing is written but to a temporary folder of the system's own.
"""

import hashlib
import multiprocessing
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from sfmrl.config import Config, Simulation
from sfmrl.crowd import crowd_velocities, reset
from sfmrl.episodes import Record, play_episodes, returns_of
from sfmrl.files import DamagedFile
from sfmrl.gradients import loss_and_gradients
from sfmrl.learning import OPTIMIZERS, learn
from sfmrl.lookahead import SarlPolicy, step_discount
from sfmrl.network import ValueNetwork, new_network, resolved
from sfmrl.policies import orca_policy
from sfmrl.scenarios import sample_scenes
from sfmrl.variants import make_config
from sfmrl.weights import load_weights, save_weights

CONFIG = make_config("quick", "sarl-sfm2", simulation={"time_limit": 6.0})
STEPS = 40  # of learning
REINSTALL = "install NumPy and torch anew: pip install --force-reinstall numpy torch"
PRECISION = "train and test with --precision fp32"


class Failure(Exception):
    """What is not as it should be, in words."""


def orca() -> str:
    """ORCA steers everybody, the robot too, and hardly any two touch."""
    start = time.perf_counter()
    record = _orca_record(16)
    seconds = time.perf_counter() - start
    found = int((record.outcome == "success").sum())
    if found < 12:
        raise Failure(f"of 16 episodes among five people only {found} reach the goal")
    return f"{found} of 16 episodes among five people reach the goal, {record.steps.sum() / seconds:,.0f} steps/s"


def lookahead() -> str:
    """A network values the 81 actions of every state, and the best is chosen."""
    world = reset(sample_scenes("2", 32), CONFIG.simulation)
    policy, moves = SarlPolicy(new_network(CONFIG), CONFIG), crowd_velocities(world)
    policy.lookahead(world, moves)
    start = time.perf_counter()
    look = policy.lookahead(world, moves)
    each = (time.perf_counter() - start) / len(world)
    if look.values.shape != (32, 81) or not np.isfinite(look.values).all():
        raise Failure("its values are not 81 finite numbers a state")
    if (look.values[np.arange(32), look.best] < look.values.max(1)).mean() > 0.5:
        raise Failure("it does not take the best action")
    return f"81 values a state in {1000 * each:.2f} ms on one thread"


def same_bits() -> str:
    """The same episodes, played again on two threads and in other batches, have the same bits."""
    if played_digest(1, 8) != played_digest(2, 3):
        raise Failure("the same episodes end in other bits when they are played again")
    return "8 episodes played twice, on one thread and on two, are the same"


def other_process() -> str:
    """A process of its own, as trainings use it, plays the same bits."""
    spawn = multiprocessing.get_context("spawn")
    try:
        with ProcessPoolExecutor(1, spawn) as pool:
            there = pool.submit(played_digest, 1, 8).result(timeout=120)
    except (BrokenProcessPool, OSError, TimeoutError) as error:
        raise Failure(f"no second process can be started: {type(error).__name__} {error}") from None
    if there != played_digest(1, 8):
        raise Failure("a second process plays the same episodes in other bits")
    return "a second process plays the same episodes with the same bits"


def gradient() -> str:
    """The gradient that is written out is torch's own."""
    network = ValueNetwork(value_prior=True, seed=1)
    states, values = _batch(8)
    _, found = loss_and_gradients(network, states, values)
    loss = torch.nn.functional.mse_loss(network(states), values)
    expected = dict(zip(network.tensors, torch.autograd.grad(loss, list(network.tensors.values())), strict=True))
    one, other = (torch.cat([part[name].reshape(-1) for name in network.tensors]) for part in (found, expected))
    error = float((one - other).norm() / other.norm())
    if not error < 1e-3:
        raise Failure(f"it differs from autograd's by {error:.1e}")
    return f"differs from autograd's by {error:.0e}"


def learning() -> str:
    """Descent reduces the loss, and twice to the same bits."""
    first, last, bits = _descent()
    if not last < first / 2:
        raise Failure(f"{STEPS} steps lead from a loss of {first:.4f} to {last:.4f}")
    if not torch.equal(bits, _descent()[2]):
        raise Failure("learning the same twice ends in other bits")
    return f"{STEPS} steps lead from a loss of {first:.4f} to {last:.4f}, twice to the same bits"


def precision() -> str:
    """What `auto` stands for computes nearly what float32 does."""
    auto = resolved("auto")
    states, _ = _batch(32)
    exact, low = (ValueNetwork(value_prior=True, seed=1, precision=kind) for kind in ("fp32", auto))
    error = float(np.abs(exact.evaluate(states.numpy())[0] - low.evaluate(states.numpy())[0]).max())
    if not error < 0.02:
        raise Failure(f"values in {auto} differ from float32's by {error:.3f}")
    return f"auto is {auto} here; values differ from float32's by {error:.0e} at most"


def files() -> str:
    """What is saved comes back, and damage is found."""
    network = ValueNetwork(seed=2)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "weights.pt"
        save_weights(network, Config(), path)
        if not torch.equal(load_weights(path)[0].flat, network.flat):
            raise Failure("a network that was saved comes back changed")
        path.write_bytes(path.read_bytes()[:-1])
        try:
            load_weights(path)
        except DamagedFile:
            return "a saved network comes back unchanged, and a damaged one is refused"
    raise Failure("a damaged file is not found out")


# The tests, and what helps where one fails.
TESTS: dict[str, tuple[Callable[[], str], str]] = {
    "ORCA": (orca, REINSTALL),
    "lookahead": (lookahead, REINSTALL),
    "same bits": (same_bits, f"runs will not repeat here; {PRECISION}, or --threads 1"),
    "second process": (other_process, "train with --no-overlap, or outside of what forbids new processes"),
    "gradient": (gradient, REINSTALL),
    "learning": (learning, f"{PRECISION}; else {REINSTALL}"),
    "precision": (precision, PRECISION),
    "files": (files, "free the system's temporary folder, or name another in TMPDIR"),
}


def played_digest(threads: int, batch: int) -> str:
    """A digest of eight short episodes' positions, played by a network that has learnt nothing."""
    torch.set_num_threads(1)
    policy = SarlPolicy(new_network(CONFIG, seed=5), CONFIG, threads)
    record = play_episodes(sample_scenes("table1", 8), policy, CONFIG.reward, CONFIG.simulation, batch=batch)
    return hashlib.sha256(record.position.tobytes()).hexdigest()


def _orca_record(episodes: int) -> Record:
    return play_episodes(sample_scenes("circle5", episodes), orca_policy, CONFIG.reward, Simulation())


def _batch(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """So many states of ORCA's episodes, evenly spaced, and their returns."""
    record = _orca_record(6)
    factor = step_discount(0.9, record.scenes.v_pref[:, 0], record.simulation)
    returns = returns_of(record.reward, factor)[record.played]
    rows = np.linspace(0, len(returns) - 1, count).astype(int)
    return torch.from_numpy(record.states(False)[rows]), torch.from_numpy(returns[rows].astype(np.float32))


def _descent() -> tuple[float, float, torch.Tensor]:
    """The loss before and after some steps of learning, and the parameters then."""
    config = replace(CONFIG, value_prior=False)
    network = new_network(config, seed=3)
    optimizer = OPTIMIZERS[config.imitation.optimizer](network)
    losses = [float(learn(network, optimizer, 1e-3, *batch)) for batch in [_batch(100)] * STEPS]
    return losses[0], losses[-1], network.flat.clone()
