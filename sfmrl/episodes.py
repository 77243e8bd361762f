"""Play episodes to their end, many side by side, and record them in arrays that everything else reads.

When episodes end, waiting ones take their places, so the batch stays full; which episodes share it changes no number.
Rewards and returns are computed from the record afterwards: one set of episodes serves every reward and state.
"""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from sfmrl.batch import Batch
from sfmrl.config import Config, ConfigError, Reward, Simulation
from sfmrl.geometry import length
from sfmrl.lookahead import Notes, Policy, explained, step_discount
from sfmrl.own_code import checked_array, fault, is_write, kind, name_of, read_only, takes_two
from sfmrl.policies import find_policy
from sfmrl.rewards import OUTCOMES, RUNNING, OwnReward, Terms, Transition, as_reward, reward_terms, total
from sfmrl.scenes import Scenes
from sfmrl.states import elements_within, robot_states
from sfmrl.world import World, advance, crowd_velocities, reset, transition

BATCH = 256  # episodes side by side, where a policy does not name another number
TOLERANCE = 1e-4  # m/s by which a policy may exceed v_pref: ORCA computes in float32


@dataclass(frozen=True)
class Record(Batch):
    """E played episodes: arrays over time, NaN (outcome: running) after an episode's end; T the longest's steps.

    scenes: the `Scenes` that were played
    simulation: the `Simulation` in which they were
    steps (E,): how many steps each episode took
    position (E, T + 1, N, 2): m, entry t before step t, row 0 the robot
    velocity (E, T + 1, N, 2): m/s, entry t before step t
    transition: a `Transition` of arrays (E, T)
    reward (E, T): what each step paid
    discounted_return (E,): the rewards' discounted sum from the first step on
    notes: arrays (E, T, ...) by name of what the policy noted at each step (`Policy.explain`), if they were kept
    """

    scenes: Scenes
    simulation: Simulation
    steps: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    transition: Transition
    reward: np.ndarray
    discounted_return: np.ndarray
    notes: Notes = field(default_factory=dict)

    @property
    def outcome(self) -> np.ndarray:
        """How each episode ended, (E,): "success", "collision" or "timeout"."""
        return OUTCOMES[self.transition.outcome[np.arange(len(self.steps)), self.steps - 1]]

    @property
    def time(self) -> np.ndarray:
        """Seconds until the end, (E,)."""
        return self.steps * self.simulation.time_step

    @property
    def played(self) -> np.ndarray:
        """Which steps took place, (E, T) bool."""
        return np.arange(self.reward.shape[1]) < self.steps[:, None]

    def worlds(self) -> World:
        """The worlds before every step played, flat: S of them in the order of episodes, then time."""
        episode, step = np.nonzero(self.played)
        start = reset(self.scenes, self.simulation).take(episode)
        at = (episode, step)
        return World(**{**vars(start), "position": self.position[at], "velocity": self.velocity[at], "steps": step})

    def states(self, config: Config) -> np.ndarray:
        """Robot-centred states before every step played, (S, K, F), as a config has them, in the order of `worlds`."""
        episode, step = np.nonzero(self.played)
        position, velocity = self.position[episode, step], self.velocity[episode, step]
        radius = self.scenes.radius[episode]
        return robot_states(
            position[:, 0],
            velocity[:, 0],
            self.scenes.goal[episode, 0],
            radius[:, 0],
            self.scenes.v_pref[episode, 0],
            elements_within(config.reach, position),
            velocity[:, 1:],
            radius[:, 1:],
            forces=config.forces,
        )


def play(
    scenes: Scenes,
    policy: str | Policy,
    *,
    reward: str | Reward | OwnReward = "crowd",
    robot_visible: bool = True,
    safety_space: float = 0.0,
    crowd: str = "orca",
    discount: float = 0.9,
) -> Record:
    """Play every scene to its end with `policy` and return the record.

    `policy` is a name ("orca", "sarl", a run folder, a weights file: see `load_policy`) or a function that is called
    before every step with the `World` of the E episodes that go on and with the people's coming velocities (E, N, 2) in
    m/s, both read-only, and returns the robots' velocities (E, 2) in m/s, none faster than its v_pref.

    `reward` is "crowd", "sfm", "sfm-discount", "file.py:function", a `Reward` with its numbers, or a function that is
    given a `Transition` and `Reward()` and returns an array, a number a transition. `safety_space` (m) widens the
    discs when ORCA drives the robot; `crowd` is "orca" or "sfm"; `discount` is gamma per second at 1 m/s.

    Raises ConfigError where an argument is none of these, and where a policy or reward returns anything else.
    """
    if not isinstance(scenes, Scenes):
        raise ConfigError(f"scenes is {kind(scenes)}; it takes Scenes, as sample_scenes('circle5', 100) makes them")
    settings = as_reward(reward)
    simulation = Simulation(crowd=crowd, robot_visible=robot_visible, safety_space=safety_space)
    discount = Config(discount=discount).discount  # held to its range
    return play_episodes(scenes, find_policy(policy, reward), settings, simulation, discount=discount)


def play_episodes(
    scenes: Scenes,
    policy: Policy,
    reward: Reward | OwnReward,
    simulation: Simulation,
    *,
    discount: float = 0.9,
    batch: int | None = None,
    keep: bool = False,
    progress: Callable[[int], None] = lambda done: None,
) -> Record:
    """`play` with whole configs, `batch` episodes at a time; calls `progress` with the number that have just ended.

    The record has the policy's notes if `keep`. Raises MemoryError where it would be too large for this machine.
    """
    terms = reward_terms(reward)
    whole = _begin(scenes, policy, simulation)
    count, longest = len(scenes), simulation.longest
    position, velocity = (np.full((count, longest + 1, *whole.position.shape[1:]), np.nan) for _ in range(2))
    position[:, 0], velocity[:, 0] = whole.position, whole.velocity
    kept, notes, steps = {}, {}, np.zeros(count, dtype=int)
    nobody = whole.take(np.arange(0))
    _write(kept, nobody, vars(transition(nobody, np.zeros((0, 2)))), count)  # makes the arrays

    waiting = min(getattr(policy, "batch", BATCH) if batch is None else batch, count)
    world = whole.take(np.arange(waiting))
    while len(world):
        moves = crowd_velocities(world)
        action, noted = _choice(policy, world, moves, keep)
        step = transition(world, action)
        if not world.steps.any():
            terms(step)  # a reward that cannot be used is better found now than after the last episode
        _write(kept, world, vars(step), count)
        _write(notes, world, noted, count)
        world = advance(world, moves, action)
        position[world.episode, world.steps] = world.position
        velocity[world.episode, world.steps] = world.velocity
        ended = step.outcome != RUNNING
        if ended.any():
            steps[world.episode[ended]] = world.steps[ended]
            progress(int(ended.sum()))
            fresh = np.arange(waiting, min(waiting + int(ended.sum()), count))
            world, waiting = _refill(whole, world, ~ended, fresh), waiting + len(fresh)

    most = int(steps.max(initial=0))
    played = Transition(**kept)[:, :most]
    rewards = rewards_of(played, steps, terms)
    first = returns_of(rewards, step_discount(discount, scenes.v_pref[:, 0], simulation))[:, :1].sum(1)
    notes = {name: array[:, :most] for name, array in notes.items()}
    position, velocity = position[:, : most + 1], velocity[:, : most + 1]
    return Record(scenes, simulation, steps, position, velocity, played, rewards, first, notes)


def _begin(scenes: Scenes, policy: Policy, simulation: Simulation) -> World:
    """Prepare the policy and return the world at the start; raises MemoryError if the record would be too large."""
    count, rows = scenes.start.shape[:2]
    needed = 8 * count * simulation.longest * (5 * rows + 7)  # bytes of all that is recorded
    if needed > memory_size():
        raise MemoryError(f"{count} episodes of up to {simulation.longest} steps need {needed / 1e9:.1f} GB")
    if begin := getattr(policy, "begin", None):
        begin(scenes, simulation)
    return reset(scenes, simulation)


def _choice(policy: Policy, world: World, moves: np.ndarray, keep: bool) -> tuple[np.ndarray, Notes]:
    """The policy's actions (E, 2) in m/s, and its notes if `keep`.

    Raises ConfigError where the policy returns anything else, or changes the world.
    """
    name, notes = f"policy {name_of(policy)}", {}
    try:
        given = read_only(world), read_only(moves)
        returned, notes = explained(policy, *given) if keep else (policy(*given), {})
    except (ValueError, AttributeError, TypeError) as error:
        if not is_write(error) and takes_two(policy):
            raise
        raise fault(name, policy, error, "(world, crowd_velocity)") from error
    action = checked_array(name, policy, returned, (len(world), 2), "a velocity (x, y) in m/s for each episode")
    speed, v_pref = length(action), world.v_pref[:, 0]
    if (speed > v_pref + TOLERANCE).any():
        e = int((speed - v_pref).argmax())
        raise ConfigError(
            f"{name} returned a velocity of {speed[e]:.4g} m/s; it must return none above v_pref, {v_pref[e]:.4g} m/s"
        )
    return action, notes


def _write(arrays: dict[str, np.ndarray], world: World, parts: dict[str, np.ndarray], count: int) -> None:
    """Write a step's `parts` (e, ...) into `arrays` (E, T, ...), by name; those still missing are made, of NaN or 0."""
    for name, part in parts.items():
        if name not in arrays:
            empty = np.nan if part.dtype.kind == "f" else 0  # 0 is RUNNING, too
            arrays[name] = np.full((count, world.simulation.longest, *part.shape[1:]), empty, part.dtype)
        arrays[name][world.episode, world.steps] = part


def _refill(whole: World, world: World, going: np.ndarray, fresh: np.ndarray) -> World:
    """The world of the episodes that are `going` on (a mask), and of `fresh` ones (an index array) at their start."""
    changing = ("position", "velocity", "steps")
    joined = {name: np.concatenate((getattr(world, name)[going], getattr(whole, name)[fresh])) for name in changing}
    return replace(whole.take(np.concatenate((world.episode[going], fresh))), **joined)


def memory_size() -> float:
    """The machine's memory in bytes; infinite where the system does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return math.inf


def rewards_of(transition: Transition, steps: np.ndarray, terms: Callable[[Transition], Terms]) -> np.ndarray:
    """The reward of every step played, (E, T), NaN after an episode's end; `transition` (E, T), `steps` (E,).

    `terms` is what `reward_terms` returns.
    """
    played = np.arange(transition.outcome.shape[1]) < steps[:, None]
    rewards = np.full(played.shape, np.nan)
    rewards[played] = total(terms(transition[played]))
    return rewards


def returns_of(rewards: np.ndarray, step_discount: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray:
    """Discounted sum of the rewards from each step on, (E, T).

    `rewards` (E, T) are NaN after an episode's end, and so are the returns; `step_discount` (E,) is that of a step.
    Where `guess` (E, T) is not NaN, it stands for all that follows from that step on.
    """
    returns = np.empty_like(rewards)
    later = np.zeros(len(rewards))
    for t in reversed(range(rewards.shape[1])):
        returns[:, t] = rewards[:, t] + step_discount * later
        later = np.nan_to_num(returns[:, t])
        if guess is not None:
            later = np.where(np.isnan(guess[:, t]), later, guess[:, t])
    return returns
