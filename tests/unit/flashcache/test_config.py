import json

import pytest
from flashcache.config import Config, ExportConfig, from_dict, to_dict, with_overrides
from flashcache.errors import ConfigError
from flashcache.presets import PRESETS, preset


@pytest.mark.parametrize("name", PRESETS)
def test_a_configuration_survives_json(name: str):
    config = preset(name)
    assert from_dict(Config, json.loads(json.dumps(to_dict(config)))) == config


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("old", [64, 512, 2048])
def test_a_job_that_states_only_the_size_of_the_albedo_runs_with_every_preset(name: str, old: int):
    plain = preset(name).export
    found = with_overrides(preset(name), {"export.atlas_size": str(old)}).export
    assert (found.atlas_size, found.transport_size) == (old, min(old, plain.transport_size))


def test_a_size_that_is_left_open_does_not_move_transport():
    found = with_overrides(preset("tiny"), {"export.atlas_size": "0"}).export
    assert (found.atlas_size, found.transport_size) == (0, preset("tiny").export.transport_size)


@pytest.mark.parametrize(
    ("atlas", "transport", "message"),
    [
        (100, 64, "atlas_size must be a multiple of 16 texels up to 8192, or 0, got 100"),
        (8208, 64, "up to 8192"),
        (-16, 64, "atlas_size"),
        (1024, 500, "transport_size must be a multiple of 16 texels up to 4096, got 500"),
        (8192, 4112, "up to 4096"),
        (0, 0, "transport_size"),
        (256, 512, "at least export.transport_size"),
    ],
)
def test_sizes_that_cannot_be_halved_twice_or_cross_are_refused(atlas: int, transport: int, message: str):
    with pytest.raises(ConfigError, match=message):
        ExportConfig(atlas_size=atlas, transport_size=transport)


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
