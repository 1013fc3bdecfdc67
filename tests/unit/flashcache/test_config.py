import json

import pytest
from flashcache.config import Config, from_dict, to_dict, with_overrides
from flashcache.errors import ConfigError
from flashcache.presets import PRESETS, preset


@pytest.mark.parametrize("name", PRESETS)
def test_a_configuration_survives_json(name: str):
    config = preset(name)
    assert from_dict(Config, json.loads(json.dumps(to_dict(config)))) == config


REMOVED_GROUP = {"error_share": 0.0, "block": 64, "memory": 0.9}


def with_removed(**two: object) -> dict:
    values = to_dict(preset("tiny"))
    return values | {"stage_two": values["stage_two"] | two}


def test_an_earlier_releases_settings_are_read_where_they_did_nothing():
    values = with_removed(weight_gradient=0.0, budget=REMOVED_GROUP)
    values["model"]["nerf"]["antialias"] = "none"
    assert from_dict(Config, values) == preset("tiny")


@pytest.mark.parametrize(
    "two", [{"weight_gradient": 1.0}, {"budget": REMOVED_GROUP | {"error_share": 0.4}}, {"budget": 0.0}]
)
def test_a_removed_setting_that_had_an_effect_is_refused(two: dict):
    with pytest.raises(ConfigError, match=rf"stage_two\.{next(iter(two))}' was removed"):
        from_dict(Config, with_removed(**two))


def test_an_override_changes_one_setting():
    config = with_overrides(preset("tiny"), {"stage_one.num_rays": "64"})
    assert config.stage_one.num_rays == 64
    assert config.stage_two == preset("tiny").stage_two


def test_an_override_may_be_a_bare_word():
    config = with_overrides(preset("tiny"), {"stage_two.estimator.control_variate": "off"})
    assert config.stage_two.estimator.control_variate == "off"


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("stage_one.num_ray", "64", "num_rays"),
        ("stage_three.num_rays", "64", "no group 'stage_three'"),
        ("stage_one.num_rays", "many", "must be of type int"),
        ("stage_one.num_rays", "true", "must be of type int"),
        ("stage_one.num_rays", "0", "at least 1"),
        ("stage_one.normal_ramp", "[0.1]", "has 2 values"),
        ("stage_two.points", "median", "must be one of"),
        ("stage_two.estimator.control_variate", "maybe", "control_variate"),
    ],
)
def test_a_wrong_setting_is_named(path: str, value: str, message: str):
    with pytest.raises(ConfigError, match=message):
        with_overrides(preset("tiny"), {path: value})
