"""Replay frames: they fit, they show what is where, and they say what the record says."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from sfmrl.actions import ACTIONS
from sfmrl.config import Reward, Simulation
from sfmrl.episodes import Record, play, play_episodes
from sfmrl.lookahead import SarlPolicy
from sfmrl.policies import linear_policy, orca_policy
from sfmrl.replay.canvas import Canvas, Style, View, fit_view
from sfmrl.replay.frames import (
    SIDE_BY_SIDE_COLUMNS,
    STACKED_LINES,
    TWO_PANELS_COLUMNS,
    Replay,
    evenly_spaced,
    scene_picture,
)
from sfmrl.replay.panel import SHADES, action_disc
from sfmrl.replay.story import make_story
from sfmrl.rewards import COLLISION, RUNNING, SUCCESS, TIMEOUT, Transition
from sfmrl.scenes import Scenes, sample_scenes
from sfmrl.variants import make_config


class Eyes:
    """Stands for SARL: attention to the elements as given, and every action worth its speed along the x axis."""

    def __init__(self, *attention):
        self.shares = np.array(attention)

    def attention(self, world):
        return np.tile(self.shares, (len(world), 1))

    def notes(self, steps):
        actions = np.tile(ACTIONS, (1, steps, 1, 1))
        return {"actions": actions, "values": actions[..., 0], "best": actions[..., 0].argmax(2)}


def frames_of(record, policy=None, *, label="", reward=Reward(), width=80, height=24, ascii_only=False):
    """All frames of a record's first episode, as `policy` sees it."""
    if isinstance(policy, Eyes):
        record = replace(record, notes=policy.notes(record.steps[0]))
    story = make_story(record, policy, reward, 0.9)
    return Replay((story,), (label,), ascii_only).frames(width, height)


def record_of(position, *, outcome=SUCCESS, separations=None, square=False, goal=(0.0, 4.0)):
    """A record of one episode with these positions (T + 1, N, 2); nobody is near unless `separations` (T, K) say so."""
    steps, rows = len(position) - 1, position.shape[1]
    velocity = np.concatenate((0 * position[:1], np.diff(position, axis=0) / 0.25))
    goals = np.tile(goal, (rows, 1))
    distance = np.hypot(*(position[:, 0] - goals[0]).T)
    transition = Transition(
        time=0.25 * np.arange(1, steps + 1),
        time_step=np.full(steps, 0.25),
        velocity_before=velocity[:-1, 0],
        velocity=velocity[1:, 0],
        preferred_velocity=np.tile((0.0, 1.0), (steps, 1)),
        goal_distance_before=distance[:-1],
        goal_distance=distance[1:],
        separations=np.full((steps, rows - 1), np.inf) if separations is None else separations,
        outcome=np.array([RUNNING] * (steps - 1) + [outcome]),
    )
    return Record(
        Scenes(position[None, 0], goals[None], square=square, environment="2", episode=np.array([17])),
        Simulation(),
        steps=np.array([steps]),
        position=position[None],
        velocity=velocity[None],
        transition=transition[None],
        reward=np.zeros((1, steps)),
        discounted_return=np.zeros(1),
    )


def walk(steps=8, others=((2.0, 0.0), (-2.0, 1.0))):
    """Positions of a robot that walks up from (0, -4) by 1 m a step, and of others who stand."""
    robot = np.stack((np.zeros(steps + 1), -4.0 + np.arange(steps + 1)), -1)
    return np.concatenate((robot[:, None], np.tile(np.asarray(others).reshape(1, -1, 2), (steps + 1, 1, 1))), 1)


def assert_fits(picture, width, height):
    lines = picture.split("\n")
    assert len(lines) <= height
    assert max(map(len, lines)) <= width
    assert all(Text(line).cell_len == len(line) for line in lines), "a glyph is not one column wide"


def find(glyph, frame):
    """Row and column of a glyph that stands only once in the map."""
    places = [(r, line.index(glyph)) for r, line in enumerate(frame.plain.split("\n")[1:-3]) if glyph in line[:47]]
    assert len(places) == 1, frame.plain
    return np.array(places[0])


@pytest.fixture(scope="module")
def played():
    """An episode of environment 2 that an untrained SARL has played, and its policy."""
    from sfmrl.network import ValueNetwork

    config = make_config("quick", "sarl-sfm6")
    policy = SarlPolicy(ValueNetwork(forces=True, value_prior=True), config)
    return play_episodes(sample_scenes("2", [2]), policy, config.reward, Simulation(), keep=True), policy


def test_seven_bits_whatever_the_label():
    for frame in frames_of(record_of(walk()), label="Straße\n漢字 [bold]", ascii_only=True):
        assert frame.plain.isascii()
        assert "[bold]" in frame.plain
        assert_fits(frame.plain, 80, 24)


def test_view_puts_metres_into_cells():
    view = View(left=-2.0, top=2.0, row=0.4, rows=10, columns=20)
    points = np.array([[0.01, -0.01], [-1.99, 1.99], [1.99, -1.99], [0.21, 0.39]])
    np.testing.assert_array_equal(view.cells(points), [[5, 10], [0, 0], [9, 19], [4, 11]])
    canvas = Canvas(view)
    canvas.put(np.array([0.21, 0.39]), "@")
    canvas.put(np.array([9.0, 9.0]), "!")
    canvas.put(np.array([np.nan, 0.0]), "!")
    rows = [line.plain for line in canvas.lines()]
    assert rows[4] == " " * 11 + "@" + " " * 8
    assert "".join(rows).strip() == "@"


def test_a_column_is_half_a_row_so_that_circles_look_round():
    angle = np.arange(360) * np.pi / 180
    circle = 2 * np.stack((np.cos(angle), np.sin(angle)), -1)
    canvas = Canvas(fit_view(circle, rows=20, columns=60))
    canvas.dots(circle)
    drawn = np.array([[glyph != " " for glyph in line.plain] for line in canvas.lines()])
    assert np.ptp(np.flatnonzero(drawn.any(0))) == pytest.approx(2 * np.ptp(np.flatnonzero(drawn.any(1))), abs=2)


def test_robot_goal_and_people_stand_where_the_record_says():
    path = walk()
    path[:, 0, 0] = np.linspace(-3.0, 3.0, len(path))
    frames = frames_of(record_of(path, goal=(3.0, 4.0)), ascii_only=True)
    goal = find("*", frames[0])
    height = 8.0 / (find("@", frames[0]) - goal)[0]  # m a row: the robot starts 8 m below its goal
    assert 0.3 < height < 0.5
    for moment, frame in enumerate(frames[:-1]):
        for glyph, place in (("@", path[moment, 0]), ("1", path[moment, 1]), ("2", path[moment, 2])):
            expected = goal + np.array([4.0 - place[1], 2 * (place[0] - 3.0)]) / height
            assert np.abs(find(glyph, frame) - expected).max() <= 1.01


def test_headings_are_drawn_next_to_those_who_move():
    path = walk(others=((2.0, 0.0), (-2.0, 0.0), (2.0, 2.0)))
    path[:, 1, 0] += 0.2 * np.arange(9)  # person 1 to the right
    path[:, 2, 0] -= 0.2 * np.arange(9)  # person 2 to the left, person 3 stands
    frame = frames_of(record_of(path))[4]
    assert "1→" in frame.plain
    assert "←2" in frame.plain
    assert not re.search("3[→↗↑↖←↙↓↘]|[→↗↑↖←↙↓↘]3", frame.plain)
    assert tuple(find("@", frame) - find("↑", frame)) == (1, 0)


def test_touching_squares_join():
    row = [(x, 1.0) for x in (-0.6, 0.0, 0.6)]
    record = record_of(walk(others=row), square=np.array([False, True, True, True]))
    for width, height in ((80, 24), (120, 40)):
        lines = frames_of(record, width=width, height=height, ascii_only=True)[0].plain.split("\n")
        line = next(line for line in lines if "1" in line and "2" in line and "3" in line)
        wall = line[line.index("1") : line.index("3") + 1]
        assert set(wall) == set("123#")


def test_many_few_and_absent_elements():
    angle = np.arange(25) * 0.25
    many = frames_of(record_of(walk(others=3 * np.stack((np.cos(angle), np.sin(angle)), -1))))
    assert all(name in many[0].plain for name in "123456789abcdefghijklmnop")
    alone = frames_of(record_of(walk(others=())), policy=Eyes())
    assert "no people or squares" in alone[0].plain
    absent = frames_of(record_of(walk(others=((np.nan, np.nan), (1.0, 1.0)))), policy=Eyes(0.0, 1.0))
    assert "■1" not in absent[3].plain
    assert " 2 █" in absent[3].plain
    unseen = frames_of(record_of(walk(others=((2.0, 0.0),))), policy=Eyes(0.0))  # beyond the network's reach, say
    assert re.search(r" 1 +0%", unseen[3].plain)
    assert not any(span.style == Style.MOST_ATTENTION for span in unseen[3].text.spans)
    seen = frames_of(record_of(walk(others=((2.0, 0.0),))), policy=Eyes(1.0))
    assert any(span.style == Style.MOST_ATTENTION for span in seen[3].text.spans)


def test_attention_is_listed_from_most_to_least():
    others = ((2.0, 0.0), (-2.0, 1.0), (1.0, 3.0))
    square = np.array([False, False, False, True])
    frame = frames_of(record_of(walk(others=others), square=square), policy=Eyes(0.2, 0.5, 0.3))[4]
    lines = [line[47:] for line in frame.plain.split("\n")]
    rows = [line for line in lines if "%" in line]
    assert [row.split()[0] for row in rows] == ["2", "■3", "1"]
    assert [row.split()[-3] for row in rows] == ["50%", "30%", "20%"]
    bars = [row.count("█") for row in rows]
    assert bars == sorted(bars, reverse=True)
    assert bars[0] > 2 * bars[2]
    gaps = [np.hypot(2.0, 1.0) - 0.6, np.hypot(0.7, 2.7) - 0.3, 2.0 - 0.6]  # to the square, from its corner
    assert [float(row.split()[-2]) for row in rows] == pytest.approx(gaps, abs=0.006)


def test_without_a_network_there_is_no_attention_and_in_small_frames_no_panel():
    record = record_of(walk(others=((1.0, 0.0), (-2.0, 0.0))))
    plain = frames_of(record)[4].plain  # the robot is at (0, 0)
    assert "attention" not in plain
    assert "actions" not in plain
    assert "nearest" in plain
    assert f"⇐ {np.exp(-1.0) - np.exp(-2.0):.2f} m/s², mostly 1" in plain
    for width, height in ((59, 24), (80, 15), (60, 16)):
        shown = "repulsion" in frames_of(record, width=width, height=height)[2].plain
        assert shown == ((width, height) == (60, 16))


def test_repulsion_is_an_arrow_on_the_robot():
    others = ((1.0, 0.0), (-3.0, 0.0))  # the robot is at (0, 0) and walks up
    small, large = (frames_of(record_of(walk(others=others)), width=w, height=h)[4] for w, h in ((80, 24), (200, 50)))
    np.testing.assert_array_equal(find("@", small) - find("⇐", small), [0, 1])
    np.testing.assert_array_equal(find("@", small) - find("↑", small), [1, 0])
    lines = large.plain.split("\n")
    row = next(line for line in lines if "@" in line)
    metre = next(len(line.split("├")[1].split("┤")[0]) + 2 for line in lines if "1 m ├" in line)  # columns
    reach = (0.3 + 0.5 * (np.exp(-1.0) - np.exp(-3.0))) * metre
    assert row.index("@") - row.index("⇐") == pytest.approx(reach, abs=1.5)
    same = frames_of(record_of(walk(others=((0.0, -1.0), (-9.0, 0.0)))))[4]  # pushed the way that it goes
    assert (find("@", same) - find("↑", same) == [1, 0]).all()
    assert (find("@", same) - find("⇑", same) == [2, 0]).all()


def test_where_there_is_room_each_element_has_its_repulsion():
    record = record_of(walk(others=((1.0, 0.0), (-2.0, 0.0), (0.0, 3.0))))
    wide, tall = (
        frames_of(record, policy=Eyes(0.2, 0.5, 0.3), width=w, height=h)[4].plain.split("\n")
        for w, h in ((140, 30), (80, 40))
    )
    for name, glyph, distance in (("1", "⇐", 1.0), ("2", "⇒", 2.0), ("3", "⇓", 3.0)):
        row = next(line for line in wide if "%" in line and line.split("│")[2].split()[0] == name)
        assert f"{glyph} {np.exp(-distance):.2f}" in row
        row = next(line for line in tall if f"of person {name}" in line)
        assert row.endswith(f"{glyph} {np.exp(-distance):.2f} m/s²")


def test_the_panel_of_sarl_shows_attention_values_and_reward_and_where_there_is_room_all_elements_and_terms(played):
    record, policy = played
    small, large = (
        [frame.plain for frame in frames_of(record, policy, reward=policy.config.reward, width=w, height=h)]
        for w, h in ((80, 24), (120, 40))
    )
    assert {text.count("\n") + 1 for text in small} == {24}
    assert f"{record.reward[0, 4]:+.4f}".replace("-0.0000", "+0.0000") in small[5]
    for words in ("attention", "value of the 81 actions", "reward of the step", "velocity", "distance"):
        assert words in small[5]
    assert float(small[-1].split("return so far")[1].split()[0]) == pytest.approx(record.discounted_return[0], abs=1e-4)
    assert large[5].count("%") == np.isfinite(record.position[0, 0, 1:, 0]).sum() == 10 > small[5].count("%")
    for term in ("collision", "goal", "discomfort", "velocity", "distance"):
        assert f"  {term} " in large[5]
    assert "  goal " not in small[5]


def test_actions_are_a_disc_dense_where_values_are_high():
    taken = 1 + 4 * 5 + 4  # heading 90 degrees, the highest speed
    disc = [line.plain for line in action_disc(ACTIONS, ACTIONS[:, 0], taken, rows=7)]
    assert disc[0][1:].index("o") == 6  # at the rim, above the middle
    assert "".join(disc).count("o") == 1
    middle = disc[3][1:]
    assert len(middle) == 13
    assert [SHADES.index(glyph) for glyph in middle] == sorted(SHADES.index(glyph) for glyph in middle)
    assert middle[0] == SHADES[0]
    assert middle[-1] == SHADES[-1]


def test_values_of_the_actions_and_of_the_next_one():
    path = walk()
    path[4:, 0] = path[3, 0] + (0.25, 0.0)  # step 3 goes along x, the others do not; values are speeds along x
    frames = frames_of(record_of(path), policy=Eyes(0.5, 0.5))
    for words in ("value of the 81 actions", "best   1.000", "stay   0.000", "worst  -1.000"):
        assert words in frames[3].plain
    assert ["next   1.000" in frame.plain for frame in frames[1:6]] == [False, False, True, False, False]
    assert "next" not in frames[-1].plain


def test_what_is_faint_or_bold_stays_with_its_own_words():
    story = make_story(record_of(walk()), None, Reward(reward="sfm"), 0.9)
    console = Console()
    for names, width in (("a",), 80), (("a", "b"), 80), (("a", "b"), 200):
        text = Replay((story,) * len(names), names).frame(5, width, 24).text
        found = list(re.finditer(r"return .*?([-+]\d)", text.plain))
        assert len(found) == len(names)
        for match in found:
            assert text.get_style_at_offset(console, match.start()).dim
            assert text.get_style_at_offset(console, match.start(1)).bold
            assert not text.get_style_at_offset(console, match.start(1)).dim


def test_too_close_is_marked_and_told():
    separations = np.full((8, 2), np.inf)
    separations[2:5, 1] = 0.15, 0.12, 0.18
    record = record_of(walk(), separations=separations)
    frames = frames_of(record)
    assert "too close" not in frames[0].plain
    assert "no step too close so far" in frames[2].plain
    assert "too close 0.75 s (person 2, 0.15 m)" in frames[3].plain
    assert "too close 0.75 to 1.00 s (person 2, 0.12 m)" in frames[4].plain
    assert "too close 0.75 to 1.25 s (person 2, 0.12 m)" in frames[7].plain
    assert frames[8].plain.endswith("too close for 0.75 s")
    timelines = [frame.plain.split("\n")[-2] for frame in frames]
    assert len({len(line) for line in timelines}) == 1
    marks = [place for place, glyph in enumerate(timelines[0]) if glyph == "!"]  # 0.75 to 1.25 s, of 25
    assert marks == [7, 8]  # 5 columns of "0 s", then 2.7 columns a second
    picky = frames_of(record, reward=Reward(discomfort_distance=0.13))
    assert "too close 1.00 s (person 2, 0.12 m)" in picky[7].plain


def test_the_timeline_moves_on():
    lines = [frame.plain.split("\n")[-2] for frame in frames_of(record_of(walk(steps=60)))]
    now = [line.index("●") for line in lines[:-1]]
    assert now == sorted(now)
    assert now[0] < 6
    assert now[40] == pytest.approx(5 + 67 * 10 / 25, abs=3)
    assert all("★" in line and line.endswith("25 s") for line in lines)


@pytest.mark.parametrize(
    ("outcome", "gaps", "words"),
    [
        (SUCCESS, (1.0, 1.0), ["goal reached after 2.00 s", "never too close"]),
        (TIMEOUT, (1.0, 1.0), ["time is up at 2.00 s, 0.00 m from the goal"]),
        (COLLISION, (-0.1, 1.0), ["collision at 2.00 s: hit person 1;"]),
        (COLLISION, (1.0, -0.1), ["collision at 2.00 s: hit square 2;"]),
        (COLLISION, (-0.2, -0.1), ["hit person 1 and square 2"]),
    ],
)
def test_the_last_frame_says_how_it_ended(outcome, gaps, words):
    separations = np.full((8, 2), np.inf)
    separations[-1] = gaps
    record = record_of(walk(), outcome=outcome, separations=separations, square=np.array([False, False, True]))
    for ascii_only in (False, True):
        frames = frames_of(record, ascii_only=ascii_only)
        for word in words:
            assert word in frames[-1].plain
            assert word not in frames[-2].plain
        mark = {SUCCESS: "*" if ascii_only else "★", COLLISION: "X", TIMEOUT: "T"}[outcome]
        assert mark in frames[-1].plain.split("\n")[-2]


def test_stills_are_evenly_spaced_with_both_ends():
    assert evenly_spaced(12, 4) == [0, 4, 8, 12]
    assert evenly_spaced(12, 1) == [12]
    assert evenly_spaced(12, 99) == list(range(13))
    for count in range(2, 14):
        moments = evenly_spaced(12, count)
        assert len(set(moments)) == count
        assert moments == sorted(moments)
        assert (moments[0], moments[-1]) == (0, 12)


coordinates = st.one_of(st.floats(-6, 6), st.floats(-500, 500), st.just(np.nan))


@given(st.data())
def test_any_positions_fit_and_show_the_robot(data):
    steps, others = data.draw(st.integers(1, 3)), data.draw(st.integers(0, 12))
    width, height = data.draw(st.integers(1, 200)), data.draw(st.integers(1, 50))
    flat = data.draw(st.lists(coordinates, min_size=2 * (others + 1), max_size=2 * (others + 1)))
    path = np.tile(np.array(flat).reshape(1, -1, 2), (steps + 1, 1, 1))
    path[:, np.isnan(path[0]).any(-1)] = np.nan
    path[:, 0] = np.nan_to_num(path[:, 0])
    path[:, 0, 0] += data.draw(st.floats(-3, 3)) * np.arange(steps + 1)
    squares = np.arange(others + 1) > data.draw(st.integers(0, others))
    outcome = data.draw(st.sampled_from([SUCCESS, COLLISION, TIMEOUT]))
    ascii_only, eyes = data.draw(st.booleans()), data.draw(st.booleans())
    frames = frames_of(
        record_of(path, outcome=outcome, square=squares),
        policy=Eyes(*np.full(others, 1 / max(others, 1))) if eyes else None,
        label="eyes",
        width=width,
        height=height,
        ascii_only=ascii_only,
    )
    assert len(frames) == steps + 1
    for frame in frames:
        assert_fits(frame.plain, width, height)
        assert "@" in frame.plain
        assert frame.plain.isascii() == ascii_only or width < 20 or height < 8
        assert frame.plain.count("\n") + 1 == height or height < 8


@pytest.mark.parametrize("label", ["sarl-sfm6", "orca", ""])
def test_titles_and_sentences_are_never_cut_within_a_word(label):
    separations = np.full((8, 2), np.inf)
    separations[2:5, 1] = 0.15, 0.12, 0.18
    separations[7] = -0.2, -0.1
    record = record_of(walk(), outcome=COLLISION, separations=separations)
    whole = [label, "environment 2", "episode 17"] if label else ["environment 2", "episode 17"]
    for width in range(28, 101):
        for t, frame in enumerate(frames_of(record, label=label, width=width, height=20)):
            first, *_, last = frame.plain.split("\n")
            title = first[1 : first.index("╮")].strip("─ ").split(" · ")
            parts = [f"{0.25 * t:.2f} s", *whole] if "s" in title[0].split() else whole
            assert title == parts[: len(title)]
            assert last.split()[-1] in {"start", "far", "s", "m)", "2", "collision"}, last


@pytest.mark.parametrize("environment", ["1", "2", "3", "4", "5", "circle"])
def test_scene_pictures(environment):
    scenes = sample_scenes(environment, 2)
    for width, height in ((80, 24), (120, 40), (60, 16), (40, 20), (20, 8)):
        plain = scene_picture(scenes, 1, width=width, height=height, ascii_only=True).plain
        assert_fits(plain, width, height)
        assert plain.isascii()
        legend = plain.split("\n")[-1]
        assert re.search("(square|person|goal)$", legend)
        assert legend.endswith("square") or width == 20
    plain = scene_picture(scenes, 1).plain
    assert "@" in plain
    assert "★" in plain
    drawn = "".join(plain.split("\n")[1:-2])
    for row in np.flatnonzero(np.isfinite(scenes.start[1, :, 0]))[1:]:
        assert "123456789abcdef"[row - 1] in drawn
    assert ("█" in drawn) == scenes.square[1].any()
    assert ("x" in drawn) == (environment != "5")


def test_a_stretch_that_recovery_led_is_marked_and_told():
    from sfmrl.config import Planner
    from sfmrl.recovery import RecoveringPolicy

    policy = RecoveringPolicy(orca_policy, Planner(recover=True))
    record = play_episodes(sample_scenes("map-u", [0]), policy, Reward(), Simulation(), keep=True)
    frames = frames_of(record, policy=policy)
    told = [frame for frame in frames if "stuck: led around the squares" in frame.plain]
    line = frames[-1].plain.split("\n")[-2]
    assert "~" in line
    assert "~" not in frames_of(replace(record, notes={}))[-1].plain.split("\n")[-2]
    assert f"stuck for {len(told) * 0.25:.2f} s" in frames[-1].plain
    for frame in frames:
        assert_fits(frame.plain, 80, 24)


@pytest.fixture(scope="module")
def stories():
    """The same episode as ORCA and a robot that goes straight play it: one of them ends before the other."""
    scenes, policies = sample_scenes("2", [0]), {"orca": orca_policy, "linear": linear_policy}
    return {name: make_story(play(scenes, policy), policy, Reward(), 0.9) for name, policy in policies.items()}


def replay(stories, *names, ascii_only=False):
    return Replay(tuple(stories[name] for name in names), names, ascii_only)


@pytest.mark.parametrize("size", [(80, 24), (61, 8), (120, 40), (200, 50), (60, 17), (20, 16), (161, 30), (7, 3)])
@pytest.mark.parametrize("ascii_only", [False, True])
def test_two_policies_fit_whatever_the_size(stories, size, ascii_only):
    width, height = size
    both = replay(stories, "orca", "linear", ascii_only=ascii_only)
    assert both.last == max(story.last for story in stories.values())
    for frame in both.frames(*size, 5):
        lines = frame.text.plain.split("\n")
        assert len(lines) <= height
        assert max(map(cell_len, lines)) <= width
        assert frame.plain.count("@") == 2
        assert frame.plain.isascii() == ascii_only or min(size) < 8
        if width >= SIDE_BY_SIDE_COLUMNS or height >= STACKED_LINES:
            assert "orca" in frame.plain
            assert "linea" in frame.plain
        if width >= SIDE_BY_SIDE_COLUMNS:
            assert {cell_len(line) for line in lines} == {2 * ((width - 1) // 2) + 1}
        if width >= TWO_PANELS_COLUMNS:
            assert frame.plain.count("reward of the step") == 2


def test_two_policies_are_in_step_and_who_has_ended_stays_as_it_ended(stories):
    first, second = sorted(stories, key=lambda name: stories[name].last)
    early, late = stories[first], stories[second]
    assert early.last < late.last
    both = replay(stories, first, second)
    for t, frame in enumerate(both.frames()):
        lines = frame.plain.split("\n")
        facts = next(line for line in lines if line.startswith("t "))
        assert re.findall(r"t +([\d.]+) s", facts) == [
            f"{early.time[min(t, early.last)]:.2f}",
            f"{late.time[t]:.2f}",
        ]
        assert frame.time == late.time[t]
        left = [line[:39] for line in lines]
        if t >= early.last:
            assert left == [line[:39] for line in both.frame(early.last).plain.split("\n")]
            assert {"success": "goal reached after", "collision": "collision at"}[early.outcome] in left[-1]
    swapped = replay(stories, second, first).frame(early.last)  # each side looks the same on the other one
    assert [line[40:].rstrip() for line in swapped.plain.split("\n")] == [line.rstrip() for line in left]


def test_both_planes_have_one_scale(stories):
    for width, height in ((80, 24), (120, 40), (200, 50)):
        frame = replay(stories, "orca", "linear").frame(0, width, height)
        lines = frame.text.plain.split("\n")
        half = (width - 1) // 2
        alike = [r for r, line in enumerate(lines) if line.startswith("│")][: height // 3]
        inside = lines[0].index("╮")
        assert [lines[r][: inside + 1] for r in alike] == [lines[r][half + 1 : half + inside + 2] for r in alike]
        assert len({line.split("├")[1].count("─") for line in re.findall("1 m ├─+┤", frame.plain)}) == 1


def test_a_still_is_the_one_at_its_time(stories):
    shown = replay(stories, "orca", "linear")
    for at, time in ((0.0, 0.0), (1.1, 1.0), (1.2, 1.25), (np.inf, stories["orca"].time[-1])):
        (frame,) = shown.frames(at=at)
        assert frame.time == time
        assert frame.plain == shown.frame(round(time / 0.25)).plain
