"""Policies compared on the same episodes: counts by hand, intervals elsewhere, one line for wrong use."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from conftest import assert_one_line_error

from sfmrl.config import Config, ConfigError
from sfmrl.evaluation import evaluation_record
from sfmrl.fast import as_fast
from sfmrl.network import ValueNetwork
from sfmrl.policies import POLICIES
from sfmrl.runs.weights import save_weights
from sfmrl.study.compare import compare, comparison_sheets, social_sheet
from sfmrl.study.sheets import rate
from sfmrl.study.social import SOCIAL_METRICS, social_metrics, social_values

NAMES = ["orca", "linear", "sfm"]


@pytest.fixture(scope="module")
def records():
    return [evaluation_record(name, environment="1", episodes=30) for name in NAMES]


def compared(records):
    return compare(records, [POLICIES[name] for name in NAMES], NAMES)


def test_what_differs_is_counted_episode_by_episode(records):
    found = compared(records)
    success = [record.outcome == "success" for record in records]
    for row, ours in zip(found["policies"][1:], success[1:], strict=True):
        gap = row["less_first"]
        assert gap["only_this"] == sum(ours & ~success[0])
        assert gap["only_first"] == sum(success[0] & ~ours)
        assert gap["success"]["mean"] == pytest.approx(ours.mean() - success[0].mean())
        assert gap["success"]["p"] == pytest.approx(
            scipy.stats.binomtest(gap["only_this"], gap["only_this"] + gap["only_first"]).pvalue
        )
        assert gap["success"]["low"] <= gap["success"]["mean"] <= gap["success"]["high"]
        assert gap["success"]["p"] <= gap["success"]["p_holm"] <= 1
    first, second = sorted((row["less_first"]["success"] for row in found["policies"][1:]), key=lambda gap: gap["p"])
    assert first["p"] < 0.5
    assert first["p_holm"] == pytest.approx(2 * first["p"])
    assert second["p_holm"] == pytest.approx(max(first["p_holm"], second["p"]))
    assert "less_first" not in found["policies"][0]
    differing = {row["episode"]: row["outcomes"] for row in found["differing"]}
    assert set(differing) == {e for e in range(30) if len({bool(s[e]) for s in success}) == 2}
    for episode, outcomes in differing.items():
        assert list(outcomes.values()) == [record.outcome[episode] for record in records]
    json.dumps(found, allow_nan=False)


def test_times_are_compared_where_both_succeed(records):
    found = compared(records)["policies"][2]["less_first"]["navigation_time"]
    both = (records[2].outcome == "success") & (records[0].outcome == "success")
    theirs = scipy.stats.ttest_rel(*(r.time[both] for r in (records[2], records[0])))
    assert found["mean"] == pytest.approx((records[2].time - records[0].time)[both].mean())
    assert (found["low"], found["high"]) == pytest.approx(tuple(theirs.confidence_interval()))


def test_social_metrics_are_compared_where_both_have_a_value(records):
    found = compared(records)["policies"]
    ours, theirs = (social_values(records[k])["danger_separation"] for k in (1, 0))
    gap = (ours - theirs)[~np.isnan(ours) & ~np.isnan(theirs)]
    for row, record in zip(found, records, strict=True):
        for name, values in social_values(record).items():  # the same estimand as the differences
            assert row["social"][name] == pytest.approx(np.nanmean(values))
    pooled = social_metrics(records[0])
    assert found[0]["social"]["danger_frequency"] != pytest.approx(pooled["danger_frequency"], abs=1e-3)
    assert found[1]["less_first"]["social"]["danger_separation"]["mean"] == pytest.approx(gap.mean())
    sheet = social_sheet(compared(records))
    assert "means over episodes" in sheet.title
    lines = sheet.lines
    assert lines[0]["orca"] == rate(found[0]["social"]["danger_frequency"])
    assert [line["metric"] for line in lines] == list(SOCIAL_METRICS)
    assert list(lines[0])[1:] == ["orca", "linear - orca", "sfm - orca"]


def test_other_episodes_are_refused(records):
    other = evaluation_record("linear", environment="1", episodes=30, seed=1)
    scenes = records[0].scenes
    farther = replace(records[0], scenes=replace(scenes, goal=scenes.goal + 1.0))
    for changed in (other, farther):
        with pytest.raises(ConfigError, match="same episodes"):
            compare([records[0], changed], [POLICIES["orca"], POLICIES["linear"]], ["orca", "linear"])


def test_policies_that_are_alike_differ_in_nothing(records):
    found = compare([records[0]] * 2, [POLICIES["orca"]] * 2, ["orca", "again"])
    assert found["differing"] == []
    assert found["policies"][1]["less_first"]["success"]["p"] == 1
    assert found["policies"][1]["less_first"]["success"]["high"] > 0.1
    sheets = comparison_sheets(found, "title")
    assert len(sheets) == 2
    assert sheets[1].lines[0]["nav. time minus\nthe first's"] == "0.00 (-)"


def test_names_in_headings_are_no_markup(sfmrl, tmp_path):
    (tmp_path / "[a].py").write_text("def walk(world, velocity):\n    return velocity[:, 0]\n")
    done = sfmrl("compare", "orca", "[a].py:walk", "--social", "--episodes", 2)
    assert "[a].py:walk - orca" in done.stdout  # the heading of the social metrics


def test_one_episode_is_called_one_and_a_pair_of_times_has_no_interval(sfmrl):
    words = ("--episodes", 1, "--environment", 5, "--seed", 1)
    done = sfmrl("compare", "orca", "sfm", *words)
    assert "environment 5, 1 episode, seed 1" in done.stdout
    assert "1 episode, seed 1" in sfmrl("eval", "orca", *words).stdout


def test_the_command(sfmrl, tmp_path):
    words = ("compare", "orca", "linear", "--episodes", 20, "--environment", 1)
    done = sfmrl(*words, "--csv", "c.csv")
    assert done.returncode == 0, done.stderr
    assert "Differences from orca" in done.stdout
    assert "see one: sfmrl ascii-render orca --versus linear" in done.stderr
    with open(tmp_path / "c.csv") as file:
        lines = list(csv.DictReader(file))
    assert [line["policy"] for line in lines] == ["orca"] * 20 + ["linear"] * 20
    path = social_values(evaluation_record("linear", environment="1", episodes=20))["path_length"]
    assert [float(line["path_length"]) for line in lines[20:]] == path.tolist()
    found = json.loads(sfmrl(*words, "--json").stdout)
    wins = [line["outcome"] == "success" for line in lines]
    assert found["policies"][0]["success"] == sum(wins[:20]) / 20


def test_all_total_rewards_have_the_first_policy_s_discount(sfmrl, tmp_path):
    network, words = ValueNetwork(value_prior=True), ("--environment", "circle0", "--episodes", 2)
    for discount in (0.9, 0.8):
        save_weights(as_fast(network), Config(value_prior=True, discount=discount), tmp_path / f"{discount}.npz")
    alone = json.loads(sfmrl("eval", "0.8.npz", *words, "--json").stdout)["total_reward"]
    both = json.loads(sfmrl("compare", "0.8.npz", "linear", "0.9.npz", *words, "--json").stdout)["policies"]
    assert both[0]["total_reward"] == alone
    linear = evaluation_record("linear", environment="circle0", episodes=2, discount=0.8)
    assert both[1]["total_reward"] == linear.discounted_return.mean()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("orca",), "two or more different policies"),
        (("orca", "orca"), "two or more different policies"),
        (("orca", "lineal"), "did you mean linear?"),
        (("orca", "linear", "--environment", "9"), "no environment"),
    ],
)
def test_wrong_use_is_one_line(in_process, words, said):
    assert_one_line_error(in_process("compare", *words), said)


def test_who_has_recovery_is_said(in_process):
    words = ("compare", "orca", "sarl", "sarl-sfm2", "--environment", "circle0", "--episodes", "1")
    assert "with recovery: sarl, sarl-sfm2\n" in in_process(*words).stdout
    assert "with recovery" not in in_process(*words, "--no-recover").stdout
