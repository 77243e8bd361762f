"""The paper's tables from run folders: made-up runs with known figures in, findings with known values out."""

import csv
import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import make_ablation
import make_tables
import numpy as np
import pytest
import scipy.stats
from conftest import assert_one_line_error

from sfmrl.cli import main
from sfmrl.config import ConfigError, override
from sfmrl.evaluation import wilson
from sfmrl.geometry import length
from sfmrl.runs.create import create_run
from sfmrl.runs.files import csv_text, unlist, write_atomically
from sfmrl.scenes import sample_scenes
from sfmrl.study.sheets import rate, sheets
from sfmrl.study.statistics import contrasts, mean_interval, summarise
from sfmrl.study.tables import (
    TABLES,
    Trained,
    figures,
    make_jobs,
    parse_rows,
    parse_seeds,
    read_row,
    run_config,
    run_folder,
)
from sfmrl.study.validations import table_validations

EPISODES = np.array([0, 250, 500, 1000])


def trained(success: list[float], episodes: int = 500, seeds: list[int] | None = None, **more: np.ndarray) -> Trained:
    """Runs of which these shares of the episodes succeed, the last ones failing, half of those by time-out."""
    hits = np.round(np.array(success) * episodes).astype(int)[:, None]
    number = np.arange(episodes)
    late = (number >= hits) & (number % 2 == 0)
    outcome = np.where(number < hits, "success", np.where(late, "timeout", "collision"))
    count = len(success)
    course = {
        "validation": np.tile([0.5, 0.8, 0.95, 0.9], (count, 1)),
        "training": np.tile(np.arange(1000) >= 300, (count, 1)),
    }
    return Trained(
        seeds=list(range(count)) if seeds is None else seeds,
        outcome=outcome,
        hit=np.where(outcome == "collision", np.where(number % 4 == 1, "human", "square"), ""),
        time=np.where(outcome == "timeout", 24.0, 10.0 + number % 2),
        total_reward=np.where(outcome == "success", 0.3, -0.1),
        episodes=EPISODES,
        steps=np.full((count, 1000), 40),
        **(course | more),
    )


def write_run(place: Path, row: str, seed: int, success: float, shifted: str = "") -> None:
    """A finished run's files, as far as a table reads them; in the file `shifted`, of other episodes than usual."""
    run, folder = trained([success], 50), run_folder(place, 1, "quick", row, seed)
    create_run("rl", run_config(1, "quick", row, seed), folder)
    (folder / "weights.npz").touch()
    columns = {name: getattr(run, name)[0].tolist() for name in ("outcome", "hit", "time", "total_reward")}
    rows = [dict(zip(columns, line, strict=True)) for line in zip(*columns.values(), strict=True)]
    course = [{"success": success} for success in run.validation[0].tolist()]
    played = [{"outcome": "success" if good else "timeout", "steps": 40 + seed} for good in run.training[0]]
    for name, episodes, lines in (
        ("test.csv", range(50), rows),
        ("validation.csv", EPISODES.tolist(), course),
        ("metrics.csv", range(len(played)), played),
    ):
        listed = [{"episode": e + (name == shifted)} | line for e, line in zip(episodes, lines, strict=True)]
        (folder / name).write_text(csv_text(listed))


@pytest.fixture
def folder(tmp_path) -> Path:
    """Table 1 with four rows of four seeds, one run missing."""
    for row, success in (("sarl", 0.96), ("sarl-sfm2", 0.9), ("sarl-sfm5", 1.0), ("sarl-sfm6", 0.94)):
        for seed in range(4):
            if (row, seed) != ("sarl-sfm6", 3):
                write_run(tmp_path, row, seed, success - 0.02 * (seed % 2))
    return tmp_path


def test_jobs_are_one_command_each_and_rows_share_their_imitation():
    jobs = make_jobs(2, "paper", [3, 7], ["sarl", "sarl-sfm6"], Path("here"))
    names = [f"paper-{name}-seed{seed}" for seed in (3, 7) for name in ("il", "table2-sarl", "table2-sarl-sfm6")]
    assert [job.folder.name for job in jobs] == names
    assert [job.needs for job in jobs[:3]] == [None, jobs[0].folder, jobs[0].folder]
    (shorter,) = make_jobs(1, "paper", [0], ["sarl"], Path("here"), episodes=3000, interval=500)[1:]
    assert (jobs[2].episodes, shorter.episodes) == (15000, 3000)
    table2 = {"--variant": "sarl-sfm6", "--seed": "3", "--episodes": "15000", "--test-episodes": "1000"}
    for job, options in ((jobs[2], table2), (shorter, {"--episodes": "3000", "--validation-interval": "500"})):
        words = shlex.split(job.command)
        assert words[:2] == ["sfmrl", "rl"]
        assert {flag: words[words.index(flag) + 1] for flag in options} == options


@pytest.mark.parametrize(("number", "schedule"), [(1, {}), (2, {}), (1, {"episodes": 30, "interval": 20})])
@pytest.mark.parametrize("preset", ["quick", "paper"])
def test_each_command_makes_a_run_with_the_config_that_the_table_looks_for(
    number, schedule, preset, tmp_path, monkeypatch
):
    made = []
    monkeypatch.setattr("sfmrl.runs.create.start_run", lambda config, *_, **__: made.append(config) or sys.exit())
    rows = list(TABLES[number].paper)
    for job in make_jobs(number, preset, [3], rows, tmp_path, *schedule.values())[1:]:
        monkeypatch.setattr(sys, "argv", ["sfmrl", *job.words])
        with pytest.raises(SystemExit):
            main()
    assert made == [run_config(number, preset, row, 3, **schedule) for row in rows]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"reinforcement": {"episodes": 20}}, '"episodes": 20, not "episodes": 1000'),
        ({"reinforcement": {"validation_interval": 20}}, '"validation_interval": 20, not "validation_interval": 250'),
        ({"reinforcement": {"test_episodes": 50}}, '"test_episodes": 50, not "test_episodes": 500'),
        ({"reinforcement": {"environment": "2"}}, '"environment": "2", not "environment": "table1"'),
        ({"imitation": {"epochs": 2}}, '"epochs": 2, not "epochs": 6'),
        ({"reward": {"reward": "sfm"}}, '"reward": "sfm", not "reward": "crowd"'),
        ({"forces": True}, '"forces": true, not "forces": false'),
        ({"mirror": False}, '"mirror": false, not "mirror": true'),
        ({"seed": 8}, '"seed": 8, not "seed": 0'),
    ],
)
def test_a_finished_run_with_other_settings_is_not_counted_and_nothing_is_trained(
    changes, said, folder, sfmrl, monkeypatch
):
    run = run_folder(folder, 1, "quick", "sarl", 0)
    config = override(run_config(1, "quick", "sarl", 0), changes)
    write_atomically(run / "config.json", config.to_json().encode())
    with pytest.raises(ConfigError, match=f"{run} was begun with {said}; give the --episodes and .* or name another"):
        read_row(folder, 1, "quick", "sarl", [0, 1])
    if "epochs" in said:
        done = sfmrl("table", "1", "--folder", folder, "--rows", "sarl", "--seeds", "0-9")
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
        assert said in done.stderr
        assert not (folder / "logs").exists()


def test_a_table_of_shorter_trainings_is_read_with_its_own_options(folder, sfmrl):
    for seed in range(4):
        config = run_config(1, "quick", "sarl", seed, 30, 20)
        write_atomically(run_folder(folder, 1, "quick", "sarl", seed) / "config.json", config.to_json().encode())
    which = ("1", "--folder", folder, "--rows", "sarl", "--seeds", "0-3", "--episodes", 30)
    table = ("table", *which, "--no-train")
    assert sfmrl(*table).returncode == 2
    done = sfmrl(*table, "--validation-interval", 20)
    assert "Table 1, quick preset, 50 test episodes" in done.stdout, done.stderr  # as many as there are in test.csv
    assert sfmrl("figure", *which, "--validation-interval", 20, "--csv", "f.csv").returncode == 0


@pytest.mark.parametrize(
    ("text", "seeds"), [("0-9", list(range(10))), ("3", [3]), ("0, 3,5-7", [0, 3, 5, 6, 7]), ("1,1,0-1", [1, 0])]
)
def test_seeds_are_read(text, seeds):
    assert parse_seeds(text) == seeds


@pytest.mark.parametrize("text", ["", "a", "1-", "3-1", "-1", "1;2", "0-9,"])
def test_what_is_no_seed_is_named(text):
    with pytest.raises(ConfigError, match="write 0-9 or 0,3,5-7"):
        parse_seeds(text)


def test_a_row_that_is_not_in_the_table_is_named():
    assert parse_rows(1, "sarl, sarl-sfm6, sarl") == ["sarl", "sarl-sfm6"]  # each once
    with pytest.raises(ConfigError, match=r"table 2 has no row 'sarl-sfm5'.*did you mean sarl-sfm6"):
        parse_rows(2, "sarl-sfm5")


def test_rates_add_up_and_times_are_the_papers_and_ours():
    by_seed = figures(trained([0.96, 1.0])).values
    parts = ("success", "human_collision", "square_collision", "timeout")
    np.testing.assert_allclose(sum(by_seed[name] for name in parts), 1)
    np.testing.assert_allclose(by_seed["success"], [0.96, 1])
    np.testing.assert_allclose(by_seed["timeout"], [0.02, 0])
    np.testing.assert_allclose(by_seed["navigation_time"], [10.5, 10.5])
    np.testing.assert_allclose(by_seed["navigation_time_charged"], [(480 * 10.5 + 10 * 25) / 490, 10.5])


def test_without_any_success_there_is_no_navigation_time():
    (row,) = summarise(TABLES[1], {"sarl": figures(trained([0.0, 0.5]))})
    assert row["figures"]["navigation_time"]["values"] == [None, 10.5]
    json.dumps(row, allow_nan=False)


def test_the_course_of_a_training_in_figures():
    validation = np.array([[0.5, 0.8, 0.95, 0.9], [0.9, 0.7, 1, 1], [0.1, 0.2, 0.3, 0.8]])
    runs = trained([0.9, 0.9, 0.9], validation=validation, training=np.tile(np.arange(1000) >= 100, (3, 1)))
    by_seed = figures(runs).values
    np.testing.assert_array_equal(by_seed["reached_episodes"], [500, 0, np.nan])
    np.testing.assert_array_equal(by_seed["reached_steps"], [500 * 40, 0, np.nan])
    np.testing.assert_allclose(by_seed["early_success"], [0.8, 0.7, 0.2])  # at 250 of 1000 episodes
    np.testing.assert_allclose(by_seed["drops"], [0.05 / 3, 0.2 / 3, 0])
    np.testing.assert_allclose(by_seed["start_success"], [0.5, 0.9, 0.1])
    np.testing.assert_allclose(by_seed["course_success"], [0.7875, 0.9, 0.35])
    np.testing.assert_allclose(by_seed["early_training_success"], 150 / 250)
    short = trained([0.9], episodes=3, training=np.array([[True, False, True]]))
    assert figures(short).values["early_training_success"] == 1.0  # at least one episode


def test_folders_alone_make_a_row(folder):
    row = read_row(folder, 1, "quick", "sarl-sfm6", [0, 1, 2, 3, 4])
    assert row.seeds == [0, 1, 2]
    np.testing.assert_allclose((row.outcome == "success").mean(axis=1), [0.94, 0.92, 0.94])
    np.testing.assert_array_equal(row.steps[:, 0], [40, 41, 42])
    assert set(row.hit.ravel()) == {"", "human", "square"}
    assert read_row(folder, 1, "quick", "sarl-sfm3", [0, 1]) is None
    assert read_row(folder, 2, "quick", "sarl", [0, 1]) is None


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("test.csv", None),
        ("test.csv", "episode\n0\n"),
        ("validation.csv", "episode,success\n0,x\n"),
        ("validation.csv", "episode,success\n"),
        ("metrics.csv", "episode,outcome,steps\n0,success,x\n"),
        ("metrics.csv", "episode,outcome,steps\n0,success,9999999999999999999999\n"),
    ],
)
def test_a_run_that_cannot_be_read_is_one_error(folder, name, text):
    path = run_folder(folder, 1, "quick", "sarl", 0) / name
    path.unlink() if text is None else path.write_text(text)
    with pytest.raises(ConfigError, match=rf"sarl-seed0/{name} (cannot be read \(.*\)|has no rows); delete this run"):
        read_row(folder, 1, "quick", "sarl", [0])


@pytest.mark.parametrize("name", ["test.csv", "validation.csv", "metrics.csv"])
def test_runs_of_other_episodes_are_refused(folder, name):
    write_run(folder, "sarl", 4, 0.9, shifted=name)
    with pytest.raises(ConfigError, match=f"sarl-seed4/{name} lists other episodes than that of .*sarl-seed0"):
        read_row(folder, 1, "quick", "sarl", [0, 4])


def test_means_intervals_and_differences():
    rows = {"sarl": figures(trained([0.96, 0.97, 0.99])), "sarl-sfm2": figures(trained([0.85, 0.86, 0.87, 0.88]))}
    sarl, sfm2 = summarise(TABLES[1], rows)
    success, difference = sfm2["figures"]["success"], sfm2["difference"]
    low, high = mean_interval(success["values"])
    deviation = pytest.approx(np.std([0.85, 0.86, 0.87, 0.88], ddof=1))
    values = pytest.approx([0.85, 0.86, 0.87, 0.88])
    mean = pytest.approx(0.865)
    assert success == {"mean": mean, "low": low, "high": high, "deviation": deviation, "values": values}
    assert sfm2["wilson"][0] == list(wilson(425, 500))
    assert sarl["difference"] is None
    assert difference["seeds"] == [0, 1, 2]
    gaps = scipy.stats.ttest_rel([0.85, 0.86, 0.87], [0.96, 0.97, 0.99])
    found = [difference[name] for name in ("mean", "low", "high", "p", "paper")]
    assert found == pytest.approx([-0.34 / 3, *gaps.confidence_interval(), gaps.pvalue, 0.86 - 0.965])


@pytest.mark.parametrize(
    ("rates", "verdict"),
    [
        ([0.85, 0.86, 0.87, 0.86, 0.86], "consistent"),  # the paper has 0.86
        ([0.99, 0.992, 0.995, 0.99, 0.994], "inconsistent"),
        ([0.60, 0.95, 0.80, 0.99, 0.90], "inconclusive"),  # anything is possible
        ([0.99, 0.992, 0.995, 0.99], "inconclusive"),  # fewer than five seeds
    ],
)
def test_verdicts(rates, verdict):
    (row,) = summarise(TABLES[1], {"sarl-sfm2": figures(trained(rates))})
    assert row["verdict"] == verdict


def test_the_papers_differences_are_rounded_twice():
    """As the difference of two figures with two digits, each may be off by 0.01."""
    reported, near = 0.86 - 0.965, 0
    for hits in range(400, 500):
        rows = {"sarl": figures(trained([0.96] * 5)), "sarl-sfm2": figures(trained([hits / 500] * 5))}
        difference = summarise(TABLES[1], rows)[1]["difference"]
        low, high = difference["expected"]
        beyond = max(low - reported, reported - high)
        assert (difference["verdict"] == "inconsistent") == (beyond > 0.01)
        near += 0.005 < beyond <= 0.01
    assert near  # so that one rounding would not do


def test_the_interval_of_a_difference_of_rates_ends_at_one():
    rows = {"sarl": figures(trained([0.9, 0.1])), "sarl-sfm2": figures(trained([0.2, 0.8]))}
    difference = summarise(TABLES[1], rows)[1]["difference"]
    assert (difference["low"], difference["high"]) == (-1.0, 1.0)


def test_what_the_two_ingredients_change():
    success = {"sarl": [0.9, 0.8], "sarl-sfm2": [0.8, 0.8], "sarl-sfm5": [1.0, 1.0], "sarl-sfm6": [0.9, 0.9]}
    rows = {name: figures(trained(rates, validation=np.zeros((2, 4)))) for name, rates in success.items()}
    found = {(c["of"], c["in"]): c for c in contrasts(rows)}
    forces = found["forces in the state", "success"]
    assert forces["values"] == pytest.approx([0.1, 0.15])  # of 0.1 and 0.1, of 0.2 and 0.1
    assert forces["mean"] == pytest.approx(0.125)
    assert forces["high"] == pytest.approx(0.125 + 0.025 * 12.7062, abs=1e-4)  # t of one degree of freedom
    assert found["SFM reward", "success"]["values"] == pytest.approx([-0.1, -0.05])
    assert forces["p"] == pytest.approx(scipy.stats.ttest_1samp([0.1, 0.15], 0).pvalue)
    known = [c for c in contrasts(rows) if c["p"] is not None]
    by_p = sorted(known, key=lambda c: c["p"])
    steps = [min(1.0, c["p"] * (len(by_p) - rank)) for rank, c in enumerate(by_p)]
    assert [c["p_holm"] for c in by_p] == pytest.approx(list(np.maximum.accumulate(steps)))
    sheet = sheets(summarise(TABLES[1], rows), contrasts(rows), "Table 1")[-1]
    assert ["episodes until validation 0.9", "-", "-"] in [list(line.values()) for line in sheet.lines]
    del rows["sarl-sfm6"]
    assert contrasts(rows) == []


def test_sheets_hold_in_80_columns_and_become_markdown():
    rows = {name: figures(trained([0.9 + 0.01 * (s % 7) for s in range(10)])) for name in TABLES[1].paper}
    pages = sheets(summarise(TABLES[1], rows), contrasts(rows), "Table 1")
    assert len(pages) == 5
    for page in pages:
        assert len({tuple(line) for line in page.lines}) == 1
        columns = zip(*([*line.values()] for line in page.lines), strict=True)
        widths = [max(len(part) for cell in column for part in cell.split("\n")) for column in columns]
        assert sum(widths) + len(widths) <= 80
        lines = page.markdown().splitlines()
        assert len({line.count("|") for line in lines[2:]}) == 1
        assert "\n" not in lines[2]


def test_what_is_equal_in_every_row_of_a_training_stands_in_the_title():
    slow = trained([0.9, 0.9], validation=np.array([[0.5, 0.8, 0.95, 0.9], [0.5, 0.8, 0.8, 0.95]]))
    rows = {"sarl": figures(trained([0.9, 0.9])), "sarl-sfm": figures(trained([0.9, 1.0]))}
    (alike,) = (page for page in sheets(summarise(TABLES[1], rows), [], "Table 1") if "25 s" in page.title)
    assert alike.title.endswith("validation success 0.9 (in every row: 500 episodes, 20,000 steps, 2 of 2 runs)")
    assert list(alike.lines[0]) == ["row", "time, s"]
    rows["sarl-sfm"] = figures(slow)
    (apart,) = (page for page in sheets(summarise(TABLES[1], rows), [], "Table 1") if "25 s" in page.title)
    assert apart.title.endswith("validation success 0.9 (in every row: 2 of 2 runs)")
    assert [list(line.values())[2:] for line in apart.lines] == [["500", "20,000"], ["750", "30,000"]]
    never = {name: figures(trained([0.9, 0.9], validation=np.full((2, 4), 0.5))) for name in rows}
    (short,) = (page for page in sheets(summarise(TABLES[1], never), [], "Table 1") if "25 s" in page.title)
    assert short.title.endswith("validation success 0.9 (in every row: 0 of 2 runs)")
    (alone,) = sheets(summarise(TABLES[1], {"sarl": figures(slow)}), [], "Table 1")[2:]
    assert list(alone.lines[0]) == ["row", "time, s", "episodes", "steps", "runs"]


def test_rates_are_written_without_their_zero():
    assert [rate(x) for x in (0.9, 1.0, -0.05, 0.0, -0.0001, None)] == [".900", "1.000", "-.050", ".000", "-.000", "-"]


@pytest.mark.parametrize("path", sorted(make_tables.RESULTS.glob("*.[mc][ds]*")), ids=lambda path: path.name)
def test_the_results_on_show_follow_from_their_values_of_every_seed(path):
    parts = [re.split(r"([-\d.e+]*\d)", text) for text in (path.read_text(), make_tables.texts()[path])]
    assert parts[0][::2] == parts[1][::2]
    shown, computed = (np.array(part[1::2], dtype=str) for part in parts)
    if path.suffix == ".csv":  # all digits are there, and the last one may depend on the processor
        differ = shown != computed
        np.testing.assert_allclose(shown[differ].astype(float), computed[differ].astype(float), rtol=1e-9, atol=1e-12)
    else:
        np.testing.assert_array_equal(shown, computed)


def test_rows_that_miss_a_seed_leave_its_cells_empty():
    runs = {"sarl": trained([0.9], seeds=[1]), "sarl-sfm2": trained([0.8, 0.9], seeds=[0, 1])}
    first, *_, last = csv.DictReader(csv_text(table_validations(runs)).splitlines())
    assert (first["low"], first["high"], first["seed 0"], first["seed 1"]) == ("", "", "", "0.5")
    assert (last["row"], last["seed 0"]) == ("sarl-sfm2", "0.9")
    rows = {name: figures(run) for name, run in runs.items()}
    _, points, *_ = sheets(summarise(TABLES[1], rows), [], "Table 1")
    assert [line["seeds 0-1"] for line in points.lines] == ["- .900", ".800 .900"]


def test_trainings_that_a_figure_lacks_are_told(in_process, folder):
    done = in_process(
        "figure", "1", "--folder", str(folder), "--rows", "sarl,sarl-sfm6", "--seeds", "0-3", "--csv", "f.csv"
    )
    assert "1 of 8 trainings are not finished and are left out" in done.stderr


def test_there_is_a_line_a_validation(folder):
    rows = {name: read_row(folder, 1, "quick", name, [0, 1, 2, 3]) for name in ("sarl", "sarl-sfm2", "sarl-sfm6")}
    lines = table_validations(rows)
    assert [(line["row"], line["episode"]) for line in lines[:5]] == [("sarl", e) for e in EPISODES] + [
        ("sarl-sfm2", 0)
    ]
    assert lines[1]["mean"] == pytest.approx(0.8)


def test_training_validation_and_test_episodes_are_all_different():
    starts = [
        sample_scenes("table1", 300, seed, phase=phase).start
        for phase, seed in (("train", 0), ("train", 1), ("validation", 0), ("test", 0), ("imitation", 0))
    ]
    flat = np.concatenate(starts).reshape(5 * 300, -1)
    assert len(np.unique(np.nan_to_num(flat, nan=99.0), axis=0)) == 5 * 300


def test_the_command_makes_a_table_and_a_figure_from_folders(sfmrl, folder, tmp_path):
    common = ("1", "--folder", folder, "--rows", "sarl,sarl-sfm6", "--seeds", "0-3")
    done = sfmrl("table", *common, "--no-train", "--csv", "t.csv", "--markdown", "t.md")
    assert done.returncode == 0, done.stderr
    assert "1 of 8 trainings are not finished" in done.stderr
    assert "sarl-sfm6" in done.stdout
    assert (tmp_path / "t.md").read_text().count("| sarl-sfm6 |") == 4
    lines = list(csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))
    success = {(line["row"], line["seed"]): line for line in lines if line["metric"] == "success"}
    assert len(success) == 5 + 4
    assert float(success["sarl", "all"]["value"]) == pytest.approx(0.95)
    assert success["sarl", "all"]["paper"] == "0.96/0.97"
    again = sfmrl("table", *common, "--no-train", "--csv", "t.csv")
    assert (again.returncode, again.stderr.count("\n")) == (2, 1)
    found = json.loads(sfmrl("table", *common, "--no-train", "--json").stdout)
    assert [row["row"] for row in found["rows"]] == ["sarl", "sarl-sfm6"]
    drawn = sfmrl("figure", *common, "--out", "f.svg", "--csv", "f.csv")
    assert drawn.returncode == 0, drawn.stderr
    assert "success in validation" in (tmp_path / "f.svg").read_text()
    assert (tmp_path / "f.csv").read_text().count("sarl-sfm6") == len(EPISODES)


def test_the_figure_of_single_runs_has_the_interval_of_each_validation(sfmrl, tmp_path):
    tiny = ("--validation-episodes", 4, "--test-episodes", 4, "--no-recover", "--threads", 1)
    trained = sfmrl("rl", "--from-scratch", "--run", "mine", "--episodes", 4, *tiny)
    assert trained.returncode == 0, trained.stderr
    done = sfmrl("figure", "mine", "--out", "f.svg", "--csv", "f.csv")
    assert done.returncode == 0, done.stderr
    lines = list(csv.DictReader((tmp_path / "f.csv").read_text().splitlines()))
    assert [(line["row"], line["episode"]) for line in lines] == [("mine", "0"), ("mine", "4")]
    for line in lines:
        assert (float(line["low"]), float(line["high"])) == pytest.approx(wilson(round(4 * float(line["mean"])), 4))
    assert "mine" in (tmp_path / "f.svg").read_text()
    unlist({"validation.csv"}, tmp_path / "mine")  # as in a training that is not finished
    (tmp_path / "mine" / "validation.csv").write_text("episode,success\n0,0.5\n4,")
    done = sfmrl("figure", "mine", "--out", "f.svg", "--overwrite")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "validation.csv cannot be read" in done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("1", "2", "--out", "f.svg"), "one table, or runs"),
        (("nowhere", "--out", "f.svg"), "nowhere does not exist"),
        (("1", "--out", "f.bmp"), "must end in .svg, .png, .pdf"),
        (("1", "--out", "f.svg", "--csv", "./f.svg"), "--out and --csv name the same file"),
        (("mine", "mine", "--csv", "f.csv"), "figure takes each run once"),
        (("mine", "mine/", "--csv", "f.csv"), "figure takes each run once"),
        (("mine", "--csv", "f.csv", "--seeds", "5"), "--seeds selects trainings of a table; leave it out"),
    ],
)
def test_a_figure_that_cannot_be_drawn_is_one_line(in_process, words, said):
    assert_one_line_error(in_process("figure", *words), said)


def test_jobs_are_printed_as_commands(sfmrl):
    done = sfmrl("table", "2", "--print-jobs", "--seeds", "0-1")
    lines = done.stdout.splitlines()
    assert len(lines) == 6
    assert all(line.startswith(("sfmrl il ", "sfmrl rl ")) for line in lines)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("table", "3"), "less than or equal to 2"),
        (("table", "1", "--rows", "sarl-sfm9"), "no row 'sarl-sfm9'"),
        (("table", "1", "--preset", "fast"), "no preset 'fast'"),
        (("table", "1", "--on", "moon"), "choose here or ray"),
        (("table", "1", "--print-jobs", "--json"), "--print-jobs and --json exclude each other"),
        (("table", "1", "--no-train"), "holds no finished run"),
        (("figure", "1", "--seeds", "x"), "neither a seed nor a range"),
        (("table", "1", "--csv", "no/such.csv"), "there is no folder no"),
        (("table", "1", "--csv", "t", "--markdown", "t"), "--csv and --markdown name the same file"),
    ],
)
def test_wrong_use_is_one_line(in_process, words, said):
    assert_one_line_error(in_process(*words), said)


def test_the_ablation_changes_one_thing_at_a_time_and_pairs_seeds(tmp_path):
    (il, rl), *others = (make_ablation.trainings(tmp_path, 3, *what) for what in make_ablation.INGREDIENTS.values())
    assert rl == make_jobs(1, "quick", [3], ["sarl-sfm2"], tmp_path)[1]
    options = list(make_ablation.INGREDIENTS.values())[1:]
    for (name, both, il_options, rl_options), (its_il, its_rl) in zip(options, others, strict=True):
        assert its_rl.folder.name == f"{name}-seed3"
        assert its_rl.needs == its_il.folder
        assert " ".join(its_rl.words).endswith(f"{both} {rl_options}".strip())
        assert (its_il == il) == (not both and not il_options)
    lines = [
        {"switched off": what, "options": "--x", "seed": seed, **dict.fromkeys(make_ablation.FIGURES, value)}
        for what, values in (("nothing", (0.9, 0.8, 0.7)), ("this", (0.8, 0.8, 0.6)))
        for seed, value in enumerate(values)
    ]
    low, high = scipy.stats.t.interval(0.95, 2, -0.2 / 3, scipy.stats.sem([-0.1, 0, -0.1]))
    change = f"-.067 ({rate(low)} to {rate(high)})"
    late = f"-0.07 ({low:.2f} to {high:.2f})"
    expected = f"| this | `--x` | 0 1 2 | {change} | {late} | {change} | {change} |"
    assert expected in make_ablation.ablation_markdown(lines)


def test_scenes_with_few_people_keep_them_apart():
    scenes = make_ablation.few_people()
    people = ~np.isnan(scenes.start[:, 1:, 0])
    assert set(people.sum(1)) == {1, 2, 3}
    for places in (scenes.start, scenes.goal):
        assert np.nanmax(np.abs(places)) <= 12
        apart = length(places[:, :, None] - places[:, None])[:, ~np.eye(4, dtype=bool)]
        assert np.nanmin(apart) >= 1
        np.testing.assert_array_equal(~np.isnan(places[:, 1:, 0]), people)


def test_results_grow_by_the_runs_of_a_folder_and_keep_what_they_had(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(make_tables, "RESULTS", tmp_path)
    for name in ("make_ablation", "make_crowds"):
        monkeypatch.setattr(f"{name}.CSV", tmp_path / "none.csv")
    first = make_tables.texts(folder)
    assert {path.name for path in first} == {"table1-quick.csv", "table1-quick.md", "figure1-quick.csv"}
    for path, text in first.items():
        path.write_text(text)
    assert make_tables.texts()[tmp_path / "figure1-quick.csv"] == first[tmp_path / "figure1-quick.csv"]
    for seed in (0, 1, 2):
        shutil.rmtree(run_folder(folder, 1, "quick", "sarl", seed))  # but what they gave is in the CSV file
    write_run(folder, "sarl", 4, 0.9)
    grown = make_tables.read_figures(tmp_path / "table1-quick.csv", 50)["sarl"].values["success"].tolist()
    for path, text in make_tables.texts(folder).items():
        path.write_text(text)
    sarl = make_tables.read_figures(tmp_path / "table1-quick.csv", 50)["sarl"]
    assert (sarl.seeds, sarl.values["success"].tolist()) == ([0, 1, 2, 3, 4], [*grown, 0.9])
    course = make_tables.read_courses(tmp_path / "figure1-quick.csv")
    assert {name: row.seeds for name, row in course.items()} == {
        "sarl": [0, 1, 2, 3, 4], "sarl-sfm2": [0, 1, 2, 3], "sarl-sfm5": [0, 1, 2, 3], "sarl-sfm6": [0, 1, 2]
    }  # fmt: skip
