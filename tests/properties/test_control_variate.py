"""Estimates of reflected light agree with quadrature, with and without control variate."""

import pytest
import torch
from flashcache.geometry.directions import environment_directions, uv_from_direction
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig, estimate, relight
from flashcache.physical.incident import Incident, LightSources
from flashcache.physical.sampling import CosineLobe, EnvironmentMapSampler, GgxLobe
from support.shading import LIMITS, case, nerf, peaked_mixture, reflected, unit
from support.statements import (
    QUADRATURE,
    assert_estimates_agree_with_quadrature,
    assert_gradients_agree_with_quadrature,
    estimates,
)
from support.statistics import assert_mean

ROWS = 20000


def _counts(cosine: int, sampler: int, specular: int) -> DirectionCounts:
    return DirectionCounts(cosine=cosine, sampler=sampler, specular=specular)


@pytest.mark.parametrize("alpha", [0.1, 0.4, 1.0])
@pytest.mark.parametrize("sampler", ["vmf", "none"])
def test_estimates_by_the_nerf_cache_alone_agree_with_quadrature(alpha, sampler):
    given = case(ROWS, alpha=alpha)
    assert_estimates_agree_with_quadrature(given, control_variate="off", sampler=sampler)


@pytest.mark.parametrize("sampler", ["vmf", "none"])
def test_the_control_variate_is_unbiased_with_a_good_fast_cache(sampler):
    assert_estimates_agree_with_quadrature(case(ROWS), sampler=sampler)


def test_the_control_variate_is_unbiased_however_wrong_the_fast_cache_is():
    noise = torch.Generator().manual_seed(99)

    def nonsense(rays):
        radiance = 3.0 * torch.rand(len(rays), 3, generator=noise, dtype=torch.float64)
        opacity = torch.rand(len(rays), generator=noise, dtype=torch.float64)
        return Incident(radiance, opacity, opacity)

    assert_estimates_agree_with_quadrature(case(2 * ROWS), cache=nonsense)


def test_the_control_variate_is_unbiased_when_the_two_sums_divide_their_directions_differently():
    given = case(ROWS)
    assert_estimates_agree_with_quadrature(given, fast=_counts(5, 2, 3), exact=_counts(1, 2, 1))


def test_stratified_variates_leave_estimates_unbiased_and_make_them_quieter():
    given = case(ROWS)
    settings = {"fast": _counts(8, 6, 4), "exact": _counts(2, 1, 1)}
    assert_estimates_agree_with_quadrature(given, stratified=True, **settings)
    spread = [
        float(estimates(given, stratified=flag, **settings).rgb.std(dim=0).mean()) for flag in (False, True)
    ]
    assert spread[1] < 0.8 * spread[0]


def test_a_good_fast_cache_makes_estimates_quieter_than_the_nerf_cache_alone():
    given = case(2000)
    alone = estimates(given, control_variate="off", exact=DirectionCounts.split(16))
    both = estimates(given, fast=DirectionCounts.split(64), exact=DirectionCounts.split(16))
    assert float(both.rgb.std(dim=0).mean()) < 0.65 * float(alone.rgb.std(dim=0).mean())


def test_the_light_sampler_makes_irradiance_quieter_at_equal_cost_under_a_peaked_light():
    axis = unit(0.5, -0.1, 0.8)

    def lamp(directions, light_index):
        return 20.0 * torch.exp(20.0 * (directions @ axis - 1.0))[:, None].expand(-1, 3)

    given = case(4000)
    expected = reflected(given, light=lamp)["irradiance"]
    spread = {}
    for sampler in ("vmf", "none"):
        found = estimates(given, control_variate="off", sampler=sampler, exact=_counts(4, 4, 1), light=lamp)
        assert_mean(found.irradiance, expected, expected_error=QUADRATURE)
        spread[sampler] = float(found.irradiance.std(dim=0).mean())
    assert spread["vmf"] < 0.75 * spread["none"]


def test_detached_sampling_has_the_gradient_of_the_integral():
    assert_gradients_agree_with_quadrature(ROWS, alpha=0.4)


def test_detached_sampling_has_the_gradient_of_the_integral_without_control_variate():
    assert_gradients_agree_with_quadrature(ROWS, alpha=0.6, control_variate="off", sampler="none")


@pytest.mark.parametrize("control_variate", ["on", "off"])
def test_the_variance_that_estimates_report_is_the_one_they_have(control_variate):
    given = case(ROWS)
    generator = torch.Generator().manual_seed(12)
    settings = {"fast": _counts(4, 4, 4), "exact": _counts(2, 2, 2), "control_variate": control_variate}
    found = estimates(given, generator=generator, with_variance=True, **settings)
    deviation = found.rgb - reflected(given)["rgb"]
    assert_mean(found.variance - deviation.square(), torch.zeros(3), expected_error=QUADRATURE)
    torch.testing.assert_close(found.standard_error, found.variance.sqrt())


def _sky(height: int = 16) -> torch.Tensor:
    """Return a picture with a small sun, brighter than all the rest together."""
    directions = environment_directions(height, 2 * height, torch.float64)
    image = 0.2 + 0.1 * directions.abs()
    image[3, 12] = torch.tensor([60.0, 50.0, 40.0], dtype=torch.float64)
    return image


def _texels(image: torch.Tensor):
    height, width, _ = image.shape

    def light(directions, light_index):
        uv = uv_from_direction(directions)
        row = (uv[:, 1] * height).long().clamp(0, height - 1)
        return image[row, (uv[:, 0] * width).long().clamp(0, width - 1)]

    return light


@pytest.mark.parametrize("alpha", [0.15, 0.6])
def test_relighting_with_a_known_map_is_unbiased_and_far_quieter_than_without_its_sampler(alpha):
    given, image = case(ROWS, alpha=alpha), _sky()
    spread = {}
    for name, light in (("map", EnvironmentMapSampler(image)), ("none", None)):
        found = relight(
            given.points,
            given.materials,
            LightSources(nerf, _texels(image), LIMITS),
            light=light,
            counts=_counts(2, 4, 2),
            config=EstimatorConfig(),
            generator=torch.Generator().manual_seed(21),
        )
        # The picture has steps: a fine grid of midpoints is exact to about a thousandth of the sun.
        expected = reflected(given, light=_texels(image), num_polar=400, num_azimuth=800)
        assert_mean(found.diffuse, expected["diffuse"], expected_error=2e-3)
        assert_mean(found.specular, expected["specular"], expected_error=2e-3)
        spread[name] = float(found.rgb.std(dim=0).mean())
    assert spread["map"] < 0.7 * spread["none"]


@pytest.mark.parametrize("alpha", [0.15, 0.6])
def test_lobes_that_share_directions_have_less_noise_than_lobes_with_their_own(alpha):
    # A window, not a sun: where one pixel has most of the light, only hitting it counts.
    given, image = case(ROWS, alpha=alpha), 0.1 * torch.ones(16, 32, 3, dtype=torch.float64)
    image[2:7, 8:16] = 3.0
    light, generator = EnvironmentMapSampler(image), torch.Generator().manual_seed(4)
    sources, config = LightSources(nerf, _texels(image), LIMITS), EstimatorConfig(stratified=True)
    shared = relight(
        given.points, given.materials, sources, light=light, counts=_counts(2, 4, 2),
        config=config, generator=generator, continued=True,
    )  # fmt: skip
    cosine = CosineLobe(given.points.normal)
    lobe = GgxLobe(given.points.omega_o, given.points.normal, given.materials.alpha)
    apart = estimate(
        given.points, given.materials, sources, diffuse=[(cosine, 2), (light, 2)],
        specular=[(lobe, 2), (light, 2)], config=config, generator=generator,
    )  # fmt: skip

    def spread_of_pixels(found) -> float:
        """Return the spread of means over eight neighbours: the points of a pixel."""
        return float(found.rgb.reshape(-1, 8, 3).mean(dim=1).std(dim=0).mean())

    assert spread_of_pixels(shared) < 0.9 * spread_of_pixels(apart)


def test_any_list_of_strategies_can_serve_either_half():
    given = case(ROWS)
    cosine = CosineLobe(given.points.normal)
    lobe = GgxLobe(given.points.omega_o, given.points.normal, given.materials.alpha)
    mixture = peaked_mixture(given.rows, unit(0.2, 0.2, 0.9))
    found = estimate(
        given.points,
        given.materials,
        LightSources(nerf, lambda directions, _: directions.square(), LIMITS),
        diffuse=[(cosine, 1), (mixture, 2), (lobe, 1)],
        specular=[(lobe, 1), (cosine, 1)],
        config=EstimatorConfig(),
        generator=torch.Generator().manual_seed(17),
    )
    expected = reflected(given, light=lambda directions, _: directions.square())
    assert_mean(found.diffuse, expected["diffuse"], expected_error=QUADRATURE)
    assert_mean(found.specular, expected["specular"], expected_error=QUADRATURE)
