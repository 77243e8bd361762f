"""Configs as JSON, and settings of earlier versions."""

import json
from dataclasses import replace

import pytest

from sfmrl.config import Config, ConfigError


def test_a_config_comes_back_from_its_json():
    config = replace(Config(), seed=3, forces=True)
    assert Config.from_json(config.to_json()) == config


def test_a_retired_setting_is_passed_over_at_the_value_that_changed_nothing_and_refused_at_another():
    older = json.loads(Config().to_json()) | {"shaping": "none"}
    assert Config.from_json(json.dumps(older)) == Config()
    with pytest.raises(ConfigError, match=r"sfmrl 0.1.0 with shaping 'geodesic'; play it with that version"):
        Config.from_json(json.dumps(older | {"shaping": "geodesic"}))
