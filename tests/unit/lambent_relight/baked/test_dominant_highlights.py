"""Dominant lights leave the prefiltered map and come back as exact reflections in their own shadow."""

import numpy as np
import pytest
from lambent_core.directions import normalise, pixel_directions, pixel_solid_angles
from lambent_relight import environment_from_array
from lambent_relight.baked.dominant_highlights import WIDE_ALPHA, glints, lobe_scale
from lambent_relight.brdf import brdf_cos, materials_from_roughness
from lambent_relight.environment.prefilter import prefilter

COUNT = 200
SUN = normalise(np.array([[0.3, -0.5, 0.8]])).astype(np.float32)
SKY = np.array([[2.0, 1.0, 0.5]], np.float32)


def surfaces(seed: int = 0, *, roughness: tuple[float, float] = (0.45, 1.0)):
    """Return normals, directions to the viewer, mirror directions and materials."""
    rng = np.random.default_rng(seed)
    normal, omega_o = normalise(rng.normal(size=(2, COUNT, 3))).astype(np.float32)
    cosine = (normal * omega_o).sum(-1, keepdims=True)
    omega_o = np.where(cosine < 0.1, normalise(omega_o - (cosine - 0.5) * normal), omega_o)
    cosine = (normal * omega_o).sum(-1, keepdims=True)
    albedo, metalness = rng.uniform(0, 1, (COUNT, 3)), rng.uniform(0, 1, (COUNT, 1))
    rough = rng.uniform(*roughness, (COUNT, 1))
    materials = materials_from_roughness(*(part.astype(np.float32) for part in (albedo, rough, metalness)))
    return normal, omega_o.astype(np.float32), (2 * cosine * normal - omega_o).astype(np.float32), materials


def reflected(normal, omega_o, mirror, materials, share, prefiltered):
    alpha = materials.alpha[:, 0]
    f0 = materials.metalness * materials.albedo + (1 - materials.metalness) * np.float32(0.04)
    lobes = alpha, lobe_scale(alpha), f0
    return glints((normal, omega_o, mirror), lobes, (SUN, SKY, share), prefiltered)


@pytest.mark.parametrize("alpha", [0.02, 0.2, 0.6, 0.9999, 1.0])
def test_the_weight_of_the_lobe_integrates_to_one(alpha):
    cosine = (np.arange(200_000) + 0.5) / 200_000
    weight = cosine / (alpha**2 * (1 + cosine) / 2 + (1 - cosine) / 2) ** 2
    scale = float(lobe_scale(np.array([alpha]))[0])
    assert 2 * np.pi * weight.mean() * scale == pytest.approx(1.0, rel=2e-3)


def test_a_light_in_sight_is_reflected_exactly():
    normal, omega_o, mirror, materials = surfaces()
    share = np.ones((1, COUNT), np.float32)
    _, found = reflected(normal, omega_o, mirror, materials, share, np.full((COUNT, 3), 9.0, np.float32))
    omega_i = np.broadcast_to(SUN, normal.shape)
    _, wanted = brdf_cos(omega_o, omega_i, normal, materials)
    np.testing.assert_allclose(found, wanted * SKY, rtol=2e-3, atol=1e-5)
    assert (found > 0).any()


def test_a_hidden_light_is_gone_and_half_a_light_is_half():
    normal, omega_o, mirror, materials = surfaces()
    bright = np.full((COUNT, 3), 9.0, np.float32)
    parts = [
        reflected(normal, omega_o, mirror, materials, np.full((1, COUNT), part, np.float32), bright)
        for part in (0.0, 0.5, 1.0)
    ]
    assert not parts[0][1].any()
    np.testing.assert_allclose(2 * parts[1][1], parts[2][1], rtol=1e-5)
    for rest, _ in parts:
        np.testing.assert_array_equal(rest, parts[0][0])


@pytest.mark.parametrize("sky", [0.0, 1.0])
def test_what_is_taken_is_what_the_prefiltered_map_has_of_the_light(sky):
    """A light in an even sky: the sky is left."""
    height, width = 64, 128
    directions = pixel_directions(height, width)
    row, column = np.unravel_index(np.argmax(directions @ SUN[0]), (height, width))
    image = np.full((height, width, 3), sky, np.float32)
    image[row, column] += SKY[0] / pixel_solid_angles(height, width)[row]
    levels = prefilter(environment_from_array(image))
    normal, omega_o, mirror, materials = surfaces(roughness=(0.75, 0.75))
    prefiltered = levels.lookup(mirror, np.full(COUNT, 0.75))
    share = np.zeros((1, COUNT), np.float32)
    rest, _ = reflected(normal, omega_o, mirror, materials, share, prefiltered)
    light = float((prefiltered - sky).mean())
    assert light > 0.05
    assert float(np.abs(rest - sky).mean()) < 0.05 * light
    assert float(rest.min()) >= 0.0


def test_narrow_lobes_keep_the_map_as_it_is():
    normal, omega_o, mirror, materials = surfaces(roughness=(0.05, 0.2))
    assert float(materials.alpha.max()) < WIDE_ALPHA
    bright = np.full((COUNT, 3), 9.0, np.float32)
    rest, found = reflected(normal, omega_o, mirror, materials, np.ones((1, COUNT), np.float32), bright)
    np.testing.assert_array_equal(rest, bright)
    assert not found.any()
