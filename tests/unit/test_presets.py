import pytest
from flashcache.config import config_hash
from flashcache.errors import ConfigError
from flashcache.presets import PRESETS, preset

PAPER = [name for name in PRESETS if name.startswith("paper")]


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_knows_its_name_and_comes_out_equal_every_time(name: str):
    assert preset(name).preset == name
    assert config_hash(preset(name)) == config_hash(preset(name))


def test_no_two_presets_are_the_same_configuration():
    assert len({config_hash(preset(name)) for name in PRESETS}) == len(PRESETS)


@pytest.mark.parametrize("name", PAPER)
def test_the_papers_presets_have_the_supplements_numbers(name: str):
    config = preset(name)
    one, two = config.stage_one, config.stage_two
    assert (one.num_rays, one.num_steps, one.warmup_steps) == (16_384, 100_000, 10_000)
    assert (one.rates.grid, one.rates.network, one.final_rate) == (0.01, 0.01, 0.1)
    assert two.num_rays == 1024
    assert two.num_steps == {"tensoir": 40_000, "openillumination": 100_000, "glossy": 20_000}[name[6:]]
    assert (two.fast_rates.grid, two.material_rates.grid) == (1.5625e-4, 3.125e-5)
    assert (two.estimator.fast.total, two.estimator.exact.total, two.points_per_ray) == (64, 16, 1)
    counts = config.model.nerf.primary_counts
    assert (counts.first, counts.second, counts.final) == (64, 64, 32)
    assert config.model.fast.num_samples == 8
    assert config.evaluation.num_repeats == 32


@pytest.mark.parametrize("name", PAPER)
def test_the_papers_presets_leave_our_departures_off(name: str):
    config = preset(name)
    assert config.stage_one.carving_share == 0.0
    assert config.stage_one.specular_from == 0.0
    assert config.stage_two.warmup_steps == 0
    assert config.stage_two.grey_weight == 0.0
    assert config.model.nerf.density.softplus_beta is None
    assert not config.stage_two.estimator.stratified


def test_an_unknown_preset_is_answered_with_the_known_ones():
    with pytest.raises(ConfigError, match="tiny, fast"):
        preset("quick")
