"""Episodes and scenes as SVG: well-formed, true to the record, and what notebooks show."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from sfmrl.episodes import play
from sfmrl.evaluation import metrics
from sfmrl.replay.picture import SCALE, episode_svg, metrics_html, record_html, scene_svg, scenes_html
from sfmrl.scenes import sample_scenes

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def record():
    return play(sample_scenes("1:0.5,2:0.5", 6, seed=1), "orca")


def test_a_film_moves_everybody_as_the_record_says(record):
    for episode in (0, 4):
        root = ElementTree.fromstring(episode_svg(record, episode))
        scenes, steps = record.scenes.take([episode]), record.steps[episode]
        walkers = np.flatnonzero(~scenes.square[0] & ~np.isnan(scenes.start[0, :, 0]))
        films = root.findall(f"{SVG}g/{SVG}animateTransform")
        assert len(films) == len(walkers)
        for row, film in zip(walkers, films, strict=True):
            places = np.array([place.split(",") for place in film.get("values").split(";")], dtype=float)
            moved = np.diff(record.position[episode, : steps + 1, row], axis=0) * (SCALE, -SCALE)
            np.testing.assert_allclose(np.diff(places[:-1], axis=0), moved, atol=0.11)
            times = np.array(film.get("keyTimes").split(";"), dtype=float)
            assert len(times) == len(places)
            assert (times[0], times[-1]) == (0, 1)
            assert float(film.get("dur")[:-1]) == pytest.approx(record.time[episode] + 1.0)
        assert len(root.findall(f"{SVG}rect")) == 1 + scenes.square[0].sum()
        assert f"{record.outcome[episode]} after {record.time[episode]:.2f} s" in root.find(f"{SVG}title").text


def test_a_scene_stands_still_and_lies_inside_its_picture(record):
    root = ElementTree.fromstring(scene_svg(record.scenes, 0))
    width, height = map(float, root.get("viewBox").split()[2:])
    assert not root.findall(f".//{SVG}animateTransform")
    for group in root.findall(f"{SVG}g"):
        x, y = map(float, re.findall(r"[-\d.]+", group.get("transform")))
        assert 0 < x < width
        assert 0 < y < height


def test_notebooks_show_a_table_and_a_picture(record):
    shown = record_html(record)
    assert shown.count("<table>") == shown.count("<svg") == 1
    assert all(name in shown for name in ("navigation time", "env. 1", "env. 2"))
    assert "<td>6</td>" in metrics_html(metrics(record))
    assert "<td>environment</td>" in scenes_html(record.scenes)


def test_without_episodes_a_notebook_shows_the_table_alone(record):
    none = record.take([])
    for shown in (none._repr_html_(), none.scenes._repr_html_()):
        assert "<table>" in shown
        assert "<svg" not in shown


def test_a_record_is_written_in_a_line_and_shown_in_a_notebook(record):
    ends = ", ".join(f"{(record.outcome == end).sum()} {end}" for end in ("success", "collision", "timeout"))
    assert repr(record) == f"Record(6 episodes: {ends})"
    assert record._repr_html_() == record_html(record)
    assert repr(record.scenes) == "Scenes(6 episodes of environment 1, 2)"
    assert record.scenes._repr_html_() == scenes_html(record.scenes)
    assert metrics(record)._repr_html_() == metrics_html(metrics(record))
