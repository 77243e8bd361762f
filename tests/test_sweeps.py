"""Sweeps: what is varied is varied, all else stays, and bad ones are refused before anything is played."""

from functools import partial

import numpy as np
import pytest

from sfmrl.config import ConfigError, Simulation
from sfmrl.evaluation import evaluate, sweep_rows
from sfmrl.policies import orca_policy
from sfmrl.scenarios import sample_scenes
from sfmrl.sweeps import Sweep, parse_sweep, swept

SAMPLE = partial(sample_scenes, "table2", 30, 4)


def at(text: str, value: float | str):
    return swept(parse_sweep(text), value, Simulation(), SAMPLE)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("humans=0:20:5", (0, 5, 10, 15, 20)),
        ("v_pref=0.5:1.5:0.25", (0.5, 0.75, 1.0, 1.25, 1.5)),
        ("v-pref=0.8,1", (0.8, 1.0)),
        ("radius_noise=0:0.1:0.05", (0.0, 0.05, 0.1)),
        ("crowd=orca,sfm", ("orca", "sfm")),
        ("robot_visible=true, false", ("true", "false")),
    ],
)
def test_a_sweep_in_words(text, values):
    assert parse_sweep(text).values == values


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("humens=0:20:5", "did you mean humans"),
        ("humans", "humans=0:20:5"),
        ("humans=0:20", "first:last:step"),
        ("humans=0:20:0", "step"),
        ("humans=2:nan:1", "first:last:step"),
        ("humans=nan", "first:last:step"),
        ("v_pref=1,inf", "first:last:step"),
        ("humans=20:0:5", "step"),
        ("humans=0.5", "whole"),
        ("humans=-1", "whole"),
        ("v_pref=-1", "below 0"),
        ("v_pref=fast", "first:last:step"),
        ("radius_noise=0.3", "radius_noise"),
        ("crowd=rvo", "orca, sfm"),
        ("robot_visible=yes", "true, false"),
    ],
)
def test_a_bad_sweep_says_what_it_takes(text, words):
    with pytest.raises(ConfigError, match=words):
        parse_sweep(text)


@pytest.mark.parametrize("count", [0, 3, 20])
def test_humans_are_as_many_as_asked_for_among_the_same_squares(count):
    plain, (scenes, _) = SAMPLE(), at("humans=0:20:1", count)
    there = ~np.isnan(scenes.start[..., 0])
    assert ((there & ~scenes.square).sum(1) == 1 + count).all()
    for e in range(30):
        np.testing.assert_array_equal(scenes.start[e][scenes.square[e]], plain.start[e][plain.square[e]])


def test_only_the_people_s_speed_and_size_change():
    plain, (fast, _), (odd, _) = SAMPLE(), at("v_pref=1.5", 1.5), at("radius_noise=0.1", 0.1)
    people = ~plain.square
    people[:, 0] = False
    np.testing.assert_array_equal(fast.v_pref, np.where(people, 1.5, plain.v_pref))
    np.testing.assert_array_equal(odd.radius[~people], plain.radius[~people])
    noise = (odd.radius - plain.radius)[people & ~np.isnan(plain.start[..., 0])]
    assert 0.08 < np.abs(noise).max() <= 0.1
    assert abs(noise.mean()) < 0.02
    np.testing.assert_array_equal(odd.start, plain.start)


def test_the_crowd_and_who_sees_the_robot():
    assert at("crowd=sfm", "sfm")[1] == Simulation(crowd="sfm")
    assert at("robot_visible=false", "false")[1] == Simulation(robot_visible=False)


def test_a_sweep_s_row_is_the_evaluation_at_its_value():
    sweeps = [Sweep("crowd", ("orca", "sfm")), parse_sweep("v_pref=1")]
    how = {"environment": "2", "episodes": 12, "seed": 1}
    rows = sweep_rows(orca_policy, sweeps, **how)
    assert [(row["setting"], row["value"]) for row in rows] == [("crowd", "orca"), ("crowd", "sfm"), ("v_pref", 1.0)]
    plain = evaluate(orca_policy, **how)
    for name in ("success", "collision", "timeout", "navigation_time", "total_reward"):
        assert rows[0][name] == rows[2][name] == plain[name]
    assert rows[1] != rows[0]
