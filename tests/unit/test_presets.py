import pytest
from flashcache.config import config_hash
from flashcache.data.space import SpaceConfig
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
    assert config.stage_one.orientation_derived == config.stage_two.orientation_derived == 0.0
    assert config.stage_two.pseudo_albedo == "radiance"
    assert config.stage_two.secondary_jitter
    assert config.stage_two.fast_by_half
    assert config.stage_two.estimator.through_cache == 1e-4
    assert config.model.nerf.normal_floor < 1e-3
    assert config.model.nerf.appearance.architecture == "fast_like"
    assert config.model.nerf.reflected == config.model.fast


@pytest.mark.parametrize("name", PAPER)
def test_the_papers_presets_leave_everything_beyond_the_paper_off(name: str):
    two = preset(name).stage_two
    metal = two.metalness_prior
    weights = (two.clusters.weight, two.distil.num_steps, metal.weight, metal.warmup_weight)
    assert set(weights) == {0.0}


def test_an_unknown_preset_is_answered_with_the_known_ones():
    with pytest.raises(ConfigError, match="tiny, fast"):
        preset("quick")


SPACES = {
    # contraction radius, primary, secondary, radius of the fast cache's loss, extent of the material grid
    "paper_tensoir": (2.0, (2.0, 6.0), (0.05, 2.0), 2.0, 1.0),
    "paper_openillumination": (1.0, (0.25, 2.0), (0.02, 0.5), 0.5, 1.0),
    "paper_glossy": (2.0, (1.0, 4.0), (0.05, 1.0), 1.0, 2.0),
}


@pytest.mark.parametrize("name", PAPER)
def test_the_papers_presets_place_their_datasets_where_the_paper_does(name: str):
    config = preset(name)
    space, grids = config.space, config.model
    found = (space.contraction_radius, space.primary, space.secondary, space.fast_radius)
    assert (*found, grids.materials.grid.half_extent) == SPACES[name]
    assert grids.fast.feature_grid.half_extent == 2.0


@pytest.mark.parametrize("name", [name for name in PRESETS if name not in PAPER])
def test_other_presets_leave_a_scene_where_its_capture_puts_it(name: str):
    assert preset(name).space == SpaceConfig()


@pytest.mark.parametrize("name", PRESETS)
def test_the_exponent_after_training_is_the_one_training_ends_with(name: str):
    config = preset(name)
    exponents = {config.model.nerf.exponent, config.stage_two.proposal_exponent}
    assert exponents == {config.stage_one.proposal_exponent}


@pytest.mark.parametrize(
    ("name", "exponent", "compact", "normals"),
    [
        ("paper_tensoir:armadillo", 0.4, 0.0, 1.0),
        ("paper_tensoir:ficus", 1.0, 0.0, 1.0),
        ("paper_tensoir:hotdog", 0.4, 0.01, 1.0),
        ("paper_tensoir:lego", 0.4, 0.01, 1.0),
        ("paper_glossy:bell", 0.4, 0.01, 0.5),
        ("paper_glossy:teapot", 0.4, 0.01, 0.125),
    ],
)
def test_published_scenes_have_settings_of_their_own(name, exponent, compact, normals):
    config = preset(name)
    assert config.model.nerf.exponent == exponent
    for stage in (config.stage_one, config.stage_two):
        assert (stage.distortion_weight, stage.orientation_weight) == (compact, compact)
        assert stage.normal_weight == normals


@pytest.mark.parametrize(("name", "known"), [("paper_tensoir:cat", "armadillo"), ("fast:lego", "none")])
def test_an_unknown_published_scene_is_answered_with_the_known_ones(name: str, known: str):
    with pytest.raises(ConfigError, match=known):
        preset(name)
