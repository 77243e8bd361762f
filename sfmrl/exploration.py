"""Exploration: training episodes with random actions among the greedy ones, and what is kept of them.

Two kinds of value to learn: `td`, the reward plus the target network's value of the next state; and `returns`, the
discounted rewards that really followed, up to the next random action, from where the target network speaks. Every
random number comes from the seed and the episode's number, so what is played side by side changes none, nor on which
process.
"""

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import cache, partial
from threading import Thread

import numpy as np

from sfmrl.actions import ACTIONS
from sfmrl.config import Config, Reinforcement
from sfmrl.crowd import World
from sfmrl.episodes import Record, play_episodes, returns_of
from sfmrl.fast import FastNetwork, Sizes, new_network
from sfmrl.learner import Learner
from sfmrl.lookahead import SarlPolicy, step_discount
from sfmrl.scenes import generator, sample_scenes, thinned
from sfmrl.stopping import SIGNALS, held_back

Explored = tuple[Record, np.ndarray]


class Explorer:
    """Plays training episodes with a network, on a process of its own if `aside`; a context manager.

    Two threads of one process would wait for each other between the network's many operations. Should the process be
    killed, its work is done here.
    """

    def __init__(self, config: Config, threads: int, aside: bool, sizes: Sizes = Sizes()) -> None:
        self._config, self._threads = config, threads
        self._pool = self._policy = None
        if aside:
            spawn = multiprocessing.get_context("spawn")  # a fork would inherit threads in the middle of work
            self._pool = ProcessPoolExecutor(1, spawn, _prepare)
            with held_back():  # what the new process inherits: its imports are not interrupted
                self._pool.submit(_policy, config, threads, sizes)  # all that takes time before the first episode

    def __enter__(self) -> "Explorer":
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool:
            self._pool.shutdown(cancel_futures=True)

    def start(self, actor: FastNetwork, *what: Sequence[int]) -> Callable[[], Explored]:
        """Begin to `explore` the episodes and scenes `what`, and return a function that waits for the outcome.

        Without a process aside, that function does the work. The actor must stay as it is until then.
        """
        here = partial(self._explore, actor, *what)
        if self._pool is None:
            return here
        weights = actor.flat.copy()
        try:
            future = self._pool.submit(_explore_aside, weights, actor.sizes, self._config, self._threads, *what)
        except BrokenProcessPool:
            self._pool = None
            return here

        def outcome() -> Explored:
            try:
                return future.result()
            except BrokenProcessPool:
                self._pool = None
                return here()

        return outcome

    def _explore(self, actor: FastNetwork, *what: Sequence[int]) -> Explored:
        if self._policy is None or self._policy.network is not actor:
            self._policy = SarlPolicy(actor, self._config, self._threads)
        return explore(self._policy, self._config, *what)


def _prepare() -> None:
    """Leave signals to the process that asked for this one, and end with it."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


@cache
def _policy(config: Config, threads: int, sizes: Sizes) -> SarlPolicy:
    return SarlPolicy(new_network(config, sizes=sizes), config, threads)


def _explore_aside(weights: np.ndarray, sizes: Sizes, config: Config, threads: int, *what: Sequence[int]) -> Explored:
    policy = _policy(config, threads, sizes)
    policy.network.flat[:] = weights
    return explore(policy, config, *what)


def explore(
    policy: SarlPolicy, config: Config, episodes: Sequence[int], numbers: Sequence[int] | None = None
) -> Explored:
    """Play training episodes with epsilon-greedy actions; their record, and which steps (E, T) were random.

    They are played in the scenes of these `numbers`, by default their own; the episode decides what is random.
    """
    settings = config.reinforcement
    scenes = sample_scenes(settings.environment, episodes if numbers is None else numbers, config.seed, phase="train")
    scenes = thinned(scenes, config.sparse, config.seed)
    most = config.simulation.longest
    rngs = [generator(config.seed, "exploration", episode) for episode in episodes]
    random_steps = np.array([rng.random(most) for rng in rngs]) < epsilon(settings, np.array(episodes))[:, None]
    picks = ACTIONS[np.array([rng.integers(len(ACTIONS), size=most) for rng in rngs])]  # (E, T, 2)

    def epsilon_greedy(world: World, crowd_velocity: np.ndarray) -> np.ndarray:
        at = (world.episode, world.steps)
        action = picks[at] * world.v_pref[:, :1]
        greedy = np.flatnonzero(~random_steps[at])
        if len(greedy):
            action[greedy] = policy(world.take(greedy), crowd_velocity[greedy])
        return action

    record = play_episodes(scenes, epsilon_greedy, config.reward, config.simulation, discount=config.discount)
    return record, random_steps[:, : record.reward.shape[1]]


def epsilon(settings: Reinforcement, episode: np.ndarray) -> np.ndarray:
    """The share of random actions in training episodes, a straight line and then level: (E,)."""
    progress = np.minimum(episode / settings.epsilon_episodes, 1.0)
    return settings.epsilon_start + (settings.epsilon_end - settings.epsilon_start) * progress


def remember(learner: Learner, record: Record, random_steps: np.ndarray) -> None:
    """Store the states of a record with the values to learn for them, and note in which scenes the robot failed."""
    config, settings = learner.config, learner.config.reinforcement
    learner.note_failures(record.scenes.episode, record.outcome)
    kept = np.flatnonzero((record.outcome != "timeout") | (settings.targets == "returns"))
    if not len(kept):
        return
    record, random_steps = record.take(kept), random_steps[kept]
    states, played = record.states(config), record.played
    # A state's value is asked of the target network where the step before it bootstraps from it.
    asked = random_steps & played if settings.targets == "returns" else played.copy()
    asked[:, 0] = False
    guess = np.full(played.shape, np.nan)
    if asked.any():
        guess[asked] = learner.target.evaluate(states[asked[played]])[0]
    step = step_discount(config.discount, record.scenes.v_pref[:, 0], record.simulation)
    learner.memory.push(states, returns_of(record.reward, step, guess)[played])
