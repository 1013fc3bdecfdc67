"""Pictures between their pixels."""

import numpy as np
import pytest
from lambent_relight.baked.texture_lookup import bilinear, cubic
from support.texture_lookup import sample_plane


def test_bilinear_is_what_a_viewer_looks_up():
    generator = np.random.default_rng(3)
    plane = generator.random((7, 11, 3), np.float32)
    uv = generator.uniform(-0.1, 1.1, (500, 2)).astype(np.float32)
    np.testing.assert_allclose(bilinear(plane, uv), sample_plane(plane, uv), atol=1e-5)


def test_cubic_passes_through_the_pixels():
    picture = np.random.default_rng(4).random((6, 5, 2), np.float32)
    row, column = np.divmod(np.arange(30), 5)
    places = np.stack([column, row], axis=-1) + 0.5
    np.testing.assert_allclose(cubic(picture, places), picture.reshape(-1, 2), atol=1e-6)


@pytest.mark.parametrize("function", ["plane", "square"])
def test_cubic_keeps_polynomials_up_to_the_second_degree(function):
    y, x = np.mgrid[0:9, 0:9].astype(np.float32) + 0.5
    places = np.random.default_rng(5).uniform(2.0, 7.0, (100, 2)).astype(np.float32)

    def value(x, y):
        return 0.3 * x - 0.2 * y + 1.0 if function == "plane" else 0.1 * x * x - 0.05 * x * y + 0.02 * y * y

    found = cubic(value(x, y)[..., None], places)[:, 0]
    np.testing.assert_allclose(found, value(*places.T), rtol=1e-4, atol=1e-4)


def test_cubic_keeps_more_of_fine_detail_than_straight_lines():
    wave = np.cos(2.0 * np.pi * 0.25 * (np.arange(64) + 0.5)).astype(np.float32)
    picture = np.broadcast_to(wave[None, :, None], (4, 64, 1))
    x = np.linspace(8.0, 56.0, 961, dtype=np.float32)
    places = np.stack([x, np.full_like(x, 2.0)], axis=-1)
    truth = np.cos(2.0 * np.pi * 0.25 * x)
    sharp = np.abs(cubic(picture, places)[:, 0] - truth).mean()
    assert sharp < 0.8 * np.abs(bilinear(picture, places / [64.0, 4.0])[:, 0] - truth).mean()
