"""The light of baked relighting: turned, and split."""

import numpy as np
import pytest
from lambent_relight import environment_from_array
from lambent_relight.baked.light import coarse_bounce, lit_texels, prepare_light, texel_irradiance
from lambent_relight.baked.mesh import AtlasMesh
from lambent_relight.baked.scene import baked_scene
from lambent_relight.baked.transport import Transport
from lambent_relight.environment import harmonics


def open_scene(count=40):
    """Return texels with nothing around them, facing everywhere."""
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    direct = (harmonics.basis(normal, 7) * harmonics.cosine_factors(7)).T.astype(np.float32)
    visibility = np.zeros((16, count), np.float32)
    visibility[0] = np.sqrt(4.0 * np.pi)
    material = np.concatenate([np.full((3, count), 0.5), np.full((2, count), 0.5), normal.T]).astype(
        np.float32
    )
    # Two rows of 20 texels: ten coarse ones.
    index, size, num_coarse = np.arange(count, dtype=np.int32), 20, 10
    transport = Transport(
        size,
        index,
        direct,
        visibility,
        rng.normal(0.0, 0.1, (9, 3, num_coarse)).astype(np.float32),
        np.full((count, 32), 255, np.uint8),
        material,
    )
    mesh = AtlasMesh(
        np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.int32), np.zeros((3, 2), np.float32)
    )
    return baked_scene(mesh, transport)


def sky(seed=0):
    return environment_from_array(np.random.default_rng(seed).uniform(0.1, 1.0, (32, 64, 3)))


def test_turning_a_prepared_light_is_preparing_the_turned_light():
    first = prepare_light(sky(), 7, 0).rotated(75.0)
    second = prepare_light(sky().rotated(75.0), 7, 0)
    np.testing.assert_allclose(first.coefficients, second.coefficients, atol=1e-5)
    directions = np.random.default_rng(1).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rough = np.linspace(0.0, 1.0, 50)
    np.testing.assert_allclose(
        first.prefiltered.lookup(directions, rough), second.prefiltered.lookup(directions, rough), atol=1e-5
    )


def test_constant_light_gives_pi_everywhere():
    lit = lit_texels(open_scene())
    light = prepare_light(environment_from_array(np.ones((16, 32, 3))), 7, 4)
    assert len(light.directions) == 0
    np.testing.assert_allclose(texel_irradiance(lit, light, 7), np.pi, rtol=1e-4)
    np.testing.assert_allclose(texel_irradiance(lit, light, 3), np.pi, rtol=1e-4)


def test_irradiance_is_linear_in_the_light():
    lit = lit_texels(open_scene())
    a, b = sky(1), sky(2)
    both = environment_from_array(0.3 * a.radiance + 2.0 * b.radiance)
    lights = [prepare_light(environment, 7, 0) for environment in (a, b, both)]
    for function in (lambda light: texel_irradiance(lit, light, 7), lambda light: coarse_bounce(lit, light)):
        one, other, mixed = (function(light) for light in lights)
        np.testing.assert_allclose(mixed, 0.3 * one + 2.0 * other, atol=1e-5 * np.abs(mixed).max())


def test_a_sun_split_off_an_open_surface_gives_the_irradiance_of_its_cosine():
    radiance = np.full((64, 128, 3), 0.2)
    radiance[20:22, 40:42] = 500.0
    environment = environment_from_array(radiance)
    scene = open_scene()
    lit = lit_texels(scene)
    split = prepare_light(environment, 7, 4)
    assert len(split.directions) == 1
    cosine = np.maximum(scene.normal @ split.directions[0], 0.0)[:, None]
    expected = cosine * split.irradiance[0] + 0.2 * np.pi
    np.testing.assert_allclose(texel_irradiance(lit, split, 7), expected, rtol=0.02, atol=0.02)
    # Harmonics alone ring, but hold the same energy.
    smooth = texel_irradiance(lit, prepare_light(environment, 7, 0), 7)
    assert smooth.mean() == pytest.approx(expected.mean(), rel=0.05)


def test_bounced_light_has_the_sun_in_it_and_leaves_the_prepared_light_as_it_was():
    radiance = np.full((64, 128, 3), 0.2)
    radiance[20:22, 40:42] = 500.0
    environment, lit = environment_from_array(radiance), lit_texels(open_scene())
    split, whole = prepare_light(environment, 7, 4), prepare_light(environment, 7, 0)
    for _ in range(2):
        bounced = coarse_bounce(lit, split)
        np.testing.assert_allclose(bounced, coarse_bounce(lit, whole), rtol=0.02, atol=0.05)


def test_some_texels_are_lit_as_they_are_among_all():
    scene = open_scene()
    chosen = np.array([3, 7, 20, 39])
    light = prepare_light(sky(3), 7, 0)
    some, every = lit_texels(scene, chosen), lit_texels(scene)
    np.testing.assert_allclose(
        texel_irradiance(some, light, 7), texel_irradiance(every, light, 7)[chosen], rtol=1e-5, atol=1e-5
    )
    np.testing.assert_allclose(
        coarse_bounce(some, light)[some.coarse],
        coarse_bounce(every, light)[every.coarse][chosen],
        rtol=1e-5,
        atol=1e-6,
    )
