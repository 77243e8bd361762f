"""Configs as JSON, and settings of earlier versions."""

import json
from dataclasses import replace

import pytest

from sfmrl.config import Config, ConfigError


def test_a_config_comes_back_from_its_json():
    config = replace(Config(), seed=3, forces=True)
    assert Config.from_json(config.to_json()) == config


@pytest.mark.parametrize("setting", [{"shaping": "none"}, {"avoid_traps": True}, {"sparse": 0.1}])
def test_a_config_of_an_earlier_version_is_refused_with_the_version_that_plays_it(setting):
    older = json.loads(Config().to_json()) | setting
    with pytest.raises(ConfigError, match=r"made by a version of sfmrl before 0.3.0; install that version"):
        Config.from_json(json.dumps(older))
