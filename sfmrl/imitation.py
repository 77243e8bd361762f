"""Imitation: ORCA shows the way, and the network learns what its situations were worth.

Demonstrations are kept as trajectories, so one collection serves every reward and state: the returns to learn are the
demonstrations' own, computed under the reward in use.
"""

import io
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np

from sfmrl.config import Config, ConfigError, Simulation
from sfmrl.episodes import Record, play_episodes, returns_of, rewards_of
from sfmrl.fast import FastNetwork, new_network
from sfmrl.files import DamagedFile, read_checked, write_atomically
from sfmrl.folders import DEMONSTRATIONS
from sfmrl.geometry import length
from sfmrl.learning import Fit
from sfmrl.lookahead import step_discount
from sfmrl.memory import Memory
from sfmrl.policies import orca_policy
from sfmrl.progress import Progress
from sfmrl.rewards import Transition, reward_terms
from sfmrl.runs import Run
from sfmrl.scenarios import Scenes, elements_of, generator, sample_scenes
from sfmrl.states import OWN, column_names
from sfmrl.stopping import Interrupted, StopSignal

DERIVED = ("time_step", "goal_distance_before")  # fields of a transition that the demonstrations file does not hold
STORED = [item.name for item in fields(Transition) if item.name not in DERIVED]


def imitate(run: Run, progress: Progress, stop: StopSignal) -> FastNetwork:
    """Run or go on with an imitation run to its end; raises Interrupted once `stop` has been requested."""
    config = run.config
    path = run.folder / DEMONSTRATIONS
    if not path.exists():
        save_demonstrations(demonstrate(config, stop.watch(progress)), path)
    memory = make_memory(config)
    fill_memory(memory, load_demonstrations(path, config.simulation), config)
    fit = new_fit(config)
    saved = run.load_checkpoint()
    rows = []
    if saved:
        with run.restoring():
            rows = [*saved["rows"]]
            fit.load_state_dict(saved["fit"])

    def keep(row: dict) -> None:
        rows.append(row)
        run.append_rows("metrics.csv", [row])
        run.save_checkpoint({"fit": fit.state_dict(), "rows": rows})
        if stop.requested:
            raise Interrupted

    run.write_table("metrics.csv", rows)
    fit_memory(fit, memory, progress, keep)
    run.finish(fit.network)
    return fit.network


def demonstrate(config: Config, progress: Progress) -> Record:
    """Play the imitation episodes with ORCA driving the robot."""
    settings = config.imitation
    scenes = sample_scenes(settings.environment, settings.episodes, config.seed, phase="imitation")
    with progress("demonstrations", settings.episodes) as told:
        return play_episodes(scenes, orca_policy, config.reward, config.simulation, progress=told)


def make_memory(config: Config) -> Memory:
    """The memory that imitation fills and reinforcement keeps: as many elements as any of their environments has."""
    environments = config.imitation.environment, config.reinforcement.environment
    elements = max(1, *map(elements_of, environments))
    return Memory(config.reinforcement.memory, elements, len(column_names(config.forces)), len(OWN) + 2 * config.forces)


def fill_memory(memory: Memory, record: Record, config: Config) -> None:
    """Store the demonstrations' states with their returns under `config`'s reward; timed-out episodes are left out."""
    record = record.take(record.outcome != "timeout")
    rewards = rewards_of(record.transition, record.steps, reward_terms(config.reward))
    returns = returns_of(rewards, step_discount(config.discount, record.scenes.v_pref[:, 0], record.simulation))
    if not len(record.steps):
        raise ConfigError("every demonstration ended in a time-out, and those are not learnt from; allow more time")
    memory.push(record.states(config.forces), returns[record.played])


def new_fit(config: Config) -> Fit:
    """Imitation at its start: a network drawn from the config's seed."""
    network = new_network(config, config.seed)
    return Fit(network, config.imitation, generator(config.seed, "fit"))


def fit_memory(fit: Fit, memory: Memory, progress: Progress, keep: Callable[[dict], None]) -> None:
    """Run the epochs that are left; `keep` is given a row of metrics after each."""
    batches = -(-len(memory) // fit.settings.batch_size)
    with progress("imitation", (fit.settings.epochs - fit.epoch) * batches) as told:
        while fit.epoch < fit.settings.epochs:
            loss = fit.run_epoch(memory, told)
            keep({"epoch": fit.epoch, "loss": loss})


def save_demonstrations(record: Record, path: Path) -> str:
    """Write a record's trajectories to a file, without the NaN behind each episode's end; returns its SHA-256.

    What follows from them and from the simulation (`DERIVED`) is left out.
    """
    moments = np.arange(record.position.shape[1]) <= record.steps[:, None]
    arrays = {f"scenes.{f.name}": getattr(record.scenes, f.name) for f in fields(Scenes)}
    arrays |= {f"transition.{name}": getattr(record.transition, name)[record.played] for name in STORED}
    arrays |= {"position": record.position[moments], "velocity": record.velocity[moments], "steps": record.steps}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return write_atomically(path, buffer.getvalue())


def load_demonstrations(path: Path, simulation: Simulation) -> Record:
    """The record that `save_demonstrations` wrote, without rewards; raises DamagedFile, also where it is not finite."""
    data = read_checked(path)
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            steps = arrays["steps"]
            scenes = Scenes(*(arrays[f"scenes.{f.name}"] for f in fields(Scenes)))
            played = np.arange(steps.max()) < steps[:, None]
            moments = np.arange(steps.max() + 1) <= steps[:, None]
            stored = {name: _spread(arrays[f"transition.{name}"], played) for name in STORED}
            position, velocity = _spread(arrays["position"], moments), _spread(arrays["velocity"], moments)
            there = np.isfinite(scenes.start)[:, None] & moments[..., None, None]
            parts = {name: values[played] for name, values in stored.items()}
            parts["separations"] = np.minimum(parts["separations"], 0.0)  # infinite to absent elements
            if not all(np.isfinite(part).all() for part in (position[there], velocity[there], *parts.values())):
                raise ValueError("they are not finite")
    except Exception as error:  # NumPy's reader raises whatever the bytes lead it to
        raise DamagedFile(f"{path} does not hold demonstrations ({error}); make them again with sfmrl il") from None
    before = np.where(played, length(position[:, :-1, 0] - scenes.goal[:, None, 0]), np.nan)
    time_step = np.where(played, simulation.time_step, np.nan)
    transition = Transition(**stored, time_step=time_step, goal_distance_before=before)
    nothing = np.full(played.shape, np.nan)
    return Record(scenes, simulation, steps, position, velocity, transition, nothing, nothing[:, 0])


def _spread(flat: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Rows (S, ...) laid out over the true entries of `where` (E, T): (E, T, ...), NaN (0 for integers) elsewhere."""
    full = np.full(where.shape + flat.shape[1:], np.nan if flat.dtype.kind == "f" else 0, dtype=flat.dtype)
    full[where] = flat
    return full
