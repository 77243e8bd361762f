"""The networks that come with sfmrl: each does what its card says, at once and without a network connection."""

import json
import shutil

import numpy as np
import pytest

from sfmrl.episodes import play
from sfmrl.evaluation import evaluation_record, wilson
from sfmrl.policies import load_policy
from sfmrl.runs import weights
from sfmrl.runs.bits import machine_bits
from sfmrl.runs.create import variant_name
from sfmrl.runs.files import DamagedFile
from sfmrl.runs.weights import find_weights, load_weights, model_card, model_names
from sfmrl.scenes import Scenes
from sfmrl.study.tables import TABLES
from sfmrl.variants import make_config

NAMES = model_names()


def test_there_is_a_model_for_each_row_of_both_tables_and_for_a_unicycle():
    rows = [*TABLES[1].paper, *(f"{row}-table2" for row in TABLES[2].paper)]
    assert sorted([*rows, "sarl-sfm2-unicycle"]) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_model_is_what_its_card_says(name):
    card = model_card(name)
    network, config = load_weights(find_weights(name))
    assert len(network.flat) == card["parameters"]
    assert (config.seed, config.preset) == (card["seed"], card["preset"])
    assert config.forces == make_config(variant=card["variant"]).forces
    assert config.reward == make_config(variant=card["variant"]).reward
    if not name.endswith("-table2"):
        assert variant_name(config) == card["variant"]
        assert name == card["variant"] + "-unicycle" * (config.simulation.kinematics == "unicycle")
    assert config.reinforcement.test_environment == card["environment"]
    for test in (card["alone"], card["with_recovery"]):
        assert test["success"] + test["collision"] + test["timeout"] == pytest.approx(1)
        hits = round(test["success"] * test["episodes"])
        assert test["interval"] == pytest.approx(wilson(hits, test["episodes"]))
    assert [command.split()[:2] for command in card["commands"]] == [["sfmrl", "il"], ["sfmrl", "rl"]]


@pytest.mark.parametrize("name", NAMES)
def test_a_model_does_on_100_episodes_what_its_card_says(name):
    """To the episode where this machine computes the bits of the one that tested it; elsewhere three may differ."""
    card = model_card(name)
    record = evaluation_record(load_policy(name), episodes=100)
    outcomes = "".join(outcome[0] for outcome in record.outcome)
    allowed = 0 if card.get("bits") == machine_bits() else 3  # older cards do not name any bits
    assert sum(a != b for a, b in zip(outcomes, card["outcomes"], strict=True)) <= allowed
    assert np.mean(record.outcome == "success") >= 0.95


@pytest.mark.parametrize("name", NAMES)
def test_a_model_goes_straight_in_an_empty_field(name):
    """Eight headings, goals 4, 8 and 12 m away, alone or with somebody 30 m off."""
    angle, distance = np.meshgrid(np.arange(8) * np.pi / 4, [4.0, 8.0, 12.0])
    goal = np.zeros((24, 2, 2))
    goal[:, 0] = (distance * np.stack((np.cos(angle), np.sin(angle)))).reshape(2, 24).T
    start = np.zeros((24, 2, 2))
    start[:, 1] = goal[:, 1] = np.where(np.arange(24)[:, None] % 2, (30.0, 0.0), np.nan)
    record = play(Scenes(start, goal, v_pref=(1.0, 0.0)), load_policy(name).original)
    assert (record.outcome == "success").all()
    assert (record.time <= 1.15 * np.ceil((distance.ravel() - 0.3) / 0.25) * 0.25).all()


@pytest.mark.parametrize("name", ["sarl", "sarl-sfm6"])
def test_a_model_passes_one_to_three_people_anywhere(name):
    rng = np.random.default_rng(5)
    start, goal = rng.uniform(-12, 12, (2, 100, 4, 2))
    start[:, 0], goal[:, 0] = (0, -4), (0, 4)
    start[np.arange(4) > rng.integers(1, 4, size=(100, 1))] = np.nan
    crowded = (np.hypot(*(start[:, :1] - start[:, 1:]).T) < 0.8).any(0)  # at the start, where nobody could help it
    start[crowded, 1:] = np.nan
    outcome = play(Scenes(start, goal), load_policy(name)).outcome
    assert (outcome == "success").mean() >= 0.98


def test_a_changed_model_is_refused(tmp_path, monkeypatch):
    shutil.copytree(weights.MODELS, tmp_path / "models")
    monkeypatch.setattr(weights, "MODELS", tmp_path / "models")
    path = find_weights(NAMES[0])
    path.write_bytes(path.read_bytes() + b"x")
    with pytest.raises(DamagedFile, match="install sfmrl again"):
        load_policy(NAMES[0])


def test_the_command_lists_models_and_prints_a_card(sfmrl):
    listed = sfmrl("models")
    assert listed.returncode == 0, listed.stderr
    assert all(any(line.startswith(f"{name} ") for line in listed.stdout.splitlines()) for name in NAMES)
    assert max(map(len, listed.stdout.splitlines())) <= 100
    one = sfmrl("models", NAMES[0])
    assert model_card(NAMES[0])["sha256"] in one.stdout
    assert json.loads(sfmrl("models", NAMES[0], "--json").stdout) == model_card(NAMES[0])
    assert set(json.loads(sfmrl("models", "--json").stdout)) == set(NAMES)
    wrong = sfmrl("models", "sarl-sfm7")
    assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1)
    assert "did you mean sarl-sfm" in wrong.stderr


def test_a_model_plays_by_name(sfmrl):
    done = sfmrl("eval", NAMES[0], "--episodes", 5)
    assert done.returncode == 0, done.stderr
    assert "with recovery" in done.stdout
    shown = sfmrl("ascii-render", NAMES[0], "--frames", 1)
    assert shown.returncode == 0, shown.stderr
