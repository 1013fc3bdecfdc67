from dataclasses import replace

import pytest
from flashcache.data.space import SpaceConfig
from flashcache.errors import ConfigError
from flashcache.presets import PRESETS, preset

PAPER = [name for name in PRESETS if name.startswith("paper")]


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_knows_its_name_and_comes_out_equal_every_time(name: str):
    assert preset(name).preset == name
    assert preset(name) == preset(name)


def test_no_two_presets_are_the_same_configuration():
    assert len({replace(preset(name), preset="") for name in PRESETS}) == len(PRESETS)


def test_an_unknown_preset_is_answered_with_the_known_ones():
    with pytest.raises(ConfigError, match="tiny, quick, fast"):
        preset("quickest")


@pytest.mark.parametrize("name", [name for name in PRESETS if name not in PAPER])
def test_other_presets_leave_a_scene_where_its_capture_puts_it(name: str):
    assert preset(name).space == SpaceConfig()


@pytest.mark.parametrize("name", PRESETS)
def test_the_exponent_after_training_is_the_one_training_ends_with(name: str):
    config = preset(name)
    exponents = {config.model.nerf.exponent, config.stage_two.proposal_exponent}
    assert exponents == {config.stage_one.proposal_exponent}


@pytest.mark.parametrize(("name", "known"), [("paper_tensoir:cat", "armadillo"), ("fast:lego", "none")])
def test_an_unknown_published_scene_is_answered_with_the_known_ones(name: str, known: str):
    with pytest.raises(ConfigError, match=known):
        preset(name)
