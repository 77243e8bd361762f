"""Configs as JSON, and settings of earlier versions."""

import json
from dataclasses import replace

import pytest

from sfmrl.config import Config, ConfigError, Reward, as_typed
from sfmrl.variants import make_config


def test_a_config_comes_back_from_its_json():
    config = replace(Config(), seed=3, forces=True)
    assert Config.from_json(config.to_json()) == config


@pytest.mark.parametrize("setting", [{"shaping": "none"}, {"avoid_traps": True}, {"sparse": 0.1}])
def test_a_config_of_an_earlier_version_is_refused_with_the_version_that_plays_it(setting):
    older = json.loads(Config().to_json()) | setting
    with pytest.raises(ConfigError, match=r"made by a version of sfmrl before 0.3.0; install that version"):
        Config.from_json(json.dumps(older))


def test_a_part_of_a_config_is_given_by_name_or_whole_and_a_name_of_its_own_is_found():
    reward = Reward(k=0.003)
    assert make_config(reward=reward).reward == reward == make_config(reward={"k": 0.003}).reward
    with pytest.raises(ConfigError, match=r"no setting 'k' in config; give it as reward=\{'k': ...\}"):
        make_config(k=0.003)
    with pytest.raises(ConfigError, match=r"no setting 'sed' in config; did you mean seed\?"):
        make_config(sed=3)
    with pytest.raises(ConfigError, match=r"give it as imitation=\{'episodes': ...\} or reinforcement=\{'episodes'"):
        make_config(episodes=3)
    with pytest.raises(ConfigError, match=r"there is no setting 'longest' in config$"):
        make_config(longest=3)


def test_the_paper_s_preset_has_the_published_numbers():
    config = make_config("paper")
    il, rl = config.imitation, config.reinforcement
    assert (il.episodes, il.epochs, il.batch_size, il.learning_rate, il.refit) == (3000, 50, 100, 0.01, True)
    assert (rl.episodes, rl.parallel, rl.batches, rl.batch_size, rl.learning_rate) == (10_000, 1, 100, 100, 0.001)
    assert (rl.targets, rl.target_interval, rl.memory) == ("td", 50, 100_000)
    assert (rl.epsilon_start, rl.epsilon_end, rl.epsilon_episodes) == (0.5, 0.1, 4000)
    assert (rl.validation_interval, rl.validation_episodes, rl.test_episodes) == (1000, 100, 500)
    assert (config.optimizer, config.simulation.squares, config.discount) == ("sgd", "disc", 0.9)
    ours = (config.value_prior, config.careful, config.mirror, config.planner.recover)
    assert ours == (False, False, False, False)


def test_what_to_type_is_quoted_as_the_system_s_shells_take_it(monkeypatch):
    words = ["sfmrl", "eval", "my runs/one", "--reward", "calm.py:calm"]
    assert as_typed(words) == "sfmrl eval 'my runs/one' --reward calm.py:calm"
    monkeypatch.setattr("sfmrl.config.WINDOWS", True)
    assert as_typed([r"runs\il-sarl-seed0", "C:\\my runs\\"]) == r'runs\il-sarl-seed0 "C:\my runs"'
    assert as_typed(["1:0.7,2:0.3"]) == '"1:0.7,2:0.3"'  # a comma would be an array in PowerShell
