"""Imitation: ORCA shows the way, and the network learns what its situations were worth.

Demonstrations are kept as trajectories, so one collection serves every reward and state: the returns to learn are the
demonstrations' own, computed under the reward in use.
"""

from collections.abc import Callable

from sfmrl.config import Config, ConfigError
from sfmrl.episodes import Record, play_episodes, returns_of, rewards_of
from sfmrl.fast import new_network
from sfmrl.learning import Fit, Memory
from sfmrl.lookahead import step_discount
from sfmrl.policies import orca_policy
from sfmrl.rewards import reward_terms
from sfmrl.runs.progress import Progress
from sfmrl.scenes import elements_of, generator, sample_scenes, thinned


def demonstrate(config: Config, progress: Progress) -> Record:
    """Play the imitation episodes with ORCA driving the robot."""
    settings = config.imitation
    scenes = sample_scenes(settings.environment, settings.episodes, config.seed, phase="imitation")
    scenes = thinned(scenes, config.sparse, config.seed)
    with progress("demonstrations", settings.episodes) as told:
        return play_episodes(scenes, orca_policy, config.reward, config.simulation, progress=told)


def make_memory(config: Config) -> Memory:
    """The memory that imitation fills and reinforcement keeps: as many elements as any of their environments has."""
    environments = config.imitation.environment, config.reinforcement.environment
    elements = max(1, *map(elements_of, environments))
    return Memory(config.reinforcement.memory, elements, forces=config.forces, mirror=config.mirror)


def fill_memory(memory: Memory, record: Record, config: Config) -> None:
    """Store the demonstrations' states with their returns under `config`'s reward; timed-out episodes are left out."""
    record = record.take(record.outcome != "timeout")
    rewards = rewards_of(record.transition, record.steps, reward_terms(config.reward))
    returns = returns_of(rewards, step_discount(config.discount, record.scenes.v_pref[:, 0], record.simulation))
    if not len(record.steps):
        raise ConfigError("every demonstration ended in a time-out, and those are not learnt from; allow more time")
    memory.push(record.states(config), returns[record.played])


def new_fit(config: Config) -> Fit:
    """Imitation at its start: a network drawn from the config's seed."""
    network = new_network(config, config.seed)
    return Fit(network, config, generator(config.seed, "fit"))


def fit_memory(fit: Fit, memory: Memory, progress: Progress, keep: Callable[[dict], None]) -> None:
    """Run the epochs that are left; `keep` is given a row of metrics after each."""
    batches = -(-len(memory) // fit.settings.batch_size)
    with progress("imitation", (fit.settings.epochs - fit.epoch) * batches) as told:
        while fit.epoch < fit.settings.epochs:
            loss = fit.run_epoch(memory, told)
            keep({"epoch": fit.epoch, "loss": loss})
