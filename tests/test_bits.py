"""Simulator, network and training compute the bits that they did: digests, held to those in tests/data/bits.json.

ORCA's hold on every machine; the others only where this machine computes the bits of the one that stored them, else
they are skipped. After a change that is meant to change numbers, store new ones: `python tests/test_bits.py --store`.
"""

import hashlib
import json
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conftest import DATA

from sfmrl.config import Config, Simulation
from sfmrl.episodes import Record, play_episodes, returns_of
from sfmrl.fast import new_network
from sfmrl.learning import OPTIMIZERS, learn
from sfmrl.lookahead import SarlPolicy
from sfmrl.policies import orca_policy
from sfmrl.runs.bits import machine_bits
from sfmrl.runs.create import create_run, start_run
from sfmrl.runs.progress import StopSignal, no_progress
from sfmrl.runs.training import run_imitation, run_reinforcement
from sfmrl.runs.weights import load_weights
from sfmrl.scenes import sample_scenes
from sfmrl.variants import make_config

SHORT, LONG = {"time_limit": 7.0}, {"time_limit": 14.0}  # s: 25 steps, and enough to reach the goal
CONFIG = make_config("quick", "sarl-sfm2")
TRAINING = {"episodes": 12, "parallel": 6, "batches": 2, "validation_interval": 12, "validation_episodes": 1}


def digest(*arrays: np.ndarray) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[:16]


def orca_record(environment: str, **simulation: object) -> Record:
    return play_episodes(sample_scenes(environment, 8), orca_policy, CONFIG.reward, Simulation(**simulation))


def simulated(environment: str, **simulation: object) -> str:
    """Positions and velocities in eight episodes of 25 steps."""
    record = orca_record(environment, **SHORT, **simulation)
    return digest(record.position, record.velocity)


def played() -> str:
    """Eight episodes of SARL, with a network that has learnt nothing."""
    config = make_config("quick", "sarl-sfm2", simulation=SHORT)
    policy = SarlPolicy(new_network(config, seed=5), config)
    record = play_episodes(sample_scenes("table1", 8), policy, config.reward, config.simulation)
    return digest(record.position, record.reward, policy.network.evaluate(record.states(config))[0])


def descended(optimizer: str) -> str:
    """Forty steps of descent on states of ORCA's episodes and their returns."""
    record = orca_record("1", **LONG)
    states = record.states(Config())
    values = returns_of(record.reward, np.full(8, 0.974))[record.played].astype(np.float32)
    network = new_network(CONFIG, seed=3)
    steps, rng, losses = OPTIMIZERS[optimizer](network), np.random.default_rng(0), []
    for _ in range(40):
        rows = rng.choice(len(states), 100, replace=False)
        losses.append(learn(steps, 1e-3, states[rows], values[rows]))
    return digest(np.array(losses), network.flat)


def trained(targets: str) -> str:
    """A short imitation and two rounds of reinforcement: the parameters and all rows of metrics.csv."""
    config = make_config(
        "quick",
        simulation=LONG,
        imitation={"episodes": 10, "epochs": 2},
        reinforcement=TRAINING | {"test_episodes": 1, "targets": targets},
    )
    with tempfile.TemporaryDirectory() as folder:
        source, run = Path(folder, "il"), Path(folder, "rl")
        run_imitation(create_run("il", config, source), no_progress, StopSignal())
        run_reinforcement(start_run(config, source, False, run), no_progress, StopSignal(), lambda text: None)
        rows = (run / "metrics.csv").read_bytes()
        return digest(load_weights(run / "weights.npz")[0].flat, np.frombuffer(rows, np.uint8))


EVERYWHERE: dict[str, Callable[[], str]] = {
    "ORCA among people": partial(simulated, "circle"),
    "ORCA among squares": partial(simulated, "1"),
    "ORCA at a barrier": partial(simulated, "2"),
}
HERE: dict[str, Callable[[], str]] = {
    "social forces": partial(simulated, "circle", crowd="sfm"),
    "SARL": played,
    "Adam": partial(descended, "adam"),
    "SGD": partial(descended, "sgd"),
    "td": partial(trained, "td"),
    "returns": partial(trained, "returns"),
}


@pytest.fixture(scope="module")
def stored() -> dict[str, str]:
    return json.loads((DATA / "bits.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("what", EVERYWHERE)
def test_the_simulator_has_the_same_bits_on_every_machine(what, stored):
    assert EVERYWHERE[what]() == stored[what]


@pytest.mark.parametrize("what", HERE)
def test_network_and_training_have_the_bits_that_were_stored(what, stored):
    if machine_bits() != stored["machine"]:
        pytest.skip(f"stored where machines compute bits {stored['machine']}; this one computes {machine_bits()}")
    assert HERE[what]() == stored[what]


if __name__ == "__main__":
    found = {"machine": machine_bits()} | {what: compute() for what, compute in (EVERYWHERE | HERE).items()}
    text = json.dumps(found, indent=2) + "\n"
    if "--store" in sys.argv:
        (DATA / "bits.json").write_text(text, encoding="utf-8")
    print(text, end="")
