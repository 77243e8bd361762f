"""Traps against brute force: trying all sequences of actions, one by one."""

import numpy as np
from test_policies import crowded

from sfmrl.actions import ACTIONS
from sfmrl.config import Simulation
from sfmrl.rewards import COLLISION, RUNNING
from sfmrl.scenes import Scenes, sample_scenes
from sfmrl.traps import OUTLOOK, best_untrapped, trapped
from sfmrl.world import World, advance, crowd_velocities, reset, transition


def is_free(world: World, moves: np.ndarray, action: np.ndarray) -> bool:
    """Whether an action neither collides nor leads where all do, by brute force, for a world of one episode."""
    if transition(world, action[None]).outcome[0] != RUNNING:
        return transition(world, action[None]).outcome[0] != COLLISION
    after = advance(world, moves, action[None])
    return bool((transition(after, ACTIONS[None]).outcome != COLLISION).any())


def test_the_best_action_that_is_no_trap_is_found_wherever_there_is_one():
    world = crowded(40, seed=0)
    moves = np.random.default_rng(1).uniform(-1, 1, world.velocity.shape)
    values = np.random.default_rng(2).normal(size=(40, 81))
    actions = np.broadcast_to(ACTIONS, (40, 81, 2))
    found = best_untrapped(world, moves, actions, values, transition(world, actions).outcome)
    kept = passed_over = hopeless = 0
    for e in range(40):
        one = world.take(np.array([e]))
        free = [a for a in range(81) if is_free(one, moves[[e]], ACTIONS[a])]
        best = values[e].argmax()
        missing = np.flatnonzero(transition(one, ACTIONS[None]).outcome[0] != COLLISION).tolist()
        wanted = max(free or missing or range(81), key=lambda a: values[e, a])
        assert found[e] == wanted
        kept += wanted == best
        passed_over += bool(free) and wanted != best
        hopeless += not free
    assert passed_over > 0
    assert hopeless > 0  # the scenes are tight enough to try all three cases
    assert kept > 0


def squeezed(episodes: int, seed: int):
    """Worlds with seven people who walk towards the robot without seeing it, and everybody's next velocities."""
    rng = np.random.default_rng(seed)
    angle, reach = rng.uniform(0, 2 * np.pi, (episodes, 7)), rng.uniform(0.7, 1.8, (episodes, 7))
    around = reach[..., None] * np.stack((np.cos(angle), np.sin(angle)), -1)
    start = np.concatenate((np.zeros((episodes, 1, 2)), around), axis=1)
    world = reset(Scenes(start, -4 * start + [3, 0]), Simulation(robot_visible=False))
    velocity = np.concatenate((np.zeros((episodes, 1, 2)), -around / reach[..., None]), axis=1)
    velocity += rng.normal(0, 0.3, velocity.shape)
    world = type(world)(**{**vars(world), "velocity": velocity})
    return world, crowd_velocities(world)


def has_way_out(world, actions: np.ndarray, steps: int) -> bool:
    """Whether any sequence of `steps` actions has no collision, by trying all, for a world of one episode."""
    free = transition(world, actions[None]).outcome[0] != COLLISION
    if steps == 1:
        return bool(free.any())
    moves = crowd_velocities(world)
    return any(has_way_out(advance(world, moves, action[None]), actions, steps - 1) for action in actions[free])


def test_traps_two_steps_deep_are_those_that_trying_everything_finds():
    world, _ = squeezed(60, seed=0)
    few = ACTIONS[OUTLOOK[::4]]
    found = {steps: trapped(world, np.broadcast_to(few, (60, *few.shape)), steps) for steps in (1, 2)}
    for e in range(60):
        one = world.take(np.array([e]))
        for steps in (1, 2):
            assert found[steps][e] == (not has_way_out(one, few, steps))
    assert 0 < found[1].sum() < found[2].sum() < 60


def test_traps_three_steps_deep_are_found_where_squares_hold_people_up():
    world, few = reset(sample_scenes("4", 80, seed=5), Simulation(robot_visible=False)), ACTIONS[[0, 5, 45]]
    for _ in range(12):
        world = advance(world, crowd_velocities(world), world.preferred_velocity[:, 0])
    two, three = (trapped(world, np.broadcast_to(few, (80, *few.shape)), steps) for steps in (2, 3))
    for e in range(80):
        assert three[e] == (not has_way_out(world.take(np.array([e])), few, 3))
    assert 0 < two.sum() < three.sum() < 80


def test_the_longer_outlook_takes_the_best_action_that_leaves_a_way_out():
    world, moves = squeezed(60, seed=1)
    values = np.random.default_rng(2).normal(size=(60, 81))
    actions = np.broadcast_to(ACTIONS, (60, 81, 2))
    outcome = transition(world, actions).outcome
    values = np.where(outcome == COLLISION, -10.0, values)
    near, far = (best_untrapped(world, moves, actions, values, outcome, steps) for steps in (1, 2))
    changed = np.flatnonzero(near != far)
    assert len(changed)
    for e in changed:
        one, after = world.take(np.array([e])), None
        ranked = [a for a in np.argsort(-values[e], kind="stable") if outcome[e, a] != COLLISION]
        for a in ranked:
            after = advance(one, moves[[e]], ACTIONS[[a]])
            if has_way_out(after, ACTIONS[OUTLOOK], 2):
                break
        assert far[e] == a
