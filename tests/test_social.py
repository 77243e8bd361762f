"""The social metrics, against CrowdNav's own episodes, loops over one episode, and closed forms."""

import csv
import json
import math
from itertools import pairwise

import numpy as np
import pytest
from conftest import DATA

from sfmrl.config import Simulation
from sfmrl.episodes import Record, play, play_episodes
from sfmrl.evaluation import evaluation_record
from sfmrl.policies import load_policy
from sfmrl.recovery import solvable
from sfmrl.rewards import OUTCOMES, Transition
from sfmrl.scenes import Scenes, sample_scenes
from sfmrl.study.social import SOCIAL_METRICS, _time_to_collision, social_metrics, social_rows, social_values


def crowdnav_record(name: str) -> Record:
    """CrowdNav's recorded episodes as a record; gaps by looking at 101 moments of every step."""
    with np.load(DATA / f"crowdnav_orca_{name}.npz") as data:
        cases = dict(data)
    position, velocity = cases["position"], cases["velocity"]
    offset = position[:, :-1, 1:] - position[:, :-1, :1]
    approach = velocity[:, :-1, 1:] - velocity[:, 1:, :1]
    moments = np.linspace(0.0, 0.25, 101)
    apart = np.linalg.norm(offset[..., None, :] + approach[..., None, :] * moments[:, None], axis=-1).min(-1)
    shape = cases["reward"].shape
    blank = np.full(shape, np.nan)
    outcome = np.zeros(shape, dtype=int)
    outcome[np.arange(shape[0]), cases["steps"] - 1] = [list(OUTCOMES).index(end) for end in cases["outcome"]]
    fields = dict.fromkeys(Transition.__dataclass_fields__, blank)
    fields |= {"time_step": 0.25, "outcome": outcome, "separations": apart - 0.6}
    scenes = Scenes(cases["start"], cases["goal"])
    return Record(scenes, Simulation(), cases["steps"], position, velocity, Transition(**fields), blank, blank[:, 0])


@pytest.mark.parametrize(
    ("name", "frequency", "separation"),
    [("5_visible", 0.2832, 0.0713), ("5_invisible", 0.0142, 0.1210), ("10_invisible", 0.0286, 0.1130)],
)
def test_danger_is_what_crowdnav_reports_of_its_own_episodes(name, frequency, separation):
    found = social_metrics(crowdnav_record(name))
    assert found["danger_frequency"] == pytest.approx(frequency, abs=5e-5)
    assert found["danger_separation"] == pytest.approx(separation, abs=1e-4)


@pytest.fixture(scope="module")
def crowded() -> Record:
    """Episodes with people and squares, of every outcome."""
    return play(sample_scenes("1:0.5,2:0.3,circle5:0.2", 40, seed=3), "linear")


def by_hand(record: Record, e: int) -> dict[str, float]:
    """The metrics of one episode in plain loops; gaps and times to collision by small steps."""
    scenes, steps, dt = record.scenes, int(record.steps[e]), 0.25
    people = [k for k in range(1, scenes.start.shape[1]) if not scenes.square[e, k] and scenes.start[e, k, 0] < np.inf]
    robot = record.position[e, : steps + 1, 0]
    gaps, ttc, work = [], [10.0], 0.0
    for t in range(steps):
        near, push, felt = math.inf, np.zeros(2), 0.0
        for k in people:
            reach = scenes.radius[e, 0] + scenes.radius[e, k]
            offset = record.position[e, t, k] - robot[t]
            in_step = record.velocity[e, t, k] - record.velocity[e, t + 1, 0]
            for moment in np.linspace(0.0, dt, 201):
                near = min(near, math.hypot(*(offset + moment * in_step)) - reach)
            going = record.velocity[e, t, k] - record.velocity[e, t, 0]
            moments = np.arange(0.0, 10.0, 0.002)
            touching = np.hypot(*(offset[:, None] + going[:, None] * moments)) <= reach
            ttc += list(moments[touching][:1])
            force = math.exp(-math.hypot(*offset))
            push -= force * offset / math.hypot(*offset)
            felt += force
        gaps.append(near)
        work += (math.hypot(*push) + felt) * dt
    action = record.velocity[e, 1 : steps + 1, 0]
    jerks = [math.hypot(*(action[t + 1] - 2 * action[t] + action[t - 1])) / dt**2 for t in range(1, steps - 1)]
    headings = [math.atan2(v[1], v[0]) for v in action if math.hypot(*v) > 1e-6]
    turns = [abs(math.remainder(b - a, 2 * math.pi)) for a, b in pairwise(headings)]
    danger = [gap for gap in gaps[:-1] if gap < 0.2]
    return {
        "danger_frequency": len(danger) / steps,
        "danger_separation": sum(danger) / len(danger) if danger else math.nan,
        "path_length": sum(math.dist(a, b) for a, b in pairwise(robot)),
        "min_gap": min(gaps) if people else math.nan,
        **{
            name: sum(gap < zone for gap in gaps) / steps
            for name, zone in (("intimate", 0.45), ("personal", 1.2), ("social", 3.6))
        },
        "min_ttc": min(ttc),
        "jerk": sum(jerks) / len(jerks) if jerks else math.nan,
        "heading_change": sum(turns),
        "social_work": work,
    }


def test_each_episode_is_what_loops_over_it_give(crowded):
    values = social_values(crowded)
    assert list(values) == list(SOCIAL_METRICS)
    assert len(set(crowded.outcome)) >= 2
    for e in range(0, len(crowded.steps), 5):
        for name, expected in by_hand(crowded, e).items():
            tolerance = {"min_ttc": 3e-3}.get(name, 1e-3)
            assert values[name][e] == pytest.approx(expected, abs=tolerance, nan_ok=True), (name, e)


def test_an_episode_has_the_same_values_alone_and_among_others(crowded):
    values = social_values(crowded)
    for e in range(len(crowded)):
        played_alone = play(crowded.scenes.take(slice(e, e + 1)), "linear")  # a record as long as this episode
        for name, value in social_values(played_alone).items():
            np.testing.assert_array_equal(value, values[name][e : e + 1], err_msg=name)


def alone(goal: tuple[float, float] = (0.0, 4.0), **more) -> Record:
    return play(Scenes(start=[[[0.0, -4.0]]], goal=[[goal]]), "linear", **more)


def test_nobody_there_leaves_nothing_to_measure_but_the_path():
    found = social_metrics(alone())
    assert found["spl"] == pytest.approx(1.0)
    assert found["path_length"] == pytest.approx(7.75)  # the goal counts as reached within 0.3 m
    assert (found["danger_frequency"], found["danger_separation"], found["min_gap"]) == (0.0, None, None)
    assert (found["min_ttc"], found["social_work"], found["intimate"]) == (None, 0.0, 0.0)
    assert found["jerk"] == pytest.approx(0.0, abs=1e-9)
    assert found["heading_change"] == pytest.approx(0.0, abs=1e-9)


def test_a_detour_costs_its_length_and_a_failure_everything():
    corner = iter([(1.0, 0.0)] * 16 + [(0.0, 1.0)] * 100)
    scenes = Scenes(start=[[[0.0, 0.0]]], goal=[[[4.0, 4.0]]])
    record = play(scenes, lambda world, crowd_velocity: np.array([next(corner)]))
    found = social_metrics(record)
    assert found["spl"] == pytest.approx(math.sqrt(2) / 2, rel=1e-3)
    assert found["heading_change"] == pytest.approx(math.pi / 2)
    stands = play(scenes, lambda world, crowd_velocity: np.zeros((1, 2)))
    assert social_metrics(stands)["spl"] == 0.0
    assert social_metrics(stands)["heading_change"] == 0.0


def test_the_shortest_path_leads_around_a_square():
    half, radius = 1.0, 0.3
    scenes = Scenes(
        start=[[[0.0, -4.0], [0.0, 0.0]]],
        goal=[[[0.0, 4.0], [0.0, 0.0]]],
        radius=[[radius, half]],
        square=[[False, True]],
    )
    way = iter([(1.0, 0.0)] * 6 + [(0.0, 1.0)] * 32 + [(-1.0, 0.0)] * 60)  # 11 m, all corners square
    record = play(scenes, lambda world, crowd_velocity: np.array([next(way)]))
    assert record.outcome[0] == "success"
    # Straight to a circle of the robot's radius around the square's corner, along it and the side, and likewise back.
    to_corner = math.dist((0, -4), (half, -half))
    heading = math.atan2(half, 4 - half) + math.asin(radius / to_corner)  # from the straight line
    shortest = 2 * (math.sqrt(to_corner**2 - radius**2) + radius * heading) + 2 * half
    assert social_metrics(record)["spl"] == pytest.approx(shortest / 11.0, rel=0.02)


def test_with_no_way_to_go_a_success_has_gone_no_detour():
    here = play(Scenes(start=[[[0.0, 0.0]]], goal=[[[0.0, 0.0]]]), "linear")
    assert social_metrics(here)["spl"] == 1.0


def test_the_shortest_path_leads_around_outlines_also_where_squares_are_discs():
    """Between the discs of four large squares the robot leaves along the diagonal; their corners are 0.42 m apart."""
    squares = [(4.3, 0.0), (0.0, 4.3), (-4.3, 0.0), (0.0, -4.3)]
    places = {"start": [[(0.0, 0.0), *squares]], "goal": [[(8.0, 8.0), *squares]]}
    scenes = Scenes(**places, radius=[[0.3, *[2.0] * 4]], square=[[False, *[True] * 4]])
    record = play_episodes(scenes, load_policy("linear"), "crowd", Simulation(squares="disc"))
    assert record.outcome[0] == "success"
    assert not solvable(scenes).any()
    assert social_metrics(record)["spl"] == 1.0


def test_a_goal_of_a_kilometre_away_has_a_path():
    goals = [[[1000.0, 0.0]], [[0.0, 1000.0]]]
    far = play(Scenes(start=[[[0.0, 0.0]]] * 2, goal=goals, v_pref=[[50.0], [1.0]]), "linear")
    assert far.outcome.tolist() == ["success", "timeout"]
    np.testing.assert_allclose(social_values(far)["spl"], [1.0, 0.0])


def test_a_record_without_episodes_has_nothing_to_measure():
    record = play(sample_scenes("1", 2), "linear")
    for empty in (record.take([]), play(sample_scenes("1", 0), "linear")):
        assert social_metrics(empty) == dict.fromkeys(SOCIAL_METRICS)
        assert social_rows(empty) == []


def test_head_on_the_time_to_collision_is_the_gap_over_the_speed():
    record = play(Scenes(start=[[[0.0, -4.0], [0.0, 4.0]]], goal=[[[0.0, 4.0], [0.0, -4.0]]]), "linear", crowd="sfm")
    gap = record.position[0, 1, 1, 1] - record.position[0, 1, 0, 1] - 0.6
    speed = record.velocity[0, 1, 0, 1] - record.velocity[0, 1, 1, 1]
    offset, approach = (array[0, 1, 1] - array[0, 1, 0] for array in (record.position, record.velocity))
    assert _time_to_collision(offset, approach, np.array(0.6)) == pytest.approx(gap / speed)


def test_squares_are_no_people():
    with_squares = sample_scenes("1", 20, seed=1)
    record = play(with_squares, "linear")
    near = record.transition.separation
    people = social_values(record)["min_gap"]
    assert (np.nan_to_num(people, nan=np.inf) >= np.nanmin(np.where(record.played, near, np.inf), axis=1) - 1e-12).all()
    assert (np.nan_to_num(people, nan=np.inf) > np.nanmin(np.where(record.played, near, np.inf), axis=1)).any()


def test_the_command_prints_each_metric_with_what_it_is_and_json_and_csv_have_all(sfmrl, tmp_path):
    words = ("eval", "orca", "--environment", "circle5", "--episodes", 4)
    shown = sfmrl(*words, "--social", "--csv", "e.csv")
    assert shown.returncode == 0, shown.stderr
    record = evaluation_record("orca", environment="circle5", episodes=4)
    found = social_metrics(record)
    for name, value in found.items():
        assert any(f"{name} " in line and f" {value:.3f} " in line for line in shown.stdout.splitlines())
    assert max(map(len, shown.stdout.splitlines())) <= 100
    assert json.loads(sfmrl(*words, "--json").stdout)["social"] == found
    rows = list(csv.DictReader((tmp_path / "e.csv").read_text().splitlines()))
    expected = [
        {name: "" if value is None else str(value) for name, value in row.items()} for row in social_rows(record)
    ]
    assert [{name: row[name] for name in SOCIAL_METRICS} for row in rows] == expected
