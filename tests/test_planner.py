"""Ways around squares, against straight lines, circles' tangents and a queue of our own."""

import heapq
import math

import numpy as np
import pytest

from sfmrl.config import ConfigError, Planner, Simulation
from sfmrl.episodes import play
from sfmrl.policies import orca_policy
from sfmrl.recovery import RecoveringPolicy
from sfmrl.recovery import planner as planner_module
from sfmrl.recovery.planner import plan, shortest_path, solvable
from sfmrl.scenes import Scenes, sample_scenes


def among_squares(*squares: tuple[float, float], goal=(0.0, 4.0)) -> Scenes:
    """A robot at (0, -4) and squares with these centres."""
    places = [[(0.0, -4.0), *squares]]
    return Scenes(places, [[goal, *squares]], square=[[False] + [True] * len(squares)])


def distances(scenes: Scenes, places, planner: Planner = Planner()) -> np.ndarray:
    places = np.asarray(places, dtype=float)
    return plan(scenes, planner).at(np.zeros(1, dtype=int), places[None])[0]


def test_without_squares_the_way_is_straight():
    scenes = Scenes([[(0, -4)]], [[(0.3, 4.05)]])
    places = np.random.default_rng(0).uniform((-0.9, -4.9), (1.2, 4.9), (500, 2))
    straight = np.hypot(*(places - (0.3, 4.05)).T)
    way = distances(scenes, places)
    assert (way > straight - 0.06).all()
    assert (way < 1.0141 * straight + 0.06).all()


def test_from_outside_the_grid_the_way_leads_to_its_edge():
    scenes = Scenes([[(0, -4)]], [[(0, 4)]])
    grid = plan(scenes, Planner())
    left = grid.corner[0, 0]
    edge, beyond = distances(scenes, [(left, 4.0), (left - 7.0, 4.0)])
    assert beyond == pytest.approx(edge + 7.0)


def test_around_one_square_the_way_is_two_tangents_and_an_arc():
    planner = Planner(resolution=0.05, inflation=0.0)
    way = float(distances(among_squares((0, 0)), [(0, -4)], planner)[0])
    radius = 0.6  # the square's disc and the robot's
    exact = 2 * math.sqrt(16 - radius**2) + radius * 2 * math.asin(radius / 4)
    assert exact - 0.06 < way < 1.014 * exact + 0.06


def test_the_shortest_path_around_a_square_is_accurate_to_two_percent():
    half, radius = 0.3, 0.3
    corner = np.hypot(4 - half, half)  # m from start or goal to the square's nearer corners
    tangent = math.sqrt(corner**2 - radius**2)
    turn = math.asin(radius / corner) + math.atan2(half, 4 - half)  # rad around each of the two corners
    exact = 2 * tangent + 2 * radius * turn + 2 * half
    assert exact < shortest_path(among_squares((0, 0)))[0] < 1.02 * exact


def test_squares_through_which_a_grid_would_lead_are_refused():
    box = [(x, y) for x in np.arange(-1, 1.01, 0.04) for y in (-0.95, 1.05)]
    box += [(x, y) for y in np.arange(-0.95, 1.06, 0.04) for x in (-1, 1)]
    places, row = np.array([[(0, 0), *box]]), np.arange(len(box) + 1) > 0
    scenes = Scenes(places, places + np.array((0, 3)), np.where(row, 0.02, 0.1), square=row[None])
    with pytest.raises(ConfigError, match=r"radii add up to 0\.125 m or more"):
        solvable(scenes)


def brute_force(far: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Dijkstra's algorithm over the 24 steps, for one scene's (Y, X)."""
    rows, columns = far.shape
    moves = [(a, b) for a in range(-3, 4) for b in range(-3, 4) if math.gcd(a, b) == 1 and 1 in (abs(a), abs(b))]
    assert len(moves) == 24
    best = far.astype(float)
    queue = [(best[y, x], y, x) for y, x in zip(*np.nonzero(np.isfinite(best)), strict=True)]
    heapq.heapify(queue)
    while queue:
        length, y, x = heapq.heappop(queue)
        if length > best[y, x]:
            continue
        for a, b in moves:
            i, j = y + a, x + b
            if 0 <= i < rows and 0 <= j < columns:
                longer = length + float(cost[i, j]) * math.hypot(a, b)
                if longer < best[i, j] - 1e-9:
                    best[i, j] = longer
                    heapq.heappush(queue, (longer, i, j))
    return best


def test_the_sweeps_find_what_dijkstra_s_algorithm_finds(monkeypatch):
    seen = []
    shortest = planner_module._shortest
    monkeypatch.setattr(planner_module, "_shortest", lambda *a: seen.append((*a, shortest(*a))) or seen[-1][2])
    plan(sample_scenes("maps:0.5,5:0.5", 6), Planner(resolution=0.2))
    far, cost, found = seen[0]
    for e in range(6):
        wanted = brute_force(far[:, e], cost[:, e])
        np.testing.assert_allclose(found[:, e], wanted, rtol=1e-5, atol=1e-4)


def test_a_scene_s_distances_have_the_same_bits_whatever_shares_the_batch():
    scenes = sample_scenes("maps:0.3,table1:0.7".replace("table1", "1"), 70, seed=2)
    places = np.random.default_rng(1).uniform(-6, 6, (70, 40, 2))
    whole = plan(scenes, Planner()).at(np.arange(70), places)
    for e in (0, 13, 63, 64, 69):
        alone = plan(scenes.take([e]), Planner()).at(np.zeros(1, dtype=int), places[[e]])
        np.testing.assert_array_equal(whole[e], alone[0])


def test_following_the_distances_downhill_leads_to_the_goal_in_every_layout():
    """No place on the way is a dead end, also between the cells and beside the squares."""
    scenes = sample_scenes("maps", 20)
    grid, headings = plan(scenes, Planner()), np.linspace(0, 2 * np.pi, 16, endpoint=False)
    moves = np.stack((np.cos(headings), np.sin(headings)), -1)[None] * np.array([0.25, 0.12, 0.03])[:, None, None]
    at, rows = scenes.start[:, 0].copy(), np.arange(20)
    for _ in range(500):
        there = np.hypot(*(at - scenes.goal[:, 0]).T) < 0.3
        options = at[:, None] + moves.reshape(-1, 2)
        best = grid.at(rows, options).argmin(1)
        at = np.where(there[:, None], at, options[rows, best])
    assert there.all()


def test_a_closed_room_is_named_unsolvable_and_the_twenty_layouts_are_not():
    assert not solvable(sample_scenes("map-closed", 1)).any()
    assert solvable(sample_scenes("maps", 20)).all()
    assert solvable(sample_scenes("table2", 50)).all()
    assert solvable(sample_scenes("1", 0)).shape == (0,)


def test_without_squares_the_shortest_path_is_straight_however_long():
    scenes = Scenes([[(0, 0)]] * 3, [[(390, 390)], [(0, 1e7)], [(0, 0)]])
    assert shortest_path(scenes).tolist() == [math.hypot(390, 390), 1e7, 0.0]
    absent = Scenes([[(0, 0), (np.nan, 0)]], [[(0, 1e7), (0, 0)]], square=[[False, True]])
    assert shortest_path(absent).tolist() == [1e7]
    assert solvable(scenes).all()


def test_a_goal_far_beyond_squares_has_a_path_unless_they_close_it():
    for goal in ((0.0, 1000.0), (390.0, 390.0)):
        way = shortest_path(among_squares((0, 0), (0.6, 0), goal=goal))[0]
        assert way == pytest.approx(math.dist((0, -4), goal), abs=0.2)
    side = np.arange(-3.0, 3.1, 0.6)
    ring = [(x, y - 4) for x in side for y in side if max(abs(x), abs(y)) > 2.9]
    assert not solvable(among_squares(*ring, goal=(0.0, 300.0))).any()


def test_a_long_and_narrow_path_is_a_path():
    walls = [(x, side) for side in (-0.65, 0.65) for x in np.arange(0.0, 60.1, 0.6)]  # 0.7 m between their outlines
    scenes = Scenes([[(-1, 0), *walls]], [[(61, 0), *walls]], square=[[False, *(True for _ in walls)]], radius=0.3)
    assert shortest_path(scenes)[0] == pytest.approx(62.0)
    assert solvable(scenes).all()


def test_many_scenes_are_planned_for_few_at_a_time(monkeypatch):
    scenes = sample_scenes("maps", 80)
    whole = shortest_path(scenes)
    monkeypatch.setattr(planner_module, "MOST_CELLS", 2**19)
    with pytest.raises(ConfigError, match="too many"):
        plan(scenes, Planner())
    np.testing.assert_array_equal(shortest_path(scenes), whole)
    assert solvable(scenes).all()


def test_places_inside_squares_have_finite_distances_that_fall_outwards():
    middle, edge, out = distances(among_squares((0, 0)), [(0.0, 0.0), (0.4, 0.0), (0.9, 0.0)])
    assert middle > edge > out > 3.9


def test_a_goal_or_square_far_out_does_not_make_the_grid_large():
    near = among_squares((0, 0), (0.6, 0))
    far = among_squares((0, 0), (0.6, 0), (0.0, 1e6))
    places = np.random.default_rng(0).uniform(-4, 4, (50, 2))
    np.testing.assert_array_equal(distances(far, places), distances(near, places))
    # To a goal 1e6 m away, the way around the squares, and then the rest of it.
    scenes = among_squares((0, 0), (0.6, 0), goal=(0.0, 1e6))
    grid = plan(scenes, Planner(), reach=np.array([25.0]))
    assert grid.values.size < 1e6
    left = grid.at(np.zeros(1, dtype=int), np.array([[(0.0, -4.0), (0.0, 4.0), (0.0, 5.0)]]))[0]
    assert left[1] == pytest.approx(1e6 - 4, abs=0.1)
    assert left[1] - left[2] == pytest.approx(1.0, abs=0.1)
    assert left[0] > left[1] + 8.2


def test_a_grid_of_too_many_cells_is_one_clear_error():
    scenes = among_squares((0, 0), goal=(1e6, 1e6))
    with pytest.raises(ConfigError, match=r"cells, too many; choose nearer goals, .* or play without recovery"):
        plan(scenes, Planner())
    with pytest.raises(ConfigError, match="too many"):
        RecoveringPolicy(orca_policy, Planner(recover=True)).begin(scenes, Simulation(time_limit=3600))


def test_recovery_leads_past_squares_on_the_way_to_a_goal_far_out():
    scenes = among_squares((-0.6, 0), (0, 0), (0.6, 0), goal=(0.0, 1e6))
    record = play(scenes, RecoveringPolicy(orca_policy, Planner(recover=True)))
    assert list(record.outcome) == ["timeout"]
    assert record.position[0, -1, 0, 1] > 10  # past the squares


def test_the_grid_has_room_to_walk_around_a_square_of_any_size():
    for half in (0.3, 1.0, 3.0):
        scenes = Scenes(
            start=[[[0.0, -6.0], [0.0, 0.0]]],
            goal=[[[0.0, 6.0], [0.0, 0.0]]],
            radius=[[0.3, half]],
            square=[[False, True]],
        )
        assert solvable(scenes).all()
        assert plan(scenes, Planner()).at(np.arange(1), scenes.start[:, 0])[0] < 12.0 + 2 * half
