"""Pictures with several rays per pixel are means over the pixel's area, and know their noise."""

import numpy as np
import pytest
from flashcache.config import with_overrides
from flashcache.errors import ConfigError
from flashcache.evaluation.gbuffer import GBuffer, render_gbuffer
from flashcache.evaluation.supersampling import (
    Picture,
    PictureSamples,
    finer,
    mean_gbuffer,
    mean_picture,
    points_per_ray,
)
from flashcache.evaluation.views import render_physical, render_relit, render_surface
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from support.lit_sphere import camera
from support.sphere_model import sphere_model

CAMERA = camera(0.4, 0.3, side=12)
SKY = np.ones((8, 16, 3), np.float32)


@pytest.fixture(scope="module")
def model() -> InverseModel:
    return sphere_model().requires_grad_(False)


def flat(value: float, channels: int = 1) -> np.ndarray:
    return np.full((2, 2, channels), value, np.float32)


def test_a_pixel_averages_what_its_rays_composite():
    opacity = np.float32([[[1.0], [0.5]], [[0.0], [0.5]]])
    rgb = np.float32([[[4.0] * 3, [2.0] * 3], [[9.0] * 3, [6.0] * 3]])
    found = mean_picture(Picture(rgb, flat(0.3, 3), opacity), 2)
    assert found.opacity.item() == pytest.approx(0.5)
    # (4 + 1 + 0 + 3) / 4 over an opacity of 0.5; the empty ray's colour does not count.
    np.testing.assert_allclose(found.rgb, 4.0)
    # Independent errors of 0.3, 0.15, 0 and 0.15 over a sum of opacities of 2.
    np.testing.assert_allclose(found.standard_error, np.sqrt(0.3**2 + 2 * 0.15**2) / 2.0, rtol=1e-6)


def test_surfaces_are_averaged_by_opacity_and_empty_pixels_face_up():
    opacity = np.float32([[[1.0], [0.5], [0.0], [0.0]], [[0.0], [0.5], [0.0], [0.0]]])
    normal = np.zeros((2, 4, 3), np.float32)
    normal[:, 0, 0] = 1.0
    normal[:, 1, 1] = 1.0
    albedo = np.float32([0.8, 0.2, 0.5, 0.5])[None, :, None].repeat(2, axis=0).repeat(3, axis=2)
    ones = np.ones((2, 4, 1), np.float32)
    buffer = GBuffer(CAMERA, opacity, 3 * ones, normal, albedo, 0.4 * ones, ones, 0.1 * albedo)
    found = mean_gbuffer(buffer, CAMERA, 2)
    np.testing.assert_allclose(found.opacity[0, :, 0], [0.5, 0.0])
    half = np.sqrt(0.5)
    np.testing.assert_allclose(found.normal[0], [[half, half, 0.0], [0.0, 0.0, 1.0]], atol=1e-6)
    np.testing.assert_allclose(found.albedo[0, 0], 0.5)
    np.testing.assert_allclose(found.distance[0, :, 0], [3.0, 0.0])
    np.testing.assert_allclose(found.perceptual_roughness[0, 0], 0.4)
    np.testing.assert_allclose(found.cache_rgb[0, 0], 0.05)  # Premultiplied as it is, so a plain mean.


def test_the_rays_of_a_pixel_surround_its_centre():
    fine = finer(CAMERA, 3)
    assert (fine.width, fine.height) == (36, 36)
    # Ray (1, 1) of pixel (r, c) goes through the same point of the image as the pixel's own ray.
    row, column = 4, 7
    assert (3 * column + 1.5 - fine.centre_x) / fine.focal_x == pytest.approx(
        (column + 0.5 - CAMERA.centre_x) / CAMERA.focal_x
    )
    assert (3 * row + 1.5 - fine.centre_y) / fine.focal_y == pytest.approx(
        (row + 0.5 - CAMERA.centre_y) / CAMERA.focal_y
    )


def test_an_outline_is_closer_to_the_area_it_covers(model):
    exact = render_surface(model, CAMERA, antialias=8).opacity
    error = [np.abs(render_surface(model, CAMERA, antialias=n).opacity - exact).mean() for n in (1, 2, 4)]
    assert error[0] > 1.5 * error[1] > 2.0 * error[2]


def test_one_ray_per_pixel_is_the_picture_without_supersampling(model):
    plain, same = render_gbuffer(model, CAMERA), render_surface(model, CAMERA)
    assert np.array_equal(plain.albedo, same.albedo)
    assert np.array_equal(plain.normal, same.normal)


@pytest.mark.parametrize(("render", "light"), [(render_physical, []), (render_relit, [SKY])])
def test_pictures_keep_their_size_and_their_mean(model, render, light):
    coarse, fine = (render(model, CAMERA, *light, PictureSamples(num_repeats=4, antialias=n)) for n in (1, 2))
    assert coarse.rgb.shape == fine.rgb.shape == (CAMERA.height, CAMERA.width, 3)
    inside = np.minimum(coarse.opacity, fine.opacity)[..., 0] > 0.99
    noise = np.hypot(coarse.standard_error[inside], fine.standard_error[inside])
    assert abs((coarse.rgb - fine.rgb)[inside].mean()) < 5.0 * np.sqrt((noise**2).mean() / noise.size) + 2e-3


def test_secondary_rays_are_counted_per_pixel(model, monkeypatch):
    asked = []
    fast = model.fast_source()

    def counting():
        return lambda rays: asked.append(len(rays)) or fast(rays)

    monkeypatch.setattr(model, "fast_source", counting)
    spent = []
    for antialias in (1, 2):
        asked.clear()
        opacity = render_relit(model, CAMERA, SKY, PictureSamples(antialias=antialias)).opacity
        # Rays below the horizon are not asked, so that about half of the 64 per covered pixel are.
        spent.append(sum(asked) / opacity.sum())
    assert spent[1] == pytest.approx(spent[0], rel=0.2)


def test_every_ray_shades_two_points_at_least():
    assert [points_per_ray(antialias) for antialias in (1, 2, 3, 8)] == [4, 2, 2, 2]


def test_a_pixel_without_a_ray_is_refused_before_anything_is_trained():
    with pytest.raises(ConfigError, match="antialias"):
        finer(CAMERA, 0)
    with pytest.raises(ConfigError, match="antialias"):
        with_overrides(tiny(), {"evaluation.antialias": "0"})
