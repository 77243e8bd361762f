"""Imitation: ORCA drives the robot, and the network learns the values of the states that the robot passes through.

The value to learn for a state is the return that followed it, under the reward in use. Demonstrations are stored as
trajectories, without rewards and states, so one collection serves every reward and state.
"""

from collections.abc import Callable, Iterator
from typing import Any

from sfmrl.config import Config, ConfigError
from sfmrl.episodes import Record, play_episodes, returns_of, rewards_of
from sfmrl.fast import new_network
from sfmrl.fast.optimizers import OPTIMIZERS
from sfmrl.learning import Memory, Resumable, descend
from sfmrl.lookahead import step_discount
from sfmrl.policies import orca_policy
from sfmrl.rewards import reward_terms
from sfmrl.scenes import elements_of, generator, sample_scenes


def demonstrate(config: Config, progress: Callable[[int], None] = lambda ended: None) -> Record:
    """Play the imitation episodes with ORCA; `progress` is called with the number that have just ended."""
    settings, attributes = config.imitation, config.simulation.random_attributes
    where, count = settings.environment, settings.episodes
    scenes = sample_scenes(where, count, config.seed, phase="imitation", random_attributes=attributes)
    return play_episodes(scenes, orca_policy, config.reward, config.simulation, progress=progress)


def make_memory(config: Config) -> Memory:
    """An empty memory for imitation and reinforcement, with room for the most elements of their environments."""
    environments = config.imitation.environment, config.reinforcement.environment
    elements = max(1, *map(elements_of, environments))
    return Memory(config.reinforcement.memory, elements, forces=config.forces, mirror=config.mirror)


def fill_memory(memory: Memory, record: Record, config: Config) -> None:
    """Store the demonstrations' states with their returns under `config`'s reward, without timed-out episodes."""
    record = record.take(record.outcome != "timeout")
    if not len(record.steps):
        raise ConfigError("every demonstration ended in a time-out, which is not learnt from; raise --time-limit")
    rewards = rewards_of(record.transition, record.steps, reward_terms(config.reward))
    returns = returns_of(rewards, step_discount(config.discount, record.scenes.v_pref[:, 0], record.simulation))
    memory.push(record.states(config), returns[record.played])


class Fit(Resumable):
    """The state of imitation between two epochs: a network, first drawn from the config's seed, and its optimizer."""

    parts, counters = ("network", "optimizer"), ("epoch",)

    def __init__(self, config: Config) -> None:
        self.settings, self.network = config.imitation, new_network(config, config.seed)
        self.optimizer = OPTIMIZERS[config.optimizer](self.network)
        self.rng = generator(config.seed, "fit")
        self.epoch = 0

    def batches_left(self, memory: Memory) -> int:
        """The number of batches up to the end of the last epoch."""
        return (self.settings.epochs - self.epoch) * -(-len(memory) // self.settings.batch_size)


def fit_memory(
    fit: Fit, memory: Memory, progress: Callable[[int], None] = lambda batches: None
) -> Iterator[dict[str, Any]]:
    """Run the epochs that are left, each over all states in random order, and yield metrics after each.

    Calls `progress` with 1 after each batch.
    """
    settings, size = fit.settings, fit.settings.batch_size
    while fit.epoch < settings.epochs:
        order = fit.rng.permutation(len(memory))
        batches = [order[first : first + size] for first in range(0, len(order), size)]
        steps = settings.epochs * len(batches)
        loss = descend(fit.optimizer, memory, batches, settings.learning_rate, steps, progress)
        fit.epoch += 1
        yield {"epoch": fit.epoch, "loss": loss}
