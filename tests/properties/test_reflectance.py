"""Integrals of the reflectance model that must come out right for every parameter."""

import pytest
import torch
from flashcache.physical.brdf import ggx_density
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig, control_variate
from flashcache.physical.incident import Incident, LightSources, RayLimits
from support.shading import case, unit, unoccluded
from support.sphere import sphere_quadrature
from support.statistics import assert_mean

UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


def _white(directions: torch.Tensor, light_index: torch.Tensor) -> torch.Tensor:
    return torch.ones_like(directions)


@pytest.mark.parametrize("alpha", [0.05, 0.3, 1.0])
def test_projected_area_of_the_microfacets_is_one(alpha):
    directions, weight = sphere_quadrature(400, 4, lowest=0.0)
    density = ggx_density(UP, directions, torch.tensor([alpha], dtype=torch.float64)).squeeze(-1)
    assert float((density * directions[:, 2] * weight).sum()) == pytest.approx(1.0, abs=1e-5)


def _furnace(alpha: float, metalness: float, rows: int = 20000):
    omega_o = unit(0.6, 0.0, 0.8)
    given = case(rows, alpha=alpha, metalness=metalness, albedo=(1.0, 1.0, 1.0), normal=UP, omega_o=omega_o)
    counts = DirectionCounts(cosine=4, sampler=0, specular=4)
    return control_variate(
        given.points,
        given.materials,
        LightSources(unoccluded, _white, RayLimits(near=0.05, far=2.0), unoccluded),
        mixture=None,
        config=EstimatorConfig(exact=counts, control_variate="off", sampler="none"),
        generator=torch.Generator().manual_seed(5),
    )


@pytest.mark.parametrize("metalness", [0.0, 0.35, 1.0])
def test_in_a_white_furnace_the_diffuse_lobe_returns_exactly_the_dielectric_share(metalness):
    estimate = _furnace(0.3, metalness, rows=100)
    expected = torch.full((100, 3), 1.0 - metalness, dtype=torch.float64)
    torch.testing.assert_close(estimate.diffuse, expected)
    torch.testing.assert_close(estimate.irradiance, torch.ones_like(expected))


@pytest.mark.parametrize(
    ("metalness", "alpha", "returned"),
    [
        (1.0, 0.05, 0.984),
        (1.0, 0.3, 0.801),
        (1.0, 1.0, 0.340),
        (0.0, 0.05, 0.040),
        (0.0, 0.3, 0.033),
        (0.0, 1.0, 0.014),
    ],
)
def test_in_a_white_furnace_the_specular_lobe_returns_at_most_what_arrives(metalness, alpha, returned):
    estimate = _furnace(alpha, metalness)
    # The expected figures are rounded to three digits.
    assert_mean(estimate.specular[:, 0], returned, expected_error=1e-3)
    assert float(estimate.specular.mean()) < 1.0


def test_light_that_is_all_blocked_leaves_the_near_radiance():
    given = case(50, metalness=0.0, albedo=(1.0, 1.0, 1.0))

    def wall(rays):
        near = torch.full_like(rays.origins, 0.5)
        return Incident(near, torch.ones_like(near[:, 0]), torch.ones_like(near[:, 0]))

    estimate = control_variate(
        given.points,
        given.materials,
        LightSources(
            wall, lambda directions, _: 1e3 * _white(directions, _), RayLimits(near=0.05, far=2.0), wall
        ),
        mixture=None,
        config=EstimatorConfig(sampler="none"),
        generator=torch.Generator().manual_seed(5),
    )
    torch.testing.assert_close(estimate.diffuse, torch.full((50, 3), 0.5, dtype=torch.float64))
