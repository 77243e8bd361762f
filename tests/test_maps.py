"""Maps drawn in text: read and drawn to the same, bad ones named by line and column, layouts, and use by commands."""

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from hypothesis import given
from hypothesis import strategies as st

from sfmrl import draw_map, evaluate, load_map, load_policy, play, read_map, sample_scenes
from sfmrl.config import ConfigError, Planner, Simulation
from sfmrl.maps import why_unsolvable
from sfmrl.maps.format import parse
from sfmrl.recovery import with_recovery
from sfmrl.recovery.planner import solvable
from sfmrl.runs.create import start_run
from sfmrl.runs.folders import finished
from sfmrl.runs.progress import Interrupted, StopSignal, no_progress
from sfmrl.runs.run import open_run
from sfmrl.runs.training import run_reinforcement
from sfmrl.scenes import elements_of
from sfmrl.variants import make_config
from sfmrl.world import reset

ROOM = """\
#############
#.....#.....#
#..R..#..G..#
#.....#.....#
#.....#..1..#
#...........#
#..a........#
#############
"""
TINY = ["--episodes", "4", "--parallel", "2", "--batches", "1", "--batch-size", "8", "--memory", "500"]
TINY += ["--validation-episodes", "2", "--test-episodes", "2", "--time-limit", "4", "--threads", "1"]


@st.composite
def maps(draw) -> list[str]:
    """Lines of maps that can be read: all sizes and people, squares anywhere but opposite to people without a goal.

    Nor are there squares on both sides of the robot.
    """
    rows, columns = draw(st.integers(3, 9)), draw(st.integers(3, 9))
    free = draw(st.permutations([(r, c) for r in range(rows) for c in range(columns)]))
    cells = {free.pop(): "R", free.pop(): "G"}
    robot, kept = next(iter(cells)), set()
    for person in draw(st.lists(st.sampled_from(range(9)), unique=True, max_size=min(4, len(free) // 3))):
        place = next((p for p in free if abs(p[0] - robot[0]) + abs(p[1] - robot[1]) > 1), None)
        if place is None:
            break
        free.remove(place)
        cells[place] = "123456789"[person]
        if draw(st.booleans()):
            cells[free.pop()] = "abcdefghi"[person]
        else:
            kept.add((rows - 1 - place[0], columns - 1 - place[1]))
    opposite_is_free = [place for place in free if place not in kept]
    squares = set(draw(st.lists(st.sampled_from(opposite_is_free), max_size=20)) if opposite_is_free else [])
    r, c = robot
    for one, other in (((r - 1, c), (r + 1, c)), ((r, c - 1), (r, c + 1))):
        squares -= {one} if other in squares else set()
    cells |= dict.fromkeys(squares, "#")
    return ["".join(cells.get((r, c), ".") for c in range(columns)) for r in range(rows)]


def places(lines: list[str]) -> dict[str, list[np.ndarray]]:
    """By character, where it stands, in m from the middle of the lines."""
    found: dict[str, list[np.ndarray]] = {}
    for row, line in enumerate(lines):
        for column, character in enumerate(line):
            x, y = 0.6 * (column + 0.5 - len(line) / 2), 0.6 * (len(lines) / 2 - row - 0.5)
            found.setdefault(character, []).append(np.array((x, y)))
    return found


def normal_form(lines: list[str]) -> str:
    """Margins cut evenly, people numbered in order, and no goals drawn that are opposite anyway."""
    people = sorted(set("".join(lines)) & set("123456789"))
    found = places(lines)
    for person in people:
        goal = "abcdefghi"[int(person) - 1]
        if goal in found and np.allclose(found[goal][0], -found[person][0]):
            lines = [line.replace(goal, ".") for line in lines]
    order = {person: str(k) for k, person in enumerate(people, start=1)}
    order |= {"abcdefghi"[int(person) - 1]: "abcdefghi"[k] for k, person in enumerate(people)}
    lines = [line.translate(str.maketrans(order)) for line in lines]
    while set(lines[0] + lines[-1]) == {"."}:
        lines = lines[1:-1]
    while {line[0] for line in lines} | {line[-1] for line in lines} == {"."}:
        lines = [line[1:-1] for line in lines]
    return "\n".join(lines) + "\n"


def assert_same(one, other) -> None:
    for name in ("start", "goal", "square"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@given(maps())
def test_a_map_is_read_drawn_and_read_again_to_the_same(lines):
    scene = read_map("\n".join(lines))
    drawn = draw_map(scene)
    assert drawn == normal_form(lines)
    assert_same(read_map(drawn), scene)
    assert draw_map(read_map(drawn)) == drawn


@given(maps())
def test_everything_is_where_it_is_drawn_but_the_robot_off_the_squares_beside_it(lines):
    scene, found = read_map("\n".join(lines)), places(lines)
    people = sorted(set(found) & set("123456789"))
    goals = [found.get("abcdefghi"[int(p) - 1], [-found[p][0]])[0] for p in people]
    squares = found.get("#", [])
    np.testing.assert_allclose(scene.start[0, scene.square[0]], np.reshape(squares, (-1, 2)), atol=1e-12)
    for ends, drawn in (
        (scene.start, [found["R"][0], *(found[p][0] for p in people)]),
        (scene.goal, [found["G"][0], *goals]),
    ):
        assert (~scene.square[0]).sum() == len(drawn)
        if ends is scene.start:
            beside = [square for square in squares if np.hypot(*(square - drawn[0])) < 0.7]
            drawn[0] = drawn[0] + sum((0.05 * (drawn[0] - square) / 0.6 for square in beside), np.zeros(2))
        np.testing.assert_allclose(ends[0, : len(drawn)], drawn, atol=1e-12)


@given(maps(), st.integers(0, 1000))
def test_episodes_differ_by_a_little_and_nobody_touches_anybody(lines, seed):
    environment = "map:" + "/".join(lines)
    scene, scenes = read_map("\n".join(lines)), sample_scenes(environment, 5, seed)
    assert set(scenes.environment) == {"map"}
    assert scenes.start.shape[1] == 1 + elements_of(environment) == scene.start.shape[1]
    moved, backwards = scenes.start - scene.start, scene.goal - scenes.goal
    assert (np.abs(moved) <= 0.1).all()
    np.testing.assert_allclose(moved, backwards, atol=1e-12)
    assert_same(sample_scenes(environment, [3], seed), scenes.take([3]))
    walkers = ~scene.square[0]
    pairs = walkers[:, None] & ~np.eye(len(walkers), dtype=bool)
    assert (np.linalg.norm(scenes.start[:, :, None] - scenes.start[:, None], axis=-1)[:, pairs] > 0.6 - 1e-9).all()
    for ends in (scenes.start, scenes.goal):
        offset = np.abs(ends[:, walkers][:, :, None] - ends[:, ~walkers][:, None])
        assert (np.linalg.norm(np.maximum(offset - 0.3, 0.0), axis=-1) > 0.3 - 1e-9).all()  # from the outlines
    assert (reset(scenes).gap > 0).all()  # to touch at the start would be a collision


def test_a_square_at_a_corner_of_the_robots_place_leaves_it_less_room():
    assert reset(sample_scenes("map:#.#/.R./#.#/.../.G.", 1000)).gap.min() > 0


def test_episodes_of_a_map_differ_and_layouts_keep_their_robot_in_its_place():
    scenes = sample_scenes("map:G...1..R", 100)  # the person's goal, opposite, is beside the robot's
    for row in range(2):
        assert np.ptp(scenes.start[:, row], axis=0).min() > 0.17
        assert np.abs(scenes.start[:, row] - scenes.start[:, row].mean(0)).max() < 0.11
    assert (np.ptp(sample_scenes("map-room", 9).start[:, 0], axis=0) == 0).all()
    np.testing.assert_array_equal(sample_scenes("map-u", 1).start[0, 0], (0, -4))


def test_the_replays_glyphs_blanks_comments_and_indentation_draw_the_same(tmp_path):
    other = ROOM.replace("#", "█").replace("R", "@").replace("G", "★").replace(".", " ")
    other = "\r\n".join(["; a room", "", *("   " + line for line in other.splitlines()), "  ; its end", ""])
    other = other.replace("█     █     █", "■··· .█.····■", 1)
    assert_same(read_map(other), read_map(ROOM))
    (tmp_path / "room.txt").write_bytes(b"\xef\xbb\xbf" + other.encode())
    environment = load_map(tmp_path / "room.txt")
    assert environment == "map:" + ROOM.strip().replace("\n", "/")
    assert draw_map(sample_scenes(environment, [7])) == ROOM  # the noise is less than half a place
    assert read_map("R\n\n#.G").start[0, 0].tolist() == [-0.6, 0.6]  # a blank line is a line of nothing


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "m.txt is empty; draw at least R"),
        (" \n; only words\n\n", "m.txt is empty"),
        ("R.G\n..x", "m.txt, line 2, column 3: 'x' means nothing on a map"),
        ("; hi\n\n  R.G\n  .\x00", r"m.txt, line 4, column 4: '\x00' means nothing"),
        ("R\t.G", r"line 1, column 2: '\t' means nothing"),
        ("R.G\nR", "m.txt, line 2, column 1: this is a second R; the first is in line 1, column 1"),
        ("@@@\n@R.G", "line 1, column 2: this is a second R; the first is in line 1, column 1; @ is the robot, as in"),
        ("R.G1\n..11", "line 2, column 3: this is a second 1; the first is in line 1, column 4"),
        ("R.1.", "m.txt has no G; draw one, the robot's goal"),
        ("G.1.", "m.txt has no R; draw one, the robot's start"),
        ("R..G\n...b", "m.txt, line 2, column 4: b is the goal of 2, who is missing; draw 2"),
        ("R.G1\n#...", "m.txt, line 1, column 4: the place opposite 1 is a square; draw a, its goal"),
        ("R1.G", "m.txt, line 1, column 2: 1 touches the robot"),
        (".#R#\n...G", "m.txt, line 1, column 3: R would touch the squares on both sides"),
        ("R.G" + 60 * ".", "m.txt is 63 places wide and 1 high; it may be at most 60 by 60"),
        ("R.G" + 60 * "\n.", "m.txt is 3 places wide and 61 high"),
        ("R.G" + 5 * ("\n" + 50 * "#"), "m.txt has 250 squares; it may have at most 200"),
    ],
)
def test_a_bad_map_is_named_with_line_and_column(text, message, tmp_path):
    (tmp_path / "m.txt").write_bytes(text.encode())
    with pytest.raises(ConfigError) as error:
        read_map(text, "m.txt")
    assert message in str(error.value)
    assert len(str(error.value).splitlines()) == 1
    with pytest.raises(ConfigError) as of_file:
        load_map(tmp_path / "m.txt")
    assert str(of_file.value) == str(error.value).replace("m.txt", str(tmp_path / "m.txt"))


def test_files_that_hold_no_map_are_refused(tmp_path):
    (tmp_path / "junk").write_bytes(bytes(range(256)))
    (tmp_path / "large").write_bytes(b";" * 200_000)
    for name, message in (("junk", "not text"), ("large", "larger"), ("nowhere", "no map"), (".", "is a folder")):
        with pytest.raises(ConfigError, match=message):
            load_map(tmp_path / name)
    with pytest.raises(ConfigError, match="map has no G"):
        sample_scenes("map:R..", 1)
    with pytest.raises(ConfigError, match="':' means nothing"):
        sample_scenes("map:R..G:0.5,1:0.5", 1)


def test_layouts_have_people_clear_of_squares_and_come_in_turn():
    scenes = sample_scenes("maps", 40, seed=1)
    assert scenes.environment[0] == "map-u"
    np.testing.assert_array_equal(scenes.environment[:20], scenes.environment[20:])
    assert len(set(scenes.environment)) == 20
    for e in range(40):
        square = scenes.square[e]
        walkers = ~square & ~np.isnan(scenes.start[e, :, 0])
        for places in (scenes.start[e, walkers], scenes.goal[e, walkers]):
            apart = np.linalg.norm(places[:, None] - scenes.start[e, square], axis=-1)
            assert apart.min() > 0.72
        np.testing.assert_allclose(scenes.goal[e, walkers][1:], -scenes.start[e, walkers][1:])
    again = sample_scenes("map-room", [12], seed=1)
    np.testing.assert_array_equal(again.start[0, : len(again.start[0])], scenes.start[12, : again.start.shape[1]])


def test_a_map_is_parsed_once_however_often_its_scenes_are_sampled(monkeypatch):
    texts = []
    monkeypatch.setattr("sfmrl.maps.parse", lambda text: texts.append(text) or parse(text))
    for seed in range(3):
        sample_scenes("map:R...G/#..1.", 2, seed)
    assert texts == ["R...G\n#..1."]


@pytest.mark.parametrize("environment", ["2", "4", "5", "map-u", "map-door-people", "map-medium-2"])
def test_sampled_scenes_are_drawn_to_the_nearest_place(environment):
    scene = sample_scenes(environment, [1])
    again = read_map(draw_map(scene))
    assert again.square.sum() == scene.square.sum()
    for square in scene.start[scene.square]:
        assert np.abs(again.start[again.square] - square).max(-1).min() <= 0.3 + 1e-9
    walkers = (~scene.square & ~np.isnan(scene.start[..., 0])).sum()
    for one, other in ((scene.start, again.start), (scene.goal, again.goal)):
        assert np.abs(one[:, :walkers] - other[:, :walkers]).max() <= 0.36


def test_scenes_that_no_map_can_show_are_refused():
    with pytest.raises(ConfigError, match="at most 9 people, and this scene has 10; choose another"):
        draw_map(sample_scenes("circle", 1))
    with pytest.raises(ConfigError, match=r"choose another \(its map, line 15, column 7: 2 touches the robot"):
        draw_map(sample_scenes("1", [10]))
    near = sample_scenes("map:R..G", 1)
    goal = near.goal.copy()
    goal[0, 0] = near.start[0, 0] + 0.01
    near = replace(near, goal=goal)
    with pytest.raises(ConfigError, match="R and G share one"):
        draw_map(near)
    goal[0, 0] = 1e6
    with pytest.raises(ConfigError, match="at most 60 places wide"):
        draw_map(replace(near, goal=goal))


def test_a_scene_is_unsolvable_where_a_passage_is_too_narrow_or_the_way_too_long():
    wall = "\n".join(["#######", "#..R..#", "#.....#", "{}", ".......", "...G..."])
    for line, free in (("#######", False), ("###.###", False), ("###..##", True)):
        scene = read_map(wall.format(line))
        assert bool(solvable(scene)) == free
        assert (why_unsolvable(scene, Simulation()) is None) == free
    assert "two characters wide" in why_unsolvable(read_map(wall.format("###.###")), Simulation())


@pytest.mark.parametrize(("places", "arrives"), [(38, True), (39, True), (40, False)])
def test_a_goal_is_too_far_exactly_if_a_robot_that_goes_straight_does_not_reach_it_in_time(places, arrives):
    scene = read_map("R" + places * "." + "G")
    assert (play(scene, "linear").outcome == "success").all() == arrives
    reason = why_unsolvable(scene, Simulation())
    assert reason is None if arrives else "24.6 m, and within --time-limit 25 (s) the robot can reach goals" in reason


def test_the_example_is_a_maze_that_only_a_way_around_solves():
    environment = load_map(ROOT / "tutorials" / "maze.txt")
    assert why_unsolvable(sample_scenes(environment, 1), Simulation()) is None
    led = with_recovery(load_policy("orca"), Planner(recover=True, stall_time=0.0))
    assert evaluate(led, environment=environment, episodes=4)["success"] == 1.0
    assert evaluate("orca", environment=environment, episodes=4)["success"] == 0.0


def test_a_training_on_a_map_has_the_map_in_its_folder(sfmrl: Callable, tmp_path: Path):
    path = tmp_path / "m.txt"
    path.write_text("R..G\n#...\n")
    done = sfmrl("rl", "--from-scratch", "--map", path, *TINY, "--run", "run")
    assert done.returncode == 0, done.stderr
    path.write_text("changed")
    settings = open_run(tmp_path / "run").config.reinforcement
    assert settings.environment == settings.test_environment == "map:R..G/#..."
    again = sfmrl("eval", "run", "--episodes", "2", "--threads", "1")
    assert again.returncode == 0, again.stderr
    assert "run, environment map, 2 episodes" in again.stdout
    assert "map:" not in again.stdout + again.stderr


def test_an_interrupted_training_on_a_map_goes_on_from_its_folder_alone(tmp_path: Path):
    path = tmp_path / "m.txt"
    path.write_text("R..G\n#...\n")
    schedule = {"episodes": 4, "parallel": 2, "batches": 1, "batch_size": 8, "memory": 500}
    schedule |= {"environment": load_map(path), "test_environment": load_map(path)}
    schedule |= {"validation_interval": 2, "validation_episodes": 2, "test_episodes": 2}
    config = make_config(simulation={"time_limit": 4.0}, reinforcement=schedule)
    stop = StopSignal()
    stop.requested = True
    run = start_run(config, None, True, tmp_path / "run")
    with pytest.raises(Interrupted):
        run_reinforcement(run, no_progress, stop, lambda text: None)
    path.unlink()
    bars = []

    @contextmanager
    def progress(title, total):
        bars.append([title, total, 0])
        yield lambda count: bars[-1].append(bars[-1].pop() + count)

    said = []
    result = run_reinforcement(open_run(run.folder, "rl"), progress, StopSignal(), said.append)
    assert bars == [["reinforcement", 4, 4], ["test", 2, 2], ["test", 2, 2]]  # one for the whole training
    assert [line.partition(":")[0] for line in said] == [f"validation at episode {e} of 4" for e in (0, 2, 4)]
    assert result["episodes"] == 2
    assert finished(run.folder)


def test_commands_use_maps_and_say_what_is_wrong_in_a_line(sfmrl: Callable, tmp_path: Path):
    (tmp_path / "room 1.txt").write_text(ROOM)
    (tmp_path / "closed.txt").write_text("#####\n#R..#\n#...#\n#####\n..G..\n")
    done = sfmrl("eval", "linear", "--map", "room 1.txt", "--episodes", "2")
    assert "linear, map room 1.txt, 2 episodes, seed 0" in done.stdout
    assert "sfmrl ascii-render linear --map 'room 1.txt' --seed 0 --episode 0" in done.stderr
    compared = sfmrl("compare", "linear", "orca", "--map", "room 1.txt", "--episodes", "1")
    assert "map room 1.txt, 1 episode, seed 0" in compared.stdout
    drawn = sfmrl("ascii-render", "--draw", "--map", "room 1.txt")
    assert (drawn.stdout, drawn.stderr) == (ROOM, "")
    shown = sfmrl("ascii-render", "linear", "--map", "room 1.txt", "--frames", "1")
    assert shown.stderr == ""
    assert "map · episode 0" in shown.stdout
    closed = sfmrl("ascii-render", "linear", "--map", "closed.txt", "--frames", "1")
    assert closed.returncode == 0
    assert closed.stderr.startswith("unsolvable: the squares leave no path to the goal")
    rl = sfmrl("rl", "--map", "closed.txt", "--from", "nothing")
    assert rl.stderr.splitlines()[0].startswith("closed.txt: unsolvable")
    assert "unsolvable" in sfmrl("eval", "linear", "--map", "closed.txt", "--episodes", "1").stderr
    (tmp_path / "far.txt").write_text("R" + "." * 50 + "G\n")
    far = sfmrl("eval", "linear", "--map", "far.txt", "--episodes", "2")
    assert "is 30.6 m, and within --time-limit 25 (s) the robot can reach goals up to 24.3 m away" in far.stderr
    for command in (["eval", "orca"], ["rl"]):
        both = sfmrl(*command, "--map", "closed.txt", "--environment", "2")
        assert both.returncode == 2
        assert both.stderr == "sfmrl: --map and --environment exclude each other; leave out one of them\n"


def test_a_map_that_windows_powershell_wrote_is_read(tmp_path):
    plain, wide = tmp_path / "plain.txt", tmp_path / "wide.txt"
    plain.write_text("R.#.G\n", encoding="utf-8")
    wide.write_bytes("R.#.G\r\n".encode("utf-16"))
    assert load_map(wide) == load_map(plain)
