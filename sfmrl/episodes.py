"""Play episodes to their end, many side by side, and record them in arrays.

When an episode ends, a waiting one takes its place, so the batch stays full. Results do not depend on the batch.
Rewards and returns are computed from the record afterwards, so one set of episodes serves every reward and state.
"""

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sfmrl.actions import Notes, Policy, explained
from sfmrl.batch import Batch
from sfmrl.config import Config, ConfigError, Reward, Simulation, counted, in_range
from sfmrl.geometry import length
from sfmrl.lookahead import step_discount
from sfmrl.own_code import checked_action, described, name_of, read_only
from sfmrl.policies import config_of, find_policy
from sfmrl.rewards import OUTCOMES, RUNNING, OwnReward, Terms, Transition, reward_terms, total
from sfmrl.scenes import Scenes
from sfmrl.states import states_of
from sfmrl.world import World, advance, crowd_velocities, drive, motion, reset, transition

BATCH = 256  # episodes side by side, unless a policy has its own number
TOLERANCE = 1e-4  # m/s by which a policy may exceed v_pref: ORCA computes in float32

_playing: dict[tuple[int, int], object] = {}  # the plays in progress, by process and id of a policy with `begin`

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True, repr=False)
class Record(Batch):
    """E played episodes of up to T steps; after an episode's end, arrays are NaN and its outcome is RUNNING.

    scenes: the `Scenes` that were played
    simulation: the `Simulation` in which they were played
    steps (E,): how many steps each episode took
    position (E, T + 1, N, 2): m, entry t before step t, row 0 the robot
    velocity (E, T + 1, N, 2): m/s, entry t before step t
    transition: a `Transition` of arrays (E, T)
    reward (E, T): of each step
    discounted_return (E,): the discounted sum of the rewards from the first step on
    notes: arrays (E, T, ...) by name, the policy's `Notes` on each step if they were kept
    heading (E, T + 1): rad, a unicycle robot's, entry t before step t; None if the robot is holonomic
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
    heading: np.ndarray | None = None

    def __repr__(self) -> str:
        ends = ", ".join(f"{(self.outcome == end).sum()} {end}" for end in OUTCOMES[1:])
        return f"Record({counted(len(self), 'episode')}: {ends})"

    def _repr_html_(self) -> str:
        from sfmrl.replay.picture import record_html

        return record_html(self)

    @property
    def outcome(self) -> np.ndarray:
        """How each episode ended, (E,) strings: "success", "collision" or "timeout".

        Compare with these strings; SUCCESS, COLLISION and TIMEOUT are for `transition.outcome`.
        """
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
        """The S worlds before every step played, in the order of episodes, then time."""
        episode, step = np.nonzero(self.played)
        return self.world_at(episode, step)

    def world_at(self, episode: np.ndarray, step: np.ndarray) -> World:
        """The worlds of episodes (S,) before steps (S,)."""
        moved = {name: array[episode, step] for name, array in motion(self).items()}
        return replace(reset(self.scenes, self.simulation).take(episode), steps=step, **moved)

    def states(self, config: Config) -> np.ndarray:
        """Robot-centred states (S, K, F) of the `worlds`, with a config's columns and reach."""
        e, t = np.nonzero(self.played)
        moving = self.position[e, t], self.velocity[e, t]
        lasting = self.scenes.goal[e], self.scenes.radius[e], self.scenes.v_pref[e]
        return states_of(*moving, *lasting, None if self.heading is None else self.heading[e, t], config)


def play(
    scenes: Scenes,
    policy: str | Policy,
    *,
    reward: str | Reward | OwnReward = "crowd",
    simulation: Simulation | None = None,
    robot_visible: bool | None = None,
    safety_space: float | None = None,
    crowd: str | None = None,
    kinematics: str | None = None,
    discount: float = 0.9,
) -> Record:
    """Play every scene to its end with `policy` and return the record.

    `policy` is a name ("orca", "sarl", a run folder, a weights file: see `load_policy`) or a function. It is called
    before every step with the `World` of the E running episodes and with everybody's velocities (E, N, 2) in m/s in the
    coming step, both read-only. It returns the robots' velocities (E, 2) in m/s, none faster than its v_pref.

    `reward` is "crowd", "sfm", "sfm-discount", "file.py:function", a `Reward` with its numbers, or a function. It takes
    a `Transition` and `Reward()`, and returns an array, one number for each transition. `safety_space` (m) is added to
    every radius if ORCA drives the robot; `crowd` is "orca" or "sfm"; `discount` is per second at 1 m/s. If
    `kinematics` is "unicycle", the robot turns at most pi rad/s and drives ahead, whatever velocity the policy returns.
    `simulation` holds all settings of the simulator (time step and limit, squares, ORCA's numbers), by
    default those of the policy's training, or else `Simulation()`; `robot_visible`, `safety_space`, `crowd` and
    `kinematics` override it unless they are None.

    Raises ConfigError for other arguments, and if a policy or reward returns anything else.
    """
    if not isinstance(scenes, Scenes):
        raise ConfigError(f"scenes is {described(scenes)}; it takes Scenes, such as sample_scenes('circle5', 100)")
    if not isinstance(simulation, (Simulation, type(None))):
        raise ConfigError(f"simulation is {described(simulation)}; it takes a Simulation")
    chosen = find_policy(policy, reward)
    own = config_of(chosen).simulation if simulation is None else simulation
    given = {"robot_visible": robot_visible, "safety_space": safety_space, "crowd": crowd, "kinematics": kinematics}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    return play_episodes(scenes, chosen, reward, replace(own, **changes), discount=discount)


def play_episodes(
    scenes: Scenes,
    policy: Policy,
    reward: str | Reward | OwnReward,
    simulation: Simulation,
    *,
    discount: float = 0.9,
    batch: int | None = None,
    keep: bool = False,
    progress: Callable[[int], None] = lambda ended: None,
) -> Record:
    """`play` with whole configs, `batch` episodes at a time, and with the policy's notes in the record if `keep`.

    `progress` is called with the number of episodes that have just ended. Raises MemoryError if the record would be too
    large for this machine.
    """
    terms = reward_terms(reward)
    discount = Config(discount=discount).discount  # checks its range
    check_memory(len(scenes), scenes.start.shape[1], simulation.longest)
    with _begun(policy, scenes, simulation):
        batch = int(in_range("batch", getattr(policy, "batch", BATCH) if batch is None else batch, 1, math.inf))
        moments, parts, notes = _recorded(reset(scenes, simulation), policy, terms, batch, keep, progress)
    steps = 1 + (parts["outcome"] != RUNNING).argmax(1)
    most = int(steps.max(initial=0))
    played = Transition(**parts)[:, :most]
    rewards = rewards_of(played, steps, terms)
    from_each_step = returns_of(rewards, step_discount(discount, scenes.v_pref[:, 0], simulation))
    returns = from_each_step[:, :1].sum(1)  # from the first one on; there is none without scenes
    notes = {name: array[:, :most] for name, array in notes.items()}
    moments = {name: array[:, : most + 1] for name, array in moments.items()}
    return Record(
        scenes, simulation, steps, transition=played, reward=rewards, discounted_return=returns, notes=notes, **moments
    )


@contextmanager
def _begun(policy: Policy, scenes: Scenes, simulation: Simulation) -> Iterator[None]:
    """Call the policy's `begin`, if it has one; raises ConfigError while the same policy is playing already.

    Otherwise both plays would use what the later `begin` has prepared, and their numbers would be wrong.
    """
    begin = getattr(policy, "begin", None)
    if not begin:
        yield
        return
    key, play = (os.getpid(), id(policy)), object()  # a forked process plays by itself
    if _playing.setdefault(key, play) is not play:
        raise ConfigError(f"policy {name_of(policy)} is already playing; play a copy.deepcopy of it instead")
    try:
        begin(scenes, simulation)
        yield
    finally:
        del _playing[key]


def _recorded(
    start: World,
    policy: Policy,
    terms: Callable[[Transition], Terms],
    batch: int,
    keep: bool,
    progress: Callable[[int], None],
) -> tuple[Arrays, Arrays, Notes]:
    """Play all episodes of `start`: arrays (E, T + 1, ...) of their `motion`, their transitions and the notes."""
    moments, parts, notes = Arrays(), Arrays(), Notes()
    count, nobody = len(start), start.take(slice(0))
    _write(moments, start, motion(start), count)
    _write(parts, nobody, vars(transition(nobody, np.zeros((0, 2)))), count)  # makes the arrays, also for no scenes
    waiting = min(batch, count)  # the first of the episodes that wait for their turn
    world = start.take(slice(waiting))
    while len(world):
        moves = crowd_velocities(world)
        action, noted = _choice(policy, world, moves, keep)
        step = transition(world, drive(world, action))
        if not world.steps.any():
            terms(step)  # so a reward that fails does so now, not after the last episode
        _write(parts, world, vars(step), count)
        _check_notes(notes, noted)
        _write(notes, world, noted, count)
        world = advance(world, moves, action)
        _write(moments, world, motion(world), count)
        going = step.outcome == RUNNING
        if ended := int(np.count_nonzero(~going)):
            progress(ended)
            fresh = np.arange(waiting, min(waiting + ended, count))
            world, waiting = _refill(start, world, going, fresh), waiting + len(fresh)
    return moments, parts, notes


def _choice(policy: Policy, world: World, moves: np.ndarray, keep: bool) -> tuple[np.ndarray, Notes]:
    """The policy's actions (E, 2) in m/s, and its notes if `keep`; raises ConfigError if it returns anything else."""
    given = read_only(world), read_only(moves)
    returned, notes = explained(policy, *given) if keep else (policy(*given), {})
    action = checked_action(policy, returned, len(world))
    with np.errstate(over="ignore"):  # such a speed is too high, too
        speed, v_pref = length(action), world.v_pref[:, 0]
    if (speed > v_pref + TOLERANCE).any():
        e = int((speed - v_pref).argmax())
        raise ConfigError(
            f"policy {name_of(policy)} returned a velocity of {speed[e]:.4g} m/s; it must return none above v_pref, "
            f"{v_pref[e]:.4g} m/s"
        )
    return action, notes


def _write(arrays: Arrays, world: World, parts: Arrays, count: int) -> None:
    """Write a step's `parts` (e, ...) into `arrays` (E, T + 1, ...), by name; make missing ones, of NaN or 0."""
    for name, part in parts.items():
        if name not in arrays:
            empty = np.nan if part.dtype.kind == "f" else 0  # 0 is RUNNING, too
            arrays[name] = np.full((count, world.simulation.longest + 1, *part.shape[1:]), empty, part.dtype)
        arrays[name][world.episode, world.steps] = part


def _check_notes(notes: Notes, noted: Notes) -> None:
    """Raise ConfigError if a note (e, ...) of this step does not fit into `notes` (E, T + 1, ...) of earlier ones."""
    for name in notes.keys() & noted.keys():
        part, kept = noted[name], notes[name]
        longer = part.dtype.kind in "SU" and part.dtype.itemsize > kept.dtype.itemsize
        if longer or part.shape[1:] != kept.shape[2:] or not np.can_cast(part.dtype, kept.dtype, "same_kind"):
            now, before = f"{part.shape[1:]} of {part.dtype}", f"{kept.shape[2:]} of {kept.dtype}"
            said = f"the policy's note {name!r} is now {now} per episode, and was {before}"
            raise ConfigError(f"{said}; give it the same shape and type in every step")


def _refill(start: World, world: World, going: np.ndarray, fresh: np.ndarray) -> World:
    """The world of the episodes that are `going` on (a mask), and of `fresh` ones (indices) at their start."""
    now, begun = motion(world) | {"steps": world.steps}, motion(start) | {"steps": start.steps}
    joined: dict[str, Any] = {name: np.concatenate((now[name][going], begun[name][fresh])) for name in now}
    return replace(start.take(np.concatenate((world.episode[going], fresh))), **joined)


def check_memory(episodes: int, rows: int, steps: int) -> None:
    """Raise MemoryError if a record of E episodes, N rows and up to `steps` steps would be too large here."""
    needed = 8 * episodes * steps * (5 * rows + 9)  # bytes of all that is recorded
    if needed > memory_size():
        raise MemoryError(f"{episodes} episodes of up to {steps} steps need {needed / 1e9:.1f} GB")


def memory_size() -> float:
    """The machine's memory in bytes; infinite on systems that do not report it."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return math.inf


def rewards_of(transition: Transition, steps: np.ndarray, terms: Callable[[Transition], Terms]) -> np.ndarray:
    """The rewards (E, T) of transitions (E, T) by `terms` (see `reward_terms`); NaN after an episode's `steps` (E,)."""
    played = np.arange(transition.outcome.shape[1]) < steps[:, None]
    rewards = np.full(played.shape, np.nan)
    rewards[played] = total(terms(transition[played]))
    return rewards


def returns_of(rewards: np.ndarray, step_discount: np.ndarray, value: np.ndarray | None = None) -> np.ndarray:
    """Discounted sums of the rewards from each step on, (E, T), with the discounts for one step, (E,).

    `rewards` (E, T) are NaN after an episode's end, and so are the returns. Earlier returns bootstrap from `value`
    (E, T) where it is not NaN: they use it in place of the return from that step on.
    """
    returns = np.empty_like(rewards)
    later = np.zeros(len(rewards))
    for t in reversed(range(rewards.shape[1])):
        returns[:, t] = rewards[:, t] + step_discount * later
        later = np.nan_to_num(returns[:, t])
        if value is not None:
            later = np.where(np.isnan(value[:, t]), later, value[:, t])
    return returns
