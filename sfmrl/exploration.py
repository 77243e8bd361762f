"""Exploration: play training episodes with some random actions, and store their states with the values to learn.

A state's value to learn is a return that is cut short by bootstrapping: from some later state on, the target network's
value stands for the rewards that follow. With `td`, that is the next state; with `returns`, the state of the next
random action, or none. Every random number comes from the seed and the episode's number, so numbers do not depend on
which episodes are played side by side, or on which process.
"""

from collections.abc import Sequence

import numpy as np

from sfmrl.actions import ACTIONS, robot_actions
from sfmrl.config import Config, Reinforcement
from sfmrl.episodes import Record, play_episodes, returns_of
from sfmrl.learning import Learner
from sfmrl.lookahead import SarlPolicy, step_discount
from sfmrl.scenes import generator, sample_scenes
from sfmrl.world import World

Explored = tuple[Record, np.ndarray]  # E episodes, and which of their steps (E, T) were random


def explore(policy: SarlPolicy, config: Config, episodes: Sequence[int]) -> Explored:
    """Play training episodes epsilon-greedily; returns their record, and which steps (E, T) were random."""
    settings = config.reinforcement
    attributes, longest = config.simulation.random_attributes, config.simulation.longest
    scenes = sample_scenes(settings.environment, episodes, config.seed, phase="train", random_attributes=attributes)
    rngs = [generator(config.seed, "exploration", episode) for episode in episodes]
    random_steps = np.array([rng.random(longest) for rng in rngs]) < epsilon(settings, np.array(episodes))[:, None]
    random_actions = np.array([rng.integers(len(ACTIONS), size=longest) for rng in rngs])  # (E, T), their indices

    def epsilon_greedy(world: World, crowd_velocity: np.ndarray) -> np.ndarray:
        at = (world.episode, world.steps)
        action = robot_actions(world)[np.arange(len(world)), random_actions[at]]
        greedy = np.flatnonzero(~random_steps[at])
        if len(greedy):
            action[greedy] = policy(world.take(greedy), crowd_velocity[greedy])
        return action

    record = play_episodes(scenes, epsilon_greedy, config.reward, config.simulation, discount=config.discount)
    return record, random_steps[:, : record.reward.shape[1]]


def epsilon(settings: Reinforcement, episode: np.ndarray) -> np.ndarray:
    """The share of random actions in training episodes (E,): it falls linearly, then stays."""
    progress = np.minimum(episode / settings.epsilon_episodes, 1.0)
    return settings.epsilon_start + (settings.epsilon_end - settings.epsilon_start) * progress


def remember(learner: Learner, record: Record, random_steps: np.ndarray) -> None:
    """Store the states of a record with the values to learn for them."""
    config, one_step = learner.config, learner.config.reinforcement.targets == "td"
    kept = record.outcome != "timeout" if one_step else np.ones(len(record.steps), dtype=bool)
    record, random_steps = record.take(kept), random_steps[kept]
    states, played = record.states(config), record.played
    # The steps (E, T) at whose start the target network's value replaces the return, for the steps before them.
    bootstrapped = played.copy() if one_step else random_steps & played
    bootstrapped[:, 0] = False  # nothing comes before the first step
    value = np.full(played.shape, np.nan)
    value[bootstrapped] = learner.target.evaluate(states[bootstrapped[played]])[0]  # `states`: a row per step played
    discount = step_discount(config.discount, record.scenes.v_pref[:, 0], record.simulation)
    learner.memory.push(states, returns_of(record.reward, discount, value)[played])
