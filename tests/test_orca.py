"""ORCA against RVO2, on stored and on fresh scenes; the linear programs against brute force; and how agents behave."""

from pathlib import Path

import numpy as np
import pyrvo
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfmrl.geometry import limit
from sfmrl.orca import orca_velocities, polygon_edges
from sfmrl.orca.programs import least_violations, nearest_velocities, violations
from sfmrl.orca.vectors import limit_speed

REFERENCE = np.load(Path(__file__).parent / "data" / "orca_velocities.npz")
SCENE = ("position", "velocity", "preferred_velocity", "radius", "max_speed", "polygons")
PARAMETERS = ("time_step", "neighbor_distance", "max_neighbors", "time_horizon", "obstacle_time_horizon")
DEFAULTS = (0.25, 10.0, 10, 5.0, 5.0)
UNIT_SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
SQUARE = 0.6 * (UNIT_SQUARE - 0.5)
BARRIER = 0.6 * np.array([[-1, 0], [0, 0], [1, 0], [-1, -1], [1, -1]])[:, None] + SQUARE
CONCAVE = np.array([[0, 0], [1.2, 0], [1.2, 0.4], [0.4, 0.4], [0.4, 1.2], [0, 1.2]])


def random_scenes(rng: np.random.Generator, count: int, kind: str, dense: bool, agents: int = 12) -> dict:
    """Scenes of 2 to `agents` agents of mixed size and speed, some of them overlapping if `dense`."""
    half = 1.6 if dense else 4.0
    present = np.arange(agents) < rng.integers(2, agents + 1, count)[:, None]
    position = np.where(present[..., None], rng.uniform(-half, half, (count, agents, 2)), np.nan)
    max_speed = rng.uniform(0.5, 1.5, (count, agents))
    angle, share = rng.uniform(0, 2 * np.pi, (count, agents)), rng.uniform(0, 1, (count, agents))
    way = rng.uniform(-4, 4, (count, agents, 2)) - position
    polygons = np.full((count, 6, 6, 2), np.nan)
    for scene in polygons:
        corner = rng.uniform(-4, 4, 2)
        if kind == "barrier":
            scene[:5, :4] = BARRIER + corner / 2
        elif kind == "squares":
            for polygon in scene[: rng.integers(1, 7)]:
                polygon[:4] = SQUARE + rng.uniform(-4, 4, 2)
        elif kind == "polygons":
            turns = np.sort(rng.uniform(0, 2 * np.pi, 3))
            scene[0, :6] = CONCAVE + corner
            scene[1, :4] = UNIT_SQUARE * rng.uniform(0.3, 2.5, 2) + rng.uniform(-4, 4, 2)
            scene[2, :3] = np.stack([np.cos(turns), np.sin(turns)], -1) + rng.uniform(-4, 4, 2)
    return {
        "position": position,
        "velocity": (max_speed * share)[..., None] * np.stack([np.cos(angle), np.sin(angle)], -1),
        "preferred_velocity": way / np.maximum(1, np.linalg.norm(way, axis=-1, keepdims=True)),
        "radius": rng.uniform(0.2, 0.5, (count, agents)),
        "max_speed": max_speed,
        "polygons": polygons,
    }


def stepped(position, velocity, preferred_velocity, radius, max_speed, polygons, parameters=DEFAULTS):
    """RVO2 after one step of one scene, and the rows of the agents that are present."""
    time_step, distance, neighbors, horizon, obstacle_horizon = parameters
    simulator = pyrvo.RVOSimulator(time_step, distance, neighbors, horizon, obstacle_horizon, 0.3, 1.0)
    for polygon in polygons:
        corners = polygon[~np.isnan(polygon[:, 0])]
        if len(corners):
            simulator.add_obstacle([tuple(corner) for corner in corners.tolist()])
    simulator.process_obstacles()
    present = np.flatnonzero(~np.isnan(position[:, 0]))
    for number, row in enumerate(present):
        place, motion = tuple(position[row].tolist()), tuple(velocity[row].tolist())
        own = float(radius[row]), float(max_speed[row])
        simulator.add_agent(place, distance, neighbors, horizon, obstacle_horizon, *own, motion)
        simulator.set_agent_pref_velocity(number, tuple(preferred_velocity[row].tolist()))
    simulator.do_step()
    return simulator, present


def half_planes(simulator, number: int) -> np.ndarray:
    """RVO2's half-planes (M, 4) of an agent as the linear programs have them, those of polygons first."""
    lines = [simulator.get_agent_orca_line(number, k) for k in range(simulator.get_agent_num_orca_lines(number))]
    return np.array([(*point, *direction) for direction, point in lines], np.float32).reshape(-1, 4)


def rvo2(*scene):
    """RVO2's velocities (N, 2) for one scene, and whether some velocity was permitted (N,)."""
    simulator, present = stepped(*scene)
    result, feasible = np.full(scene[0].shape, np.nan), np.ones(len(scene[0]), bool)
    for number, row in enumerate(present):
        found = simulator.get_agent_velocity(number)
        result[row] = found.x, found.y
        excess = violations(half_planes(simulator, number).T, np.tile(result[row, :, None], 1))
        feasible[row] = excess.max(initial=0) < 1e-5
    return result, feasible


def error_against_rvo2(scenes: dict, parameters=DEFAULTS):
    """How far each present agent's velocity is from RVO2's (K,), and whether RVO2 found one that is permitted (K,)."""
    ours = orca_velocities(*scenes.values(), **dict(zip(PARAMETERS, parameters, strict=True)))
    pairs = [rvo2(*scene, parameters) for scene in zip(*scenes.values(), strict=True)]
    theirs, feasible = (np.array(part) for part in zip(*pairs, strict=True))
    present = ~np.isnan(scenes["position"][..., 0])
    np.testing.assert_array_equal(np.isnan(ours).any(-1), ~present)
    return np.abs(ours - theirs).max(-1)[present], feasible[present]


def take(scenes: dict, rows) -> dict:
    return {name: value[rows] for name, value in scenes.items()}


def test_stored_velocities_of_rvo2():
    parameters = {name: REFERENCE[name].item() for name in PARAMETERS}
    ours = orca_velocities(*(REFERENCE[name] for name in SCENE), **parameters)
    present = ~np.isnan(REFERENCE["position"][..., 0])
    np.testing.assert_array_equal(np.isnan(ours).any(-1), ~present)
    error = np.abs(ours - REFERENCE["expected_velocity"]).max(-1)
    assert (error[present] < 1e-3).mean() >= 0.999
    for kind in np.unique(REFERENCE["kind"]):
        assert (error[present & (REFERENCE["kind"] == kind)[:, None]] < 1e-3).mean() >= 0.99, kind


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("kind", ["none", "squares", "barrier", "polygons"])
def test_fresh_scenes_against_rvo2(kind, dense):
    error, feasible = error_against_rvo2(random_scenes(np.random.default_rng(5), 250, kind, dense))
    # RVO2's search tree cuts edges of polygons that do not stand parallel into pieces; ours stay whole.
    assert (error < 1e-3).mean() >= (0.99 if kind == "polygons" else 0.994)
    if kind == "none":
        assert feasible.mean() > 0.4
        assert error[feasible].max() < 1e-5


@pytest.mark.parametrize(
    "parameters",
    [(0.1, 3.0, 10, 2.0, 1.0), (0.5, 10.0, 3, 5.0, 8.0), (0.25, 10.0, 1, 1.0, 1.0), (0.25, 10.0, 0, 5.0, 5.0)],
)
def test_other_parameters_against_rvo2(parameters):
    error, feasible = error_against_rvo2(random_scenes(np.random.default_rng(6), 100, "squares", False), parameters)
    assert (error < 1e-3).mean() >= 0.994
    error, feasible = error_against_rvo2(random_scenes(np.random.default_rng(7), 100, "none", False), parameters)
    assert error[feasible].max() < 1e-5


def test_crowds_of_fifty_against_rvo2():
    scenes = random_scenes(np.random.default_rng(8), 12, "none", False, agents=50)
    scenes["position"] *= 2.5
    error, feasible = error_against_rvo2(scenes)
    assert len(error) > 200
    assert (error < 1e-3).mean() >= 0.995
    assert error[feasible].max() < 1e-5


def agents_close_to_squares(rng: np.random.Generator, count: int, on_grid: bool) -> dict:
    """Scenes of four agents and two to six squares within reach, side by side where `on_grid`; nobody overlaps any."""
    scenes = {name: [] for name in SCENE}
    while len(scenes["position"]) < count:
        centres = 0.6 * rng.integers(-3, 4, (6, 2)) if on_grid else rng.uniform(-2, 2, (6, 2))
        apart = np.abs(centres[:, None] - centres).max(-1) > 0.6 - 1e-9
        centres = centres[[apart[k, :k].all() for k in range(6)]]
        position = rng.uniform(-2.5, 2.5, (4, 2))
        room = np.linalg.norm(np.maximum(np.abs(position[:, None] - centres) - 0.3, 0), axis=-1)
        gaps = np.linalg.norm(position[:, None] - position, axis=-1) + 9 * np.eye(4)
        if room.min() > 0.32 and gaps.min() > 0.64:
            polygons = np.full((6, 4, 2), np.nan)
            polygons[: len(centres)] = centres[:, None] + SQUARE
            now, wanted = limit(rng.normal(0, 0.7, (4, 2)), 1.0), limit(rng.normal(0, 0.8, (4, 2)), 1.0)
            for name, value in zip(SCENE, (position, now, wanted, [0.31] * 4, [1.0] * 4, polygons), strict=True):
                scenes[name].append(value)
    return {name: np.array(values) for name, values in scenes.items()}


@pytest.mark.parametrize("on_grid", [True, False])
def test_close_to_squares_an_agent_does_as_in_rvo2_wherever_that_keeps_its_own_half_planes(on_grid):
    """Where polygons leave only v = 0, up to rounding, RVO2 stops or moves on by chance; ours always stops."""
    scenes = agents_close_to_squares(np.random.default_rng(0), 750, on_grid)
    ours, same = orca_velocities(*scenes.values()), []
    for scene, velocities in zip(zip(*scenes.values(), strict=True), ours, strict=True):
        simulator, present = stepped(*scene)
        for number in present:
            theirs = simulator.get_agent_velocity(number)
            both = np.array([[theirs.x, theirs.y], velocities[number]])
            hard = half_planes(simulator, number)[: -(len(present) - 1)]  # the others' are the last
            excess = violations(np.tile(hard.T[..., None], 2), both.T).max(axis=0, initial=0)
            if excess[0] < 1e-4:
                same.append(np.linalg.norm(both[0] - both[1]) < 0.01)
    assert len(same) > 2900
    assert np.mean(same) >= 0.998


@pytest.mark.parametrize("way", [(1, 0), (0, 1), (-1, 0), (0, -1)])
def test_agents_head_on_pass_on_the_side_that_rvo2_chooses(way):
    way = np.array(way, dtype=float)
    for apart in (1.0, 1.5, 2.0, 3.0):
        for first, second in ((1.0, 0.0), (1.0, 0.5), (1.0, 1.0), (0.5, 1.0)):
            position, velocity = np.array([0 * way, apart * way]), np.array([first * way, -second * way])
            expected, _ = rvo2(position, velocity, velocity, [0.3] * 2, [1.0] * 2, [])
            found = orca_velocities(position[None], velocity[None], velocity[None], 0.3, 1.0)[0]
            np.testing.assert_allclose(found, expected, atol=1e-5)


def test_of_a_corner_s_two_edges_the_one_first_in_rvo2_s_tree_counts_first():
    position, velocity, wanted = np.array([[[-1.4, 1.4]], [[0.7, -0.72]], [[0.9, 0.25]]])
    for centres in ([(0, 0)], [(0, 0), (0.6, -1.2), (-1.8, -0.6)]):
        squares = np.array(centres)[:, None] + SQUARE
        expected, _ = rvo2(position, velocity, wanted, [0.3], [1.0], squares)
        found = orca_velocities(position[None], velocity[None], wanted[None], 0.3, 1.0, squares[None])[0]
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_walls_of_two_vertices_against_rvo2():
    scenes = random_scenes(np.random.default_rng(9), 100, "none", False)
    scenes["polygons"][:, 0, :2] = np.random.default_rng(10).uniform(-3, 3, (100, 2, 2))
    error, _ = error_against_rvo2(scenes)
    assert (error < 1e-3).mean() >= 0.994


def random_programs(seed: int, lines: int, reach: float, programs: int = 40):
    """Half-planes (4, M, Q), speed limits (Q,) and preferred velocities (2, Q)."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, (lines, programs))
    point = rng.uniform(-reach, reach, (2, lines, programs))
    half_planes = np.stack([*point, np.cos(angle), np.sin(angle)]).astype(np.float32)
    return half_planes, rng.uniform(0.5, 1.5, programs).astype(np.float32), rng.normal(size=(2, programs)).astype("f4")


def sampled(speed: float) -> np.ndarray:
    """Velocities (2, K) all over a disc, its edge included."""
    radius, angle = np.meshgrid(np.linspace(0, speed, 60), np.linspace(0, 2 * np.pi, 180, endpoint=False))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)]).reshape(2, -1)


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), lines=st.integers(1, 8), reach=st.floats(0.05, 1.5))
def test_no_sampled_velocity_beats_the_nearest_one(seed, lines, reach):
    half_planes, speed, preferred = random_programs(seed, lines, reach)
    with np.errstate(all="ignore"):
        found, feasible = nearest_velocities(half_planes, speed, preferred)
    assert (np.hypot(*found) <= speed + 1e-5).all()
    assert (violations(half_planes, found)[:, feasible] < 1e-4).all()
    for q in range(len(speed)):
        tries = sampled(speed[q])
        permitted = (violations(half_planes[:, :, q, None], tries) < -1e-5).all(axis=0)
        if not feasible[q]:
            assert not permitted.any()
        elif permitted.any():
            least = np.hypot(*(tries - preferred[:, q, None]))[permitted].min()
            assert np.hypot(*(found[:, q] - preferred[:, q])) <= least + 1e-5


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), soft=st.integers(2, 8), hard=st.integers(0, 3))
def test_no_sampled_velocity_violates_the_half_planes_less(seed, soft, hard):
    half_planes, speed, preferred = random_programs(seed, hard + soft, 0.8)
    half_planes[:2, :hard] = 0  # at rest, no hard half-plane is violated
    with np.errstate(all="ignore"):
        start, feasible = nearest_velocities(half_planes, speed, preferred)
        rest = np.flatnonzero(~feasible)
        found, exists = least_violations(half_planes[:, :, rest], hard, speed[rest], start[:, rest].copy())
    for q, velocity in zip(rest[exists], found.T[exists], strict=True):
        tries = np.column_stack([sampled(speed[q]), velocity])
        excess = violations(half_planes[:, :, q, None], tries)
        assert np.hypot(*velocity) <= speed[q] + 1e-5
        assert (excess[:hard, -1] < 1e-4).all()
        permitted = (excess[:hard] < -1e-5).all(axis=0)
        assert excess[hard:, -1].max() <= excess[hard:, permitted].max(axis=0).min(initial=np.inf) + 1e-4
    assert exists.sum() >= 0.9 * len(exists)


def test_a_half_plane_of_zeros_changes_nothing():
    half_planes, speed, preferred = random_programs(3, 5, 0.6)
    padded = np.concatenate([np.zeros_like(half_planes[:, :2]), half_planes, np.zeros_like(half_planes[:, :1])], axis=1)
    for lines, hard in ((half_planes, 0), (padded, 2)):
        with np.errstate(all="ignore"):
            found, feasible = nearest_velocities(lines, speed, preferred)
            rest = np.flatnonzero(~feasible)
            found[:, rest], _ = least_violations(lines[:, :, rest], hard, speed[rest], found[:, rest].copy())
        if hard == 0:
            expected = found, feasible
    assert 0 < len(rest) < len(speed)
    np.testing.assert_array_equal(feasible, expected[1])
    np.testing.assert_allclose(found, expected[0], atol=1e-5)


def test_limit_speed():
    with np.errstate(all="ignore"):
        limited = limit_speed(np.array([[3.0, 0.3, 0.0], [4.0, 0.4, 0.0]], "f4"), np.full(3, 2.0, "f4"))
    np.testing.assert_allclose(limited, [[1.2, 0.3, 0.0], [1.6, 0.4, 0.0]], rtol=1e-6)


def walk(start, goal, polygons=None, seconds=20.0, radius=0.3):
    """Positions (T, N, 2) of agents who walk from `start` to `goal`, 1 m/s at most."""
    positions, velocity = [np.asarray(start, float)], np.zeros((1, *np.shape(start)))
    edges = None if polygons is None else polygon_edges(polygons[None], positions[-1][None])
    for _ in range(int(seconds / 0.25)):
        way = np.asarray(goal) - positions[-1]
        preferred = way / np.maximum(1, np.linalg.norm(way, axis=-1, keepdims=True))
        velocity = orca_velocities(positions[-1][None], velocity, preferred[None], radius + 0.01, 1.0, edges)
        positions.append(positions[-1] + 0.25 * velocity[0])
    return np.array(positions)


def test_two_agents_head_on_pass_without_touching():
    positions = walk([[-4, 0.0], [4, 0.01]], [[4, 0.0], [-4, 0.01]])
    distance = np.linalg.norm(positions[:, 0] - positions[:, 1], axis=-1)
    assert 0.6 <= distance.min() < 0.8
    np.testing.assert_allclose(positions[-1], [[4, 0], [-4, 0.01]], atol=0.05)


def test_ten_agents_cross_a_circle_without_touching():
    angle = np.arange(10) * 2 * np.pi / 10 + np.random.default_rng(2).uniform(-0.2, 0.2, 10)
    start = 4 * np.stack([np.cos(angle), np.sin(angle)], -1)
    positions = walk(start, -start, seconds=40.0)
    distance = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1) + 10 * np.eye(10)
    assert distance.min() >= 0.59
    np.testing.assert_allclose(positions[-1], -start, atol=0.3)


def test_an_agent_walks_around_a_square_and_never_into_the_barrier():
    square = np.array([[-0.3, -0.3], [0.3, -0.3], [0.3, 0.3], [-0.3, 0.3]])
    path = walk([[-3, -1]], [[3, 1.5]], square[None])[:, 0]
    outside = np.linalg.norm(np.maximum(np.abs(path) - 0.3, 0), axis=-1)
    assert outside.min() >= 0.3
    np.testing.assert_allclose(path[-1], [3, 1.5], atol=0.05)
    trapped = walk([[0.1, -3]], [[0, 3]], BARRIER)[:, 0]  # into the open side, where ORCA sees no way around
    centres = BARRIER.mean(axis=1)
    outside = np.linalg.norm(np.maximum(np.abs(trapped[:, None] - centres) - 0.3, 0), axis=-1)
    assert outside.min() >= 0.3


def mixed_scenes(count=120) -> dict:
    rng = np.random.default_rng(11)
    parts = [random_scenes(rng, count // 4, kind, True) for kind in ("none", "squares", "barrier", "polygons")]
    scenes = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    scenes["position"][::7, 3] = np.nan
    return scenes


def test_an_episode_has_the_same_bits_in_any_batch():
    scenes = mixed_scenes()
    together = orca_velocities(*scenes.values())
    alone = [orca_velocities(*take(scenes, slice(e, e + 1)).values())[0] for e in range(len(together))]
    np.testing.assert_array_equal(together, alone)
    order = np.random.default_rng(0).permutation(len(together))
    np.testing.assert_array_equal(together[order], orca_velocities(*take(scenes, order).values()))
    many = {name: np.concatenate([value] * 9) for name, value in scenes.items()}
    np.testing.assert_array_equal(np.concatenate([together] * 9), orca_velocities(*many.values()))


def test_absent_agents_and_polygons_change_no_bit():
    scenes = mixed_scenes()
    together = orca_velocities(*scenes.values())
    padded, rows = {}, [*range(2, 8), *range(9, 15)]
    for name, value in scenes.items():
        filler = np.nan if name in ("position", "polygons") else 0.5
        padded[name] = np.full((len(value), 15, *value.shape[2:]), filler)
        padded[name][:, rows[: value.shape[1]]] = value
    np.testing.assert_array_equal(together, orca_velocities(*padded.values())[:, rows])
    crowd = random_scenes(np.random.default_rng(12), 30, "none", True, agents=30)
    crowd["position"] = np.round(crowd["position"], 1)  # many agents are equally far away
    sparse = {name: np.full((30, 60, *value.shape[2:]), np.nan) for name, value in crowd.items()}
    for name in SCENE[:-1]:
        sparse[name][:, 1::2] = crowd[name]
    sparse["polygons"] = crowd["polygons"]
    np.testing.assert_array_equal(orca_velocities(*crowd.values()), orca_velocities(*sparse.values())[:, 1::2])


def test_only_the_agents_asked_for_are_computed_but_all_are_avoided():
    scenes = mixed_scenes()
    together = orca_velocities(*scenes.values())
    agents = np.random.default_rng(13).random(together.shape[:2]) < 0.3
    some = orca_velocities(*scenes.values(), agents=agents)
    np.testing.assert_array_equal(some[agents], together[agents])
    assert np.isnan(some[~agents]).all()
    robot = np.zeros(together.shape[:2], bool)
    robot[:, 0] = True
    np.testing.assert_array_equal(orca_velocities(*scenes.values(), agents=robot)[:, 0], together[:, 0])


def test_prepared_edges_can_be_taken():
    scenes = mixed_scenes()
    together = orca_velocities(*scenes.values())
    edges = polygon_edges(scenes["polygons"], scenes["position"])
    for rows in (np.array([70, 3, 3, 99]), slice(40, 50), np.arange(120) >= 50):
        some = take(scenes, rows) | {"polygons": edges.take(rows)}
        np.testing.assert_array_equal(orca_velocities(*some.values()), together[rows])


@pytest.mark.parametrize(
    ("shift", "off"),
    [((0.0, 0.0), 0), ((64e4, -64.0), 0), ((1e6, 1e6), 0), ((1e4, -1e4), 1e-4), ((5e5 + 1 / 3, 4.6e6), 1e-4)],
)
def test_velocities_are_the_same_wherever_a_scene_stands(shift, off):
    """To the bit where all is moved by a multiple of 64 m, else to what float32 tells apart within 32 m."""
    scenes = mixed_scenes()
    for name in ("position", "polygons"):
        scenes[name] = np.round(scenes[name] * 2**24) / 2**24  # which float64 can move without rounding
    there = scenes | {name: scenes[name] + shift for name in ("position", "polygons")}
    here, found = orca_velocities(*scenes.values()), orca_velocities(*there.values())
    assert np.nanquantile(np.abs(found - here), 1.0 if off == 0 else 0.99) <= off
    prepared = there | {"polygons": polygon_edges(there["polygons"], there["position"])}
    np.testing.assert_array_equal(orca_velocities(*prepared.values()), found)


@pytest.mark.parametrize("shape", [(0, 3), (4, 0), (4, 1), (4, 3)])
def test_scenes_without_agents_with_one_agent_and_without_polygons(shape):
    position = np.full((*shape, 2), np.nan)
    position[:, :1] = 1.0
    position[1:2] = np.nan
    wish = np.full((*shape, 2), 3.0)
    for polygons in (None, np.full((shape[0], 0, 4, 2), np.nan), np.full((shape[0], 2, 4, 2), np.nan)):
        found = orca_velocities(position, np.zeros_like(wish), wish, 0.3, 1.0, polygons)
        assert found.shape == position.shape
        assert found.dtype == np.float64
        np.testing.assert_array_equal(np.isnan(found), np.isnan(position))
        np.testing.assert_allclose(found[~np.isnan(found)], np.sqrt(0.5), rtol=1e-6)


def test_lists_and_polygons_without_vertices_are_accepted():
    position, still, wish = [[[0, 0], [2, 0]]], [[[0, 0], [0, 0]]], [[[1, 0], [-1, 0]]]
    expected = orca_velocities(np.array(position, float), np.array(still, float), np.array(wish, float), 0.3, 1.0)
    np.testing.assert_array_equal(orca_velocities(position, still, wish, [0.3, 0.3], 1), expected)
    np.testing.assert_array_equal(orca_velocities(position, still, wish, 0.3, 1, np.empty((1, 2, 0, 2))), expected)


def test_float32_input_gives_the_same_bits():
    scenes = mixed_scenes()
    rounded = {name: value.astype(np.float32) for name, value in scenes.items()}
    np.testing.assert_array_equal(orca_velocities(*scenes.values()), orca_velocities(*rounded.values()))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": np.zeros((5, 2))}, "position must have shape"),
        ({"velocity": np.zeros((2, 4, 2))}, "velocity must broadcast"),
        ({"preferred_velocity": np.zeros((2, 3))}, "preferred_velocity must broadcast"),
        ({"radius": np.ones((3, 2))}, "radius must broadcast"),
        ({"max_speed": np.ones(4)}, "max_speed must broadcast"),
        ({"agents": np.ones(4, bool)}, "agents must broadcast"),
        ({"polygons": UNIT_SQUARE}, "polygons must have shape"),
        ({"polygons": np.tile(UNIT_SQUARE, (3, 1, 1, 1))}, "polygons must belong to 2 episodes"),
        ({"polygons": np.tile(UNIT_SQUARE[::-1], (2, 1, 1, 1))}, "polygons: vertices must run counter-clockwise"),
        ({"polygons": np.ones((2, 1, 1, 2))}, "polygons: a polygon needs two vertices"),
        ({"polygons": np.tile(UNIT_SQUARE[[0, 1, 1, 2]], (2, 1, 1, 1))}, "polygons: two equal vertices in a row"),
        ({"polygons": np.tile(UNIT_SQUARE[[0, 1, 2, 0]], (2, 1, 1, 1))}, "polygons: two equal vertices in a row"),
        ({"polygons": np.array([np.nan, 1, 1, 1])[:, None] * np.ones((2, 1, 4, 2))}, "polygons: absent vertices"),
        ({"polygons": np.full((2, 1, 4, 2), np.inf)}, "polygons: vertices must be finite"),
        ({"position": np.full((2, 3, 2), np.inf)}, "position must be finite for everybody whose position is not NaN"),
        ({"velocity": np.full((2, 3, 2), np.nan)}, "velocity must be finite"),
        ({"preferred_velocity": np.full((2, 3, 2), -np.inf)}, "preferred_velocity must be finite"),
        ({"radius": -0.1}, "radius must be finite and not below 0"),
        ({"max_speed": np.inf}, "max_speed must be finite"),
        ({"max_speed": "fast"}, "max_speed must be a number"),
        ({"velocity": [[1, 2], [3]]}, "velocity must be a number or an array of numbers"),
        ({"max_neighbors": 2.5}, "max_neighbors is 2.5; it must be a whole number, 0 or more"),
        ({"max_neighbors": -1}, "max_neighbors is -1"),
        ({"time_step": 0.0}, "time_step is 0.0; it must be a finite number above 0"),
        ({"time_horizon": np.nan}, "time_horizon is nan"),
        ({"obstacle_time_horizon": [1, 2]}, "obstacle_time_horizon is"),
        ({"neighbor_distance": -1}, "neighbor_distance is -1; it must be a finite number, 0 or more"),
        ({"agents": [0]}, "agents must be an array of bool: True for the agents to compute, False for the others"),
    ],
)
def test_bad_input_is_named_in_one_line(change, message):
    good = {
        "position": np.zeros((2, 3, 2)),
        "velocity": np.zeros((2, 3, 2)),
        "preferred_velocity": np.zeros((2, 3, 2)),
        "radius": 0.3,
        "max_speed": np.ones(3),
    }
    with pytest.raises(ValueError, match=message) as caught:
        orca_velocities(**(good | change))
    assert "\n" not in str(caught.value)
