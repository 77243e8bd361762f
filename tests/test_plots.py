"""Figures by matplotlib: what is drawn is what was played and measured."""

import sys

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.patches import Circle, Rectangle

from sfmrl.config import ConfigError
from sfmrl.episodes import play
from sfmrl.scenes import sample_scenes
from sfmrl.study.plots import (
    ROBOT,
    FFMpegWriter,
    draw_episode,
    save,
    scenes_figure,
    trajectory_figure,
    validation_figure,
)


@pytest.fixture(scope="module")
def record():
    return play(sample_scenes("2", 3, seed=1), "orca")


def test_paths_and_discs_are_where_everybody_was(record):
    (axes,) = trajectory_figure(record, 1).axes
    scenes, steps = record.scenes.take([1]), record.steps[1]
    walkers = np.flatnonzero(~scenes.square[0] & ~np.isnan(scenes.start[0, :, 0]))
    for row, line in zip(walkers, axes.lines[1:], strict=True):
        np.testing.assert_array_equal(np.stack(line.get_data(), axis=1), record.position[1, : steps + 1, row])
    discs = [patch for patch in axes.patches if isinstance(patch, Circle)]
    robots = [disc for disc in discs if disc.get_facecolor()[:3] == to_rgb(ROBOT)]
    seconds = [*range(0, steps, 4), steps]
    np.testing.assert_array_equal([disc.center for disc in robots], record.position[1, seconds, 0])
    assert sum(isinstance(patch, Rectangle) for patch in axes.patches) == scenes.square[0].sum()
    assert record.outcome[1] in axes.get_title()


def test_scenes_stand_side_by_side_with_everybody_at_the_start():
    scenes = [sample_scenes(name, [2]) for name in "15"]
    figure = scenes_figure(scenes)
    for one, axes in zip(scenes, figure.axes, strict=True):
        walkers = ~one.square[0] & ~np.isnan(one.start[0, :, 0])
        discs = [patch.center for patch in axes.patches if isinstance(patch, Circle)]
        np.testing.assert_array_equal(discs, one.start[0, walkers])
        assert sum(isinstance(patch, Rectangle) for patch in axes.patches) == one.square[0].sum()
        assert axes.get_title() == f"environment {one.environment[0]}"


def test_a_curve_a_row_and_a_band_where_there_are_several_seeds():
    lines = [
        {"row": row, "episode": episode, "mean": 0.9, "low": low, "high": high}
        for row, low, high in (("sarl", 0.8, 1.0), ("mine", None, None))
        for episode in (0, 500)
    ]
    (axes,) = validation_figure(lines, "two").axes
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["sarl", "mine"]
    assert len(axes.collections) == 1


def test_the_same_drawing_has_the_same_bytes(record, tmp_path):
    for ending in ("svg", "pdf", "png"):
        paths = [tmp_path / f"{name}.{ending}" for name in "ab"]
        for path in paths:
            save(trajectory_figure(record), path)
        assert paths[0].read_bytes() == paths[1].read_bytes()


def test_films_are_made_for_browsers_and_viewers(record, tmp_path, monkeypatch):
    short = record.take([int(np.argmin(record.steps))])
    draw_episode(short, tmp_path / "film.gif")
    assert (tmp_path / "film.gif").read_bytes()[:6] == b"GIF89a"
    draw_episode(short, tmp_path / "film.html")
    assert "<script" in (tmp_path / "film.html").read_text()
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda cls: False))
    with pytest.raises(ConfigError, match="need the program ffmpeg"):
        draw_episode(short, tmp_path / "film.mp4")


def test_an_interrupted_film_is_an_interruption_also_before_its_first_frame(record, tmp_path, monkeypatch):
    def interrupt(animation):
        raise KeyboardInterrupt

    monkeypatch.setattr("matplotlib.animation.FuncAnimation._init_draw", interrupt)
    with pytest.raises(KeyboardInterrupt):
        draw_episode(record.take([0]), tmp_path / "film.gif")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("error")
def test_a_run_s_name_may_have_any_letters_and_bytes(tmp_path):
    lines = [{"row": name, "episode": 0, "mean": 0.5, "low": None, "high": None} for name in ("日本", "bad\udcff")]
    save(validation_figure(lines, "rows"), tmp_path / "figure.svg")
    assert (tmp_path / "figure.svg").stat().st_size > 0


def test_without_matplotlib_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.delitem(sys.modules, "sfmrl.study.plots")
    with pytest.raises(ConfigError, match="pip install matplotlib"):
        __import__("sfmrl.study.plots")


def test_the_command_draws_and_films_an_episode(sfmrl, tmp_path):
    for name in ("a.pdf", "a.gif"):
        done = sfmrl("plot", "orca", "--environment", "circle5", "--out", name)
        assert (done.returncode, done.stderr) == (0, f"wrote {name}\n")
    drawn = sfmrl("plot", "--scenes", "--out", "scenes.svg")
    assert (drawn.returncode, drawn.stderr) == (0, "wrote scenes.svg\n")
    assert all(f"environment {name}" in (tmp_path / "scenes.svg").read_text() for name in "12345")
    film = sfmrl("plot", "--scenes", "--out", "scenes.gif")
    assert (film.returncode, film.stderr.count("\n")) == (2, 1)
    needless = sfmrl("plot", "orac", "--scenes", "--out", "other.svg")
    assert (needless.returncode, needless.stderr.count("\n")) == (2, 1)
    assert "--scenes plays nothing; leave out the policy orac" in needless.stderr
    again = sfmrl("plot", "orca", "--out", "a.pdf")
    assert (again.returncode, again.stderr.count("\n")) == (2, 1)
    wrong = sfmrl("plot", "orca", "--out", "a.bmp")
    assert wrong.returncode == 2
    assert "must end in .svg, .png, .pdf, .gif, .mp4, .html" in wrong.stderr
