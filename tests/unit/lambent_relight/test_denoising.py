"""Smoothing takes noise away and keeps edges, of materials and of light that is brighter than the noise."""

import json
from dataclasses import replace

import numpy as np
import pytest
from lambent_relight.picture import RelitPicture
from lambent_relight.refined.denoising import Denoiser, denoised
from support import golden_denoising

SIDE = 32


def noisy(albedo, radiance, noise: float, *, seed: int = 0) -> RelitPicture:
    """Return a picture of a plane with `albedo` and true `radiance` [side, side, 3], and what it states."""
    rng = np.random.default_rng(seed)
    rgb = (radiance + noise * rng.normal(size=radiance.shape)).astype(np.float32)
    one = np.ones((SIDE, SIDE, 1), np.float32)
    normal = np.broadcast_to(np.float32([0.0, 0.0, 1.0]), rgb.shape)
    return RelitPicture(
        rgb=rgb,
        opacity=one,
        # Measured from a few passes: right on average only.
        standard_error=(noise * np.sqrt(rng.chisquare(2, rgb.shape) / 2)).astype(np.float32),
        direct=0.75 * rgb,
        indirect=0.25 * rgb,
        diffuse=0.5 * rgb,
        specular=0.5 * rgb,
        visibility=one,
        albedo=albedo.astype(np.float32),
        normal=normal,
        perceptual_roughness=one,
        metalness=0 * one,
        distance=2 * one,
        depth=2 * one,
        coverage=one,
        num_samples=8,
    )


def halves(left: float, right: float) -> np.ndarray:
    values = np.full((SIDE, SIDE, 3), left)
    values[:, SIDE // 2 :] = right
    return values


def test_a_flat_noisy_field_becomes_flat_and_keeps_its_mean():
    flat = halves(0.5, 0.5)
    picture = noisy(flat, flat, 0.1)
    smooth = denoised(picture)
    assert smooth.rgb.std() < 0.25 * picture.rgb.std()
    assert smooth.rgb.mean() == pytest.approx(picture.rgb.mean(), abs=0.003)
    np.testing.assert_array_equal(smooth.standard_error, picture.standard_error)


TILTED = np.where(np.arange(SIDE)[None, :, None] < SIDE // 2, (0.0, 0.0, 1.0), (0.8, 0.0, 0.6))


@pytest.mark.parametrize(
    ("radiance", "noise", "materials"),
    [
        # Below the noise, the edge of a material says where to stop: 0.1 is two errors of a pixel.
        ((0.15, 0.25), 0.05, {"albedo": halves(0.3, 0.5)}),
        ((0.2, 0.3), 0.05, {"normal": np.broadcast_to(TILTED, (SIDE, SIDE, 3)).astype(np.float32)}),
        # A shadow above the noise needs none.
        ((0.1, 0.9), 0.02, {}),
    ],
    ids=["albedo", "normals", "shadow"],
)
def test_edges_stay_sharp(radiance, noise, materials):
    picture = noisy(halves(0.5, 0.5), halves(*radiance), noise)
    smooth = denoised(replace(picture, **materials))
    step = smooth.rgb[:, SIDE // 2].mean() - smooth.rgb[:, SIDE // 2 - 1].mean()
    assert step == pytest.approx(radiance[1] - radiance[0], abs=0.02)


def test_passes_still_add_up_and_pictures_without_noise_stay():
    flat = halves(0.5, 0.5)
    smooth = denoised(noisy(flat, flat, 0.1))
    np.testing.assert_allclose(smooth.direct + smooth.indirect, smooth.rgb, atol=1e-5)
    np.testing.assert_allclose(smooth.diffuse + smooth.specular, smooth.rgb, atol=1e-5)
    slope = np.linspace(0.2, 0.9, SIDE)[None, :, None] * np.ones((SIDE, 1, 3))
    quiet = noisy(flat, slope, 0.0)
    assert np.abs(denoised(quiet).rgb - quiet.rgb).max() < 0.01


def test_nothing_comes_from_pixels_that_the_object_does_not_cover():
    flat = halves(0.5, 0.5)
    picture = noisy(flat, halves(0.5, 0.0), 0.05)
    coverage = picture.coverage.copy()
    coverage[:, SIDE // 2 :] = 0.0
    smooth = denoised(replace(picture, coverage=coverage), Denoiser(albedo=1e9, normal=1e9, strength=100.0))
    assert smooth.rgb[:, SIDE // 2 - 1].mean() == pytest.approx(0.5, abs=0.03)
    np.testing.assert_array_equal(smooth.rgb[:, SIDE // 2 :], picture.rgb[:, SIDE // 2 :])


def test_the_numbers_that_other_readers_compare_with_are_reproduced():
    stored = json.loads(golden_denoising.GOLDEN.read_text(encoding="utf-8"))
    now = golden_denoising.numbers()
    for name, values in stored["out"].items():
        np.testing.assert_allclose(values, now["out"][name], rtol=2e-5, atol=1e-6, err_msg=name)
    moved = np.abs(np.subtract(stored["out"]["direct"], stored["direct"]))
    assert moved.mean() > 0.01
