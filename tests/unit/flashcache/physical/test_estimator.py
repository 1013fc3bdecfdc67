"""The rays on which an estimate calls the caches, and what it hands to the losses."""

import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.physical.brdf import Materials
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig, control_variate
from flashcache.physical.incident import (
    Incident,
    LightSources,
    RayLimits,
    SecondaryRays,
    visibility_only,
)
from flashcache.physical.light_sampler import VmfMixture
from flashcache.physical.sampling import CosineLobe
from support.shading import (
    LIMITS,
    blurred,
    case,
    environment,
    nerf,
    peaked_mixture,
    reflected,
    unit,
    unoccluded,
)
from support.statements import estimates
from support.statistics import assert_mean


def _counts(cosine: int, sampler: int, specular: int) -> DirectionCounts:
    return DirectionCounts(cosine=cosine, sampler=sampler, specular=specular)


class _Recorder:
    """A source that remembers how it was called."""

    def __init__(self, source) -> None:
        self.source = source
        self.calls: list[tuple[SecondaryRays, bool]] = []

    def __call__(self, rays: SecondaryRays) -> Incident:
        self.calls.append((rays, torch.is_grad_enabled()))
        return self.source(rays)


def _ask(given, config: EstimatorConfig, fast_source=blurred):
    near, quick = _Recorder(nerf), _Recorder(fast_source)
    sky: list[torch.Tensor] = []

    def light(directions, light_index):
        sky.append(directions)
        return environment(directions)

    result = control_variate(
        given.points,
        given.materials,
        LightSources(near, light, LIMITS, quick),
        mixture=peaked_mixture(given.rows, unit(0.5, -0.1, 0.8)),
        config=config,
        generator=torch.Generator().manual_seed(1),
    )
    return result, near.calls, quick.calls, sky


def test_the_paper_divides_directions_into_half_specular_and_two_quarters():
    assert DirectionCounts.split(64) == _counts(16, 16, 32)
    assert DirectionCounts.split(16).total == 16
    with pytest.raises(ConfigError, match="multiple of 4"):
        DirectionCounts.split(18)


@pytest.mark.parametrize(
    "settings",
    [
        {"exact": _counts(1, 1, 0)},
        {"fast": _counts(0, 0, 4)},
        {"control_variate": "fast_only", "fast": _counts(0, 0, 0)},
    ],
)
def test_settings_that_make_no_estimate_are_refused(settings):
    with pytest.raises(ConfigError):
        EstimatorConfig(**settings)


@pytest.mark.parametrize("settings", [{"control_variate": "maybe"}, {"sampler": "mirror"}])
def test_unknown_modes_are_refused(settings):
    # A TypeError comes from the annotations, which only tests check.
    with pytest.raises((ConfigError, TypeError)):
        EstimatorConfig(**settings)


def test_negative_counts_and_empty_ray_ranges_are_refused():
    with pytest.raises(ConfigError):
        _counts(-1, 2, 2)
    with pytest.raises(ConfigError, match="near"):
        RayLimits(near=2.0, far=0.5)


def test_without_fast_directions_a_silent_fast_cache_leaves_the_nerf_estimate_bit_for_bit():
    given = case(300)

    def silent(rays):
        return Incident(
            torch.zeros_like(rays.origins), torch.ones_like(rays.origins[:, 0]), rays.origins[:, 0]
        )

    alone = estimates(given, control_variate="off", seed=4)
    both = estimates(given, control_variate="on", fast=_counts(0, 0, 0), cache=silent, seed=4)
    for part in ("rgb", "diffuse", "specular", "irradiance"):
        assert torch.equal(getattr(alone, part), getattr(both, part))


def test_the_correction_asks_both_caches_about_the_same_rays_and_the_environment_once():
    config = EstimatorConfig(fast=_counts(8, 6, 2), exact=_counts(2, 1, 1))
    result, exact, fast, sky = _ask(case(40), config)
    ((nerf_rays, nerf_graph),) = exact
    (second, second_graph), (first, first_graph) = fast
    assert torch.equal(nerf_rays.origins, first.origins)
    assert torch.equal(nerf_rays.directions, first.directions)
    assert (nerf_graph, first_graph, second_graph) == (False, True, False)
    assert len(sky) == 1
    assert len(sky[0]) == len(first) + len(second)
    assert result.exact is not None
    assert len(result.exact.rays) == len(first)


def test_without_gradients_the_fast_cache_is_asked_once():
    with torch.no_grad():
        _, exact, fast, sky = _ask(case(40), EstimatorConfig())
    assert [len(calls) for calls in (exact, fast, sky)] == [1, 1, 1]


def test_gradients_through_the_caches_are_scaled_and_zero_by_default():
    given = case(50)
    reached = []
    for factor in (0.0, 0.25, 1.0):
        gain = torch.ones((), dtype=torch.float64, requires_grad=True)

        def louder(rays, gain=gain):
            answer = blurred(rays)
            return Incident(gain * answer.near_radiance, answer.opacity, answer.distance)

        result, *_ = _ask(given, EstimatorConfig(through_cache=factor), louder)
        (result.rgb.sum() + 0.0 * gain).backward()
        reached.append(float(gain.grad))
    assert reached[0] == 0.0
    assert reached[2] != 0.0
    assert reached[1] == pytest.approx(0.25 * reached[2])


@pytest.mark.parametrize("supervise", [False, True])
def test_the_fast_cache_alone_learns_from_exact_rays_that_do_not_count(supervise):
    given, config = case(40), EstimatorConfig(control_variate="fast_only")
    near, quick = _Recorder(nerf), _Recorder(blurred)

    def bright(rays):
        answer = near(rays)
        return Incident(1e3 + answer.near_radiance, answer.opacity, answer.distance)

    result = control_variate(
        given.points,
        given.materials,
        LightSources(bright, environment, LIMITS, quick),
        mixture=peaked_mixture(given.rows, unit(0.5, -0.1, 0.8)),
        config=config,
        generator=torch.Generator().manual_seed(1),
        supervise=supervise,
    )
    assert len(near.calls) == int(supervise)
    assert (result.exact is not None) == supervise
    assert result.rgb.max() < 20.0
    if result.exact is not None:
        # The graph of the exact rays is for the fast cache's own loss.
        assert [graph for _, graph in quick.calls] == [False, True]
        assert result.exact.radiance.max() > 500.0


def test_exact_rays_know_their_half():
    result, *_ = _ask(case(30, alpha=1.0), EstimatorConfig(exact=_counts(3, 2, 4)))
    found = result.exact
    expected = (torch.arange(9) < 5).expand(30, 9)[found.above]
    assert torch.equal(found.from_diffuse, expected)
    assert len(found.from_diffuse) == len(found.rays)


def test_only_rays_above_the_surface_are_traced():
    given = case(200, alpha=1.0)
    result, exact, fast, _ = _ask(given, EstimatorConfig())
    for rays, _ in exact + fast:
        assert ((rays.directions * given.points.normal[0]).sum(dim=-1) > 0.0).all()
    assert len(exact[0][0]) == int(result.exact.above.sum())
    assert not result.exact.above.all()


def test_rays_start_above_the_surface_inside_the_limits_of_the_scene():
    given = case(10)
    _, exact, _, _ = _ask(given, EstimatorConfig())
    rays = exact[0][0]
    expected = given.points.positions[0] + 0.01 * given.points.normal[0]
    torch.testing.assert_close(rays.origins, expected.expand_as(rays.origins))
    assert (rays.near, rays.far) == (0.05, 2.0)


def test_exact_directions_know_their_radiance_point_and_half():
    given = case(30)
    result, exact, _, _ = _ask(given, EstimatorConfig(exact=_counts(3, 2, 4)))
    found = result.exact
    assert found.omega_i.shape == (30, 9, 3)
    assert found.num_diffuse == 5
    rays = exact[0][0]
    torch.testing.assert_close(found.omega_i[found.above], rays.directions)
    answer = nerf(rays)
    radiance = answer.near_radiance + (1.0 - answer.opacity)[:, None] * environment(rays.directions)
    torch.testing.assert_close(found.radiance[found.above], radiance)
    assert found.radiance[~found.above].abs().max() == 0.0
    expected = torch.arange(30)[:, None].expand(30, 9)[found.above]
    assert torch.equal(found.point_index, expected)
    torch.testing.assert_close(
        found.pdf_solid_angle[:, :3],
        CosineLobe(given.points.normal).pdf(found.omega_i[:, :3]).clamp_min(1e-5),
    )


def test_every_point_is_lit_by_its_own_light():
    def own_light(directions, light):
        return light[:, None].double().expand(-1, 3)

    given = case(6)
    points = given.points._replace(light_index=torch.tensor([0, 1, 2, 2, 1, 0]))
    result = control_variate(
        points,
        given.materials,
        LightSources(unoccluded, own_light, LIMITS, unoccluded),
        mixture=None,
        config=EstimatorConfig(sampler="none"),
        generator=torch.Generator().manual_seed(1),
    )
    expected = points.light_index[:, None].double().expand(-1, 3)
    torch.testing.assert_close(result.irradiance, expected)


def test_the_gradient_by_the_normal_is_scaled():
    gradients = []
    for factor in (1.0, 0.01, 0.0):
        given = case(20)
        normal = given.points.normal.clone().requires_grad_()
        points = given.points._replace(normal=normal)
        result = estimates(type(given)(points, given.materials), gradients=factor)
        (result.rgb.sum() + 0.0 * normal.sum()).backward()
        gradients.append(normal.grad)
    torch.testing.assert_close(gradients[1], 0.01 * gradients[0])
    assert gradients[2].abs().max() == 0.0


def test_contributions_that_are_not_numbers_or_too_large_are_kept_out():
    given = case(10)

    def broken(rays):
        radiance = torch.ones_like(rays.origins)
        radiance[0] = torch.nan
        radiance[-1] = 1e30
        zero = torch.zeros_like(radiance[:, 0])
        return Incident(radiance, zero, zero)

    result = control_variate(
        given.points,
        given.materials,
        LightSources(broken, lambda directions, _: torch.zeros_like(directions), LIMITS, broken),
        mixture=None,
        config=EstimatorConfig(control_variate="off", sampler="none"),
        generator=torch.Generator().manual_seed(1),
    )
    assert torch.isfinite(result.rgb).all()


def test_estimates_are_made_on_the_device_of_the_points(device):
    given = case(2000)
    points = type(given.points)(*(values.to(device) for values in given.points))
    materials = Materials(*(values.to(device) for values in vars(given.materials).values()))
    mixture = peaked_mixture(given.rows, unit(0.5, -0.1, 0.8))
    found = control_variate(
        points,
        materials,
        LightSources(nerf, environment, LIMITS, blurred),
        mixture=VmfMixture(*(values.to(device) for values in vars(mixture).values())),
        config=EstimatorConfig(fast=_counts(2, 2, 4), exact=_counts(1, 1, 2), stratified=True),
        generator=torch.Generator(device).manual_seed(5),
        with_variance=True,
    )
    assert found.rgb.device.type == device.type
    assert_mean(found.rgb, reflected(given)["rgb"], expected_error=1e-5)


def test_no_points_give_an_empty_estimate():
    result, *_ = _ask(case(0), EstimatorConfig())
    assert result.rgb.shape == (0, 3)
    assert result.exact.omega_i.shape == (0, 16, 3)


def test_hiding_a_source_leaves_direct_light_with_shadows():
    rays = SecondaryRays(
        torch.zeros(4, 3).double(), unit(1.0, 0.0, 0.2).expand(4, 3), 0.05, 2.0, torch.zeros(4).long()
    )
    answer = visibility_only(nerf)(rays)
    assert answer.near_radiance.abs().max() == 0.0
    assert torch.equal(answer.opacity, nerf(rays).opacity)


def test_the_quadrature_of_the_tests_is_fine_enough():
    coarse = reflected(case(1, alpha=0.1))
    fine = reflected(case(1, alpha=0.1), num_polar=300, num_azimuth=600)
    for part, value in fine.items():
        torch.testing.assert_close(coarse[part], value, rtol=0.0, atol=1e-6)
