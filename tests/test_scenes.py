"""The environments obey every rule of the paper's text, and an episode is the same wherever it is sampled."""

import re

import numpy as np
import pytest
from conftest import DATA
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, ks_2samp

from sfmrl.config import ConfigError
from sfmrl.geometry import length
from sfmrl.scenes import ENVIRONMENTS, Scenes, parse_mix, sample_scenes

EPISODES = 300
PAPER = ("1", "2", "3", "4", "5")
PHASES = ("train", "validation", "test", "imitation")
BARRIER = [(-0.6, 0.0), (0.0, 0.0), (0.6, 0.0), (-0.6, -0.6), (0.6, -0.6)]


@pytest.fixture(scope="module")
def scenes() -> dict[str, Scenes]:
    return {name: sample_scenes(name, EPISODES, seed=3) for name in ENVIRONMENTS}


def places(scene: Scenes, e: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of one episode's people and squares."""
    return np.flatnonzero(~scene.square[e])[1:], np.flatnonzero(scene.square[e])


def distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    return length(points[:, None] - others[None])


@pytest.mark.parametrize("name", [*PAPER, "circle", "square"])
def test_the_robot_crosses_from_south_to_north_among_ten_elements_alike(scenes, name):
    scene = scenes[name]
    assert scene.start.shape == scene.goal.shape == (EPISODES, 11, 2)
    assert np.isfinite((scene.start, scene.goal)).all()
    np.testing.assert_array_equal(scene.start[:, 0], np.tile([0.0, -4.0], (EPISODES, 1)))
    np.testing.assert_array_equal(scene.goal[:, 0], np.tile([0.0, 4.0], (EPISODES, 1)))
    assert (scene.radius == 0.3).all()
    assert (scene.v_pref == 1.0).all()
    assert not scene.square[:, 0].any()
    if name != "1":
        squares = {"5": 10, "circle": 0, "square": 0}.get(name, 5)  # after the people
        np.testing.assert_array_equal(scene.square, np.tile(np.arange(11) > 10 - squares, (EPISODES, 1)))


@pytest.mark.parametrize("name", ["1", "2", "3", "4", "circle"])
def test_people_start_near_the_circle_and_want_to_reach_the_opposite_point(scenes, name):
    scene = scenes[name]
    people = ~scene.square
    people[:, 0] = False
    np.testing.assert_array_equal(scene.goal[people], -scene.start[people])
    # Each start lies in a square of side 1 m about a point of the circle of radius 4 m.
    x, y = np.abs(scene.start[people]).T
    nearest = np.hypot(np.maximum(x - 0.5, 0), np.maximum(y - 0.5, 0))
    farthest = np.hypot(x + 0.5, y + 0.5)
    assert (nearest <= 4.0 + 1e-9).all()
    assert (farthest >= 4.0 - 1e-9).all()
    off = length(scene.start[people]) - 4.0
    assert off.min() < -0.4  # the noise is used up to its ends
    assert off.max() > 0.4


@pytest.mark.parametrize("name", ["1", "2", "3", "4", "circle"])
def test_people_keep_clear_of_every_start_and_goal(scenes, name):
    scene = scenes[name]
    for e in range(EPISODES):
        people, squares = places(scene, e)
        agents = np.concatenate(([0], people))
        for points in (scene.start[e, people], scene.goal[e, people]):
            for there in (scene.start[e, agents], scene.goal[e, agents]):
                apart = distances(points, there)
                own = people[:, None] == agents[None]
                assert (apart[~own] >= 0.8 - 1e-12).all()  # two radii and 0.2 m
            assert (distances(points, scene.start[e, squares]) >= 0.8 - 1e-12).all()


def test_environment_1_separate_squares_in_the_disc_0_9_m_clear(scenes):
    scene = scenes["1"]
    reach = length(scene.start[scene.square])
    assert reach.max() <= 3.2
    assert np.mean(reach < 3.2 / np.sqrt(2)) == pytest.approx(0.5, abs=0.12)  # about uniform in the disc
    for e in range(EPISODES):
        people, squares = places(scene, e)
        centres, agents = scene.start[e, squares], np.concatenate(([0], people))
        for there in (scene.start[e, agents], scene.goal[e, agents]):
            assert (distances(centres, there) >= 0.9 - 1e-12).all()
        between = distances(centres, centres)
        assert (between[~np.eye(len(squares), dtype=bool)] >= 0.9 - 1e-12).all()


def test_environment_1_people_have_a_share_of_0_6():
    square = sample_scenes("1", 1000, seed=11).square[:, 1:]
    assert binomtest(int((~square).sum()), square.size, 0.6).pvalue > 1e-3
    assert (~square).sum(1).std() == pytest.approx(np.sqrt(10 * 0.6 * 0.4), rel=0.1)  # each element on its own
    assert (np.diff(square.astype(int), axis=1) >= 0).all()  # people before squares


def test_environment_2_the_barrier_is_fixed(scenes):
    np.testing.assert_allclose(scenes["2"].start[:, 6:], np.tile(BARRIER, (EPISODES, 1, 1)), atol=1e-12)


@pytest.mark.parametrize(("name", "rows"), [("3", slice(6, 11)), ("5", slice(1, 6))])
def test_environments_3_and_5_the_same_barrier_somewhere_in_the_middle(scenes, name, rows):
    squares = scenes[name].start[:, rows]
    centre = squares[:, 1]
    np.testing.assert_allclose(squares - centre[:, None], np.tile(BARRIER, (EPISODES, 1, 1)), atol=1e-12)
    assert (np.abs(centre) <= 1.5).all()
    assert (np.abs(centre).max(0) > 1.4).all()
    np.testing.assert_allclose(centre.mean(0), 0.0, atol=0.2)


def row_of(squares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres (E, 2) of rows of touching squares (E, P, 2), and which lie along x; checks that they are rows."""
    steps = np.diff(squares, axis=1)
    flat = np.isclose(steps[..., 0], 0.6) & np.isclose(steps[..., 1], 0.0)
    upright = np.isclose(steps[..., 0], 0.0) & np.isclose(steps[..., 1], 0.6)
    assert (flat.all(1) | upright.all(1)).all()
    return squares.mean(1), flat[:, 0]


@pytest.mark.parametrize("name", ["4", "5"])
def test_environments_4_and_5_rows_of_three_and_two_without_overlap(scenes, name):
    start = scenes[name].start
    for rows in (slice(6, 9), slice(9, 11)):
        centre, flat = row_of(start[:, rows])
        assert (np.abs(centre) <= 1.5 + 1e-9).all()
        assert (np.abs(centre).max(0) > 1.4).all()
        assert 0.35 < flat.mean() < 0.65
    squares = start[:, 6:] if name == "4" else start[:, 1:]
    apart = np.abs(squares[:, :, None] - squares[:, None]).max(-1)
    pairs = ~np.eye(squares.shape[1], dtype=bool)
    assert (apart[:, pairs] >= 0.6 - 1e-9).all()  # squares of side 0.6 m overlap if nearer than that in x and y


@pytest.mark.parametrize("people", [0, 5, 20])
def test_circle_with_any_number_of_people(people):
    radius = 4.0 if people < 20 else 8.0
    scene = sample_scenes(f"circle{people}", 20, circle=radius)
    assert scene.start.shape == (20, people + 1, 2)
    assert not scene.square.any()
    if people:
        assert (np.abs(length(scene.start[:, 1:]) - radius) <= 0.5 * np.sqrt(2) + 1e-9).all()


def smallest_gaps(points: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The smallest gap between the discs about points (E, N, 2) of each episode, (E,) m."""
    gap = length(points[:, :, None] - points[:, None]) - radius[:, :, None] - radius[:, None]
    return np.where(np.eye(points.shape[1], dtype=bool), np.inf, gap).min((1, 2))


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize("name", ["square", "square1", "square5", "square20"])
def test_people_cross_the_square_from_one_side_to_the_other(name, mixed):
    scene = sample_scenes(name, EPISODES, seed=3, random_attributes=mixed)
    assert scene.start.shape == (EPISODES, 1 + int(name[6:] or 10), 2)
    start, goal = scene.start[:, 1:], scene.goal[:, 1:]
    assert (np.abs((start, goal)) <= 5).all()
    assert (start[..., 0] * goal[..., 0] < 0).all()
    assert np.abs(start).max() > 4.9
    assert binomtest(int((start[..., 0] > 0).sum()), start[..., 0].size).pvalue > 1e-3
    for points in (scene.start, scene.goal):  # the robot's too
        assert smallest_gaps(points, scene.radius).min() >= 0.2 - 1e-12
    if name != "square1":
        there = length(scene.start[:, :, None] - scene.goal[:, None]).min()
        assert there < 0.5  # a start may be where another's goal is


@pytest.mark.parametrize(
    ("file", "name"), [("square", "square5"), ("square_mixed", "square5"), ("circle_mixed", "circle5")]
)
def test_scenes_are_distributed_as_crowdnav_s(file, name):
    with np.load(DATA / f"crowdnav_scenes_5_{file}.npz") as data:
        theirs = Scenes(data["start"], data["goal"], data["radius"], data["v_pref"])
    ours = sample_scenes(name, 1000, seed=1, random_attributes=file.endswith("mixed"))

    def marginals(scenes: Scenes) -> dict[str, np.ndarray]:
        start, goal = scenes.start[:, 1:], scenes.goal[:, 1:]
        radius, v_pref = scenes.radius[:, 1:], scenes.v_pref[:, 1:]
        from_circle = np.abs(length(start) - 4)  # CrowdNav moves those with a high v_pref farther from the circle
        parts = {"x": start[..., 0], "y": start[..., 1], "goal y": goal[..., 1], "radius": radius, "v_pref": v_pref}
        parts |= {"gap": smallest_gaps(scenes.start, scenes.radius), "radius of the last": radius[:, -1]}
        parts |= {"slow": from_circle[v_pref < 0.75], "fast": from_circle[v_pref > 1.25]}
        return {what: part.ravel() for what, part in parts.items()}

    for what, (one, other) in {k: (v, marginals(theirs)[k]) for k, v in marginals(ours).items()}.items():
        if one.size == other.size == 0 or np.ptp(np.concatenate((one, other))) == 0:
            continue
        assert ks_2samp(one, other).pvalue > 1e-3, what
    np.testing.assert_array_equal(ours.start[0, 0], theirs.start[0, 0])
    for scenes in (ours, theirs):
        assert (scenes.radius[:, 0] == 0.3).all()
        assert (scenes.v_pref[:, 0] == 1.0).all()


@pytest.mark.parametrize("name", ["1", "3", "circle", "square", "circle4:0.5,2:0.5"])
@pytest.mark.parametrize("people", [None, 6])
def test_random_attributes_are_those_of_people_who_keep_as_clear_as_ever(name, people):
    scene = sample_scenes(name, 100, seed=2, people=people, random_attributes=True)
    there = ~np.isnan(scene.start[..., 0])
    others = there & ~scene.square
    others[:, 0] = False
    for part, own, low, high in ((scene.radius, 0.3, 0.3, 0.5), (scene.v_pref, 1.0, 0.5, 1.5)):
        assert (part[~others] == own).all()  # the robot's and the squares'
        assert low <= part[others].min() < low + 0.01 * (high - low) < high - 0.01 * (high - low) < part[others].max()
        assert part[others].max() <= high
    assert (scene.preferred_speed == 1.0).all()
    for e in range(100):
        agents = np.append(0, np.flatnonzero(others[e]))
        start, radius, squares = scene.start[e], scene.radius[e], np.flatnonzero(scene.square[e])
        assert smallest_gaps(start[None, agents], radius[None, agents]).min() >= 0.2 - 1e-12
        apart = distances(start[agents], start[squares])
        assert (apart >= 0.6 + radius[agents, None] - 1e-12).all()  # 0.9 m for 0.3 m


def test_a_circle_grows_only_where_people_with_random_attributes_have_no_room():
    for name, low, high in (("circle5", 0.0, 0.0), ("circle", 0.1, 0.4)):
        scene = sample_scenes(name, 500, random_attributes=True)
        reach = length(scene.start) - 0.5 * np.sqrt(2) * scene.v_pref  # without the noise, at least
        assert low <= (reach[:, 1:] > 4.0 + 1e-9).any(1).mean() <= high
        assert reach.max() < 6.0


@pytest.mark.parametrize("name", ["table1", "circle", "square5", "maps"])
def test_without_random_attributes_scenes_are_the_same_bits_and_leave_speeds_alone(name):
    plain, asked = sample_scenes(name, 20, seed=2), sample_scenes(name, 20, seed=2, random_attributes=False)
    assert same_scenes(plain, asked)
    assert plain.preferred_speed is None
    assert (plain.radius == 0.3).all()


def test_on_maps_people_have_random_speeds_and_the_radius_that_they_have_room_for():
    scene = sample_scenes("map:R.1.2/..#../a...G/....b", 50, random_attributes=True)
    assert (scene.radius == 0.3).all()
    assert np.ptp(scene.v_pref[:, 1:3]) > 0.8
    assert (scene.v_pref[:, [0, 3]] == 1.0).all()


@pytest.mark.parametrize("people", [0, 3, 10, 20, 100])
def test_people_sets_how_many_there_are_among_the_same_squares_and_as_far_apart(people):
    plain, scene = sample_scenes("table2", 30, 4), sample_scenes("table2", 30, 4, people=people)
    there = ~np.isnan(scene.start[..., 0])
    assert ((there & ~scene.square).sum(1) == 1 + people).all()
    for e in range(30):
        np.testing.assert_array_equal(scene.start[e][scene.square[e]], plain.start[e][plain.square[e]])
    others = there & ~scene.square
    others[:, 0] = False
    radius = max(4.0, 0.4 * people)  # as much of the circle for each of them as for ten on 4 m
    assert (np.abs(length(scene.start[others]) - radius) <= 0.5 * np.sqrt(2) + 1e-9).all()


def test_people_speed_changes_the_speed_of_people_alone():
    plain, fast = sample_scenes("table1", 30, 4), sample_scenes("table1", 30, 4, people_speed=1.5)
    people = ~plain.square
    people[:, 0] = False
    np.testing.assert_array_equal(fast.v_pref, np.where(people, 1.5, plain.v_pref))
    np.testing.assert_array_equal(fast.start, plain.start)


@pytest.mark.parametrize(("table", "names", "shares"), [("table1", "12", (0.7, 0.3)), ("table2", "2345", (0.25,) * 4)])
def test_tables_mix_their_environments_in_their_shares(table, names, shares):
    sampled = sample_scenes(table, 2000, seed=5).environment
    assert set(sampled) == set(names)
    for name, share in zip(names, shares, strict=True):
        assert binomtest(int((sampled == name).sum()), 2000, share).pvalue > 1e-3


def same_scenes(one: Scenes, other: Scenes) -> bool:
    return all(
        np.array_equal(getattr(one, name), getattr(other, name), equal_nan=name in ("start", "goal"))
        for name in ("start", "goal", "square", "radius", "v_pref", "environment", "episode")
    )


ANY = st.sampled_from(["1", "4", "5", "table1", "table2", "circle5:0.5,square5:0.5"])


@given(st.lists(st.integers(0, 60), min_size=1, max_size=12), ANY, st.booleans())
def test_an_episode_is_the_same_whatever_is_sampled_with_it(numbers, environment, mixed):
    whole = sample_scenes(environment, 61, seed=2, random_attributes=mixed)
    some = sample_scenes(environment, numbers, seed=2, random_attributes=mixed)
    assert same_scenes(some, whole.take(np.array(numbers)))


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize(("environment", "names"), [("table1", "1 2"), ("circle5:0.5,square5:0.5", "circle5 square5")])
def test_a_mix_holds_the_scenes_of_its_environments(environment, names, mixed):
    mix = sample_scenes(environment, 40, random_attributes=mixed)
    for name in names.split():
        mine = mix.environment == name
        assert mine.any()
        assert same_scenes(mix.take(mine), sample_scenes(name, 40, random_attributes=mixed).take(mine))


def test_phases_and_seeds_never_share_a_scene():
    seen = [sample_scenes("1", 100, seed=seed, phase=phase).start[:, 1] for phase in PHASES for seed in (0, 1)]
    places = np.concatenate(seen)
    assert len(np.unique(places, axis=0)) == len(places)


@pytest.mark.parametrize(
    ("call", "remedy"),
    [
        (lambda: sample_scenes("6", 1), "choose 1, 2, 3, 4, 5, maps, circle, square, table1, table2"),
        (lambda: sample_scenes("tabel1", 1), "did you mean table1"),
        (lambda: sample_scenes("1:0.7,2:0.2", 1), "add up to 1, as in 1:0.7,2:0.3"),
        (lambda: sample_scenes("1:half,2:0.5", 1), "share of environment 1 is 'half'; it must be a number"),
        (lambda: sample_scenes("1:nan", 1), "from 0 to 1"),
        (lambda: sample_scenes("1", 1, phase="tset"), "did you mean test"),
        (lambda: sample_scenes("1", [-1]), "counted from 0"),
        (lambda: sample_scenes(["1"], 1), "environment is ['1']; it takes a name or a mix"),
        (lambda: sample_scenes(6, 1), "there is no environment '6'"),
        (lambda: sample_scenes("1", 1, seed=-1), "seed is -1; it must be at least 0"),
        (lambda: sample_scenes("1", 1, people=-1), "people is -1; it must be at least 0"),
        (lambda: sample_scenes("1", 1, people=2.5), "people is 2.5"),
        (lambda: sample_scenes("1", 1, circle=np.nan), "circle is nan; it takes a number"),
        (lambda: sample_scenes("circle60", 1), "fewer people or a larger circle"),
        (lambda: sample_scenes("square400", 1), "in this square; fewer people would fit"),
        (lambda: sample_scenes("sqare", 1), "did you mean square"),
        (lambda: sample_scenes("square1000", 1), "there is no environment 'square1000'"),
        (lambda: sample_scenes("1", 1, people_speed=1.5, random_attributes=True), "exclude each other; leave out one"),
    ],
)
def test_errors_name_the_remedy(call, remedy):
    with pytest.raises(ConfigError, match=re.escape(remedy)):
        call()


def test_an_environment_s_number_is_its_name():
    np.testing.assert_array_equal(sample_scenes(1, 3).start, sample_scenes("1", 3).start)


def test_parse_mix_keeps_the_order_and_adds_up_repeats():
    assert parse_mix("3") == {"3": 1.0}
    assert list(parse_mix("5:0.5, 2:0.5")) == ["5", "2"]
    assert parse_mix("1:0.25,2:0.5,1:0.25") == {"1": 0.5, "2": 0.5}


def test_polygons_are_counter_clockwise_squares_about_their_centres(scenes):
    scene = scenes["1"]
    polygons = scene.polygons
    for e in range(EPISODES):
        _, squares = places(scene, e)
        assert np.isnan(polygons[e, len(squares) :]).all()
        corners = polygons[e, : len(squares)]
        np.testing.assert_allclose(corners.mean(1), scene.start[e, squares], atol=1e-12)
        edges = np.roll(corners, -1, axis=1) - corners
        np.testing.assert_allclose(length(edges), 0.6)
        following = np.roll(edges, -1, axis=1)
        turn = edges[..., 0] * following[..., 1] - edges[..., 1] * following[..., 0]
        np.testing.assert_allclose(turn, 0.36)  # a left turn by 90 degrees at every corner
        assert (np.isclose(edges, 0.0).sum(-1) == 1).all()  # sides along x and y


def test_polygons_of_squares_of_other_sizes_and_of_none():
    start, goal = [[[0, -4], [1, 1], [2, 2]]], [[[0, 4], [0, 0], [0, 0]]]
    scene = Scenes(start, goal, radius=[0.3, 0.3, 0.5], square=[False, False, True])
    np.testing.assert_allclose(scene.polygons[0, 0], [[1.5, 1.5], [2.5, 1.5], [2.5, 2.5], [1.5, 2.5]])
    assert Scenes([[[0, -4]]], [[[0, 4]]]).polygons.shape[:2] == (1, 0)


def test_scenes_broadcast_their_numbers_and_put_a_square_s_goal_at_its_place():
    scene = Scenes(np.zeros((2, 3, 2)), np.ones((2, 3, 2)), radius=[0.3, 0.4, 0.5], square=[False, False, True])
    np.testing.assert_array_equal(scene.radius, [[0.3, 0.4, 0.5]] * 2)
    np.testing.assert_array_equal(scene.goal[:, 2], scene.start[:, 2])
    assert list(scene.episode) == [0, 1]
    assert list(scene.environment) == ["own", "own"]
    assert len(scene.take(slice(1, 2))) == 1


START, GOAL = np.zeros((2, 3, 2)), np.ones((2, 3, 2))
HOLE = np.where(np.arange(3)[None, :, None] == 1, np.nan, START)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"start": [(0, 0)] * 3, "goal": np.zeros((3, 2))}, "start has shape (3, 2)"),
        ({"start": np.zeros((2, 0, 2)), "goal": np.zeros((2, 0, 2))}, "start has shape (2, 0, 2)"),
        ({"start": START, "goal": GOAL[:1]}, "goal has shape (1, 3, 2); it must be that of start"),
        (
            {"start": START, "goal": GOAL, "radius": np.ones((3, 2))},
            "radius must be of float and broadcast",
        ),
        ({"start": START, "goal": GOAL, "v_pref": "fast"}, "v_pref must be of float"),
        ({"start": "here", "goal": GOAL}, "start must be a number"),
        ({"start": START, "goal": GOAL, "radius": 0.0}, "radius must be above 0"),
        ({"start": START, "goal": GOAL, "v_pref": -1.0}, "v_pref and preferred_speed at least 0"),
        ({"start": START, "goal": GOAL, "v_pref": np.nan}, "v_pref and preferred_speed at least 0"),
        ({"start": START, "goal": GOAL, "preferred_speed": -1.0}, "preferred_speed at least 0"),
        ({"start": START, "goal": GOAL, "preferred_speed": "fast"}, "preferred_speed must be of float"),
        ({"start": START, "goal": GOAL, "square": True}, "row 0, which is the robot"),
        ({"start": HOLE[:, [1, 0, 2]], "goal": GOAL}, "row 0 must not be NaN"),
        ({"start": START, "goal": GOAL * np.inf}, "finite"),
        ({"start": START, "goal": HOLE}, "finite"),
    ],
)
def test_scenes_refuse_what_cannot_be_played(arguments, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        Scenes(**arguments)


def test_a_row_without_a_start_is_absent():
    scene = Scenes(HOLE, HOLE)
    assert np.isnan(scene.start[:, 1]).all()
    half = START.copy()
    half[:, 1, 1] = np.nan  # one coordinate is as good as none
    assert np.isnan(Scenes(half, GOAL).start[:, 1]).all()
