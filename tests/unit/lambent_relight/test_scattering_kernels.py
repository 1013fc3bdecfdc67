"""The compiled loop over directions follows the formulas of the reflection model and of the light sampler."""

import numpy as np
import pytest
from lambent_core.directions import dot, normalise
from lambent_relight.brdf import (
    brdf_cos,
    cosine_pdf,
    cosine_sample,
    ggx_pdf,
    ggx_sample,
    half_vector,
    materials_from_roughness,
)
from lambent_relight.environment.light_sampling import COSINE_LOBE, LightSampler, lobe_of_alpha
from lambent_relight.environment.maps import environment_from_array
from lambent_relight.refined.scattering import SurfacePoints, draw_directions, strategy_shares

PER_POINT = 64


@pytest.fixture(scope="module")
def sampler():
    image = np.random.default_rng(1).random((32, 64, 3)) ** 8
    return LightSampler(environment_from_array(image).rotated(50.0))


@pytest.fixture(scope="module")
def points():
    rng = np.random.default_rng(2)
    normal, omega_o = (normalise(rng.normal(size=(200, 3))) for _ in range(2))
    normal[:4] = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 1, 0]]
    materials = materials_from_roughness(*(rng.random((200, width)) for width in (3, 1, 1)))
    return SurfacePoints(rng.normal(size=(200, 3)), normal, omega_o, materials)


def mirror(points):
    return 2.0 * dot(points.normal, points.omega_o) * points.normal - points.omega_o


def test_every_strategy_draws_as_its_own_function(sampler, points):
    u = np.random.default_rng(3).random((200, 3))
    alpha = points.materials.alpha
    expected = (
        sampler.sample(u[:, 1], u[:, 2], points.normal, COSINE_LOBE),
        cosine_sample(u[:, 1], u[:, 2], points.normal),
        ggx_sample(u[:, 1], u[:, 2], points.omega_o, points.normal, alpha),
        sampler.sample(u[:, 1], u[:, 2], mirror(points), lobe_of_alpha(alpha)),
    )
    for strategy, wanted in enumerate(expected):
        shares = np.tile(np.eye(4)[strategy], (200, 1))
        found = draw_directions(points, sampler, u, shares)
        np.testing.assert_allclose(found.omega_i, wanted, atol=2e-6)


def test_weights_and_densities_are_those_of_the_formulas(sampler, points):
    u = np.random.default_rng(4).random((200 * PER_POINT, 3))
    shares = strategy_shares(points, sampler)
    found = draw_directions(points, sampler, u, shares)
    rays = points[np.repeat(np.arange(200), PER_POINT)]
    omega_i, alpha = found.omega_i.astype(np.float64), rays.materials.alpha
    terms = (
        sampler.pdf(omega_i, rays.normal, COSINE_LOBE),
        cosine_pdf(omega_i, rays.normal),
        ggx_pdf(half_vector(rays.omega_o, omega_i, rays.normal), alpha),
        sampler.pdf(omega_i, mirror(rays), lobe_of_alpha(alpha)),
    )
    pdf = sum(np.repeat(shares[:, [k]], PER_POINT, axis=0) * term for k, term in enumerate(terms))
    above = np.einsum("ni,ni->n", rays.normal, omega_i) > 1e-3
    assert 0.5 < above.mean() < 0.95
    assert set(np.flatnonzero(above)) <= set(found.active)
    # Directions are rounded to single precision: one may fall into the next pixel, and lobes of a tenth
    # of a degree feel it.
    close = np.isclose(found.pdf_solid_angle, pdf, rtol=1e-3)[:, 0]
    wide = alpha[:, 0] > 0.003
    assert close[above & wide].mean() > 0.9995
    assert close[above].mean() > 0.998
    for lobe, wanted in zip(
        (found.diffuse, found.specular),
        brdf_cos(rays.omega_o, omega_i, rays.normal, rays.materials),
        strict=True,
    ):
        chosen = above & close
        np.testing.assert_allclose(lobe[chosen], (wanted / pdf)[chosen], rtol=5e-3, atol=1e-6)
    below = np.setdiff1d(np.arange(len(u)), found.active)
    assert not found.weight[below].any()
    assert not found.pdf_solid_angle[below].any()


def surface(albedo: float, metalness: float, elevation_deg: float) -> SurfacePoints:
    """Return one rather smooth horizontal point that is seen from `elevation_deg` above it."""
    angle = np.radians(elevation_deg)
    omega_o = np.array([[np.cos(angle), 0.0, np.sin(angle)]])
    materials = materials_from_roughness(
        np.full((1, 3), albedo), np.full((1, 1), 0.4), np.full((1, 1), metalness)
    )
    return SurfacePoints(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), omega_o, materials)


def specular_share(points: SurfacePoints, light: LightSampler) -> float:
    shares = strategy_shares(points, light)
    np.testing.assert_allclose(shares.sum(axis=-1), 1.0, rtol=1e-6)
    return float(shares[0, 2:].sum())


def test_directions_go_to_the_lobe_that_reflects_more_of_the_light():
    even = LightSampler(environment_from_array(np.ones((32, 64, 3))))
    # A sun opposite the viewer, 30 degrees above the horizon: its mirror image fills the lobe.
    image = np.full((32, 64, 3), 0.1)
    image[9:12, [0, 1, 62, 63]] = 100.0
    low = LightSampler(environment_from_array(image))
    matte = surface(0.5, 0.0, 30.0)
    plain = specular_share(matte, even)
    assert 0.1 <= plain < 0.25
    assert specular_share(matte, low) > 2.0 * plain
    assert specular_share(surface(0.5, 0.0, 3.0), even) > 2.0 * plain
    assert specular_share(surface(0.9, 1.0, 30.0), even) == pytest.approx(0.95)
    # Seen from below, the specular lobe reflects nothing.
    assert specular_share(surface(0.5, 0.0, -30.0), even) == pytest.approx(0.1)
    assert specular_share(surface(0.0, 1.0, 90.0), even) == pytest.approx(0.1)
