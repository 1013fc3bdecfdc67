"""The numpy reflection model."""

import numpy as np
import pytest
from lambent_core.directions import directions_of_uv, frame_axes, normalise, pixel_solid_angles
from lambent_relight import brdf
from support.statistics import assert_mean

RNG = np.random.default_rng(0)
NORMAL = normalise(np.array([[0.3, -0.5, 0.8]]))


def sphere_grid(height: int = 512, width: int = 1024) -> tuple[np.ndarray, np.ndarray]:
    """Return directions [n, 3] about NORMAL and their solid angles [n, 1]."""
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    local = directions_of_uv(u.ravel(), v.ravel())
    tangent, bitangent = frame_axes(NORMAL)
    turned = local[:, :1] * tangent + local[:, 1:2] * bitangent + local[:, 2:] * NORMAL
    return turned, np.repeat(pixel_solid_angles(height, width), width)[:, None]


def some_materials(count: int, *, alpha: float | None = None) -> brdf.Materials:
    widths = np.full((count, 1), alpha) if alpha else RNG.uniform(0.05, 1.0, (count, 1))
    return brdf.Materials(RNG.random((count, 3)), widths, RNG.random((count, 1)))


def view(cosine: float) -> np.ndarray:
    tangent, _ = frame_axes(NORMAL)
    return cosine * NORMAL + np.sqrt(1 - cosine**2) * tangent


@pytest.mark.parametrize("alpha", [0.05, 0.3, 1.0])
def test_the_half_vector_density_times_cosine_integrates_to_one(alpha):
    polar = (np.arange(100_000) + 0.5) * (np.pi / 2 / 100_000)
    density = brdf.ggx_density(np.cos(polar) ** 2, np.sin(polar) ** 2, np.array(alpha))
    ring = 2 * np.pi * np.sin(polar) * np.cos(polar) * (np.pi / 2 / 100_000)
    assert (density * ring).sum() == pytest.approx(1.0, abs=1e-6)


def test_the_stable_density_is_the_textbook_one():
    cosine, alpha = RNG.random((100, 1)), RNG.uniform(0.01, 1.0, (100, 1))
    expected = alpha**2 / (np.pi * (cosine**2 * (alpha**2 - 1.0) + 1.0) ** 2)
    np.testing.assert_allclose(brdf.ggx_density(cosine**2, 1.0 - cosine**2, alpha), expected, rtol=1e-9)


def test_reflection_is_reciprocal_once_the_cosine_is_taken_out():
    count = 200
    normal = np.broadcast_to(NORMAL, (count, 3))
    a, b = (brdf.cosine_sample(*RNG.random((2, count)), normal) for _ in range(2))
    materials = some_materials(count)
    for forward, backward in zip(
        brdf.brdf_cos(a, b, normal, materials), brdf.brdf_cos(b, a, normal, materials), strict=True
    ):
        cosine_b, cosine_a = (normal * b).sum(-1, keepdims=True), (normal * a).sum(-1, keepdims=True)
        np.testing.assert_allclose(forward / cosine_b, backward / cosine_a, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("metalness", "alpha", "diffuse", "specular"),
    [(1, 0.05, 0.0, 0.984), (1, 0.3, 0.0, 0.801), (1, 1.0, 0.0, 0.340), (0, 0.3, 1.0, 0.033)],
)
def test_white_furnace_of_a_metal_and_of_a_dielectric(metalness, alpha, diffuse, specular):
    directions, measure = sphere_grid()
    shape = directions.shape
    white = brdf.Materials(np.ones(shape), np.full_like(measure, alpha), np.full_like(measure, metalness))
    lobes = brdf.brdf_cos(
        np.broadcast_to(view(0.8), shape), directions, np.broadcast_to(NORMAL, shape), white
    )
    reflected = [(lobe * measure).sum(axis=0)[0] for lobe in lobes]
    assert reflected[0] == pytest.approx(diffuse, abs=1e-4 * diffuse)
    assert reflected[1] == pytest.approx(specular, abs=1e-3)


def test_light_from_below_the_surface_is_not_reflected():
    materials = some_materials(1)
    for lobe in brdf.brdf_cos(NORMAL, -NORMAL, NORMAL, materials):
        assert (lobe == 0.0).all()


@pytest.mark.parametrize("alpha", [0.1, 0.6])
def test_lobe_samples_follow_their_density(alpha):
    count = 20000
    normal, omega_o = np.broadcast_to(NORMAL, (count, 3)), np.broadcast_to(view(0.7), (count, 3))
    width = np.full((count, 1), alpha)
    directions = brdf.ggx_sample(*RNG.random((2, count)), omega_o, normal, width)
    grid, measure = sphere_grid()
    shape = grid.shape
    half = brdf.half_vector(np.broadcast_to(view(0.7), shape), grid, np.broadcast_to(NORMAL, shape))
    density = brdf.ggx_pdf(half, np.full((len(grid), 1), alpha))
    above = (grid @ NORMAL.T) > 0
    expected = (grid * density * above * measure).sum(axis=0)
    assert_mean(directions * ((directions @ NORMAL.T) > 0), expected, expected_error=2e-4)


def test_cosine_samples_follow_their_density():
    directions = brdf.cosine_sample(*RNG.random((2, 20000)), np.broadcast_to(NORMAL, (20000, 3)))
    assert_mean(directions, NORMAL[0] * 2.0 / 3.0)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, atol=1e-9)
    assert brdf.cosine_pdf(NORMAL, NORMAL)[0, 0] == pytest.approx(1 / np.pi)


def test_files_carry_perceptual_roughness_and_the_model_its_square():
    roughness = np.array([[0.5], [0.0], [1.0]], np.float32)
    materials = brdf.materials_from_roughness(np.ones((3, 3), np.float32), roughness, roughness)
    np.testing.assert_allclose(materials.alpha, [[0.25], [brdf.MIN_ALPHA], [1.0]])
    assert materials.alpha.dtype == np.float32


def test_single_precision_keeps_narrow_lobes():
    count = 2000
    normal = np.broadcast_to(NORMAL, (count, 3)).astype(np.float32)
    omega_o = np.broadcast_to(view(0.7), (count, 3)).astype(np.float32)
    materials = brdf.Materials(
        np.ones((count, 3), np.float32),
        np.full((count, 1), 1e-3, np.float32),
        np.ones((count, 1), np.float32),
    )
    u = RNG.random((2, count)).astype(np.float32)
    directions = brdf.ggx_sample(*u, omega_o, normal, materials.alpha)
    _, specular = brdf.brdf_cos(omega_o, directions, normal, materials)
    pdf = brdf.ggx_pdf(brdf.half_vector(omega_o, directions, normal), materials.alpha)
    np.testing.assert_allclose(specular / pdf, 1.0, rtol=0.05)
