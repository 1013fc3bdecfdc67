"""A decoded picture: parts of it in linear light, reduced, and where it clips."""

import numpy as np
import pytest
from lambent_capture.pictures.colour_space import LINEAR, SRGB
from lambent_capture.pictures.picture import Picture, box_averaged, shares

RNG = np.random.default_rng(5)


def picture(dtype, *, alpha=True, space=SRGB):
    full = 1.0 if dtype == np.float32 else np.iinfo(dtype).max
    levels = (full * RNG.uniform(size=(20, 30, 3))).astype(dtype)
    return Picture(
        levels=levels,
        alpha=(full * RNG.uniform(0.1, 1.0, size=(20, 30))).astype(dtype) if alpha else None,
        space=LINEAR if dtype == np.float32 else space,
    )


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_reducing_averages_levels_by_alpha(dtype):
    given = picture(dtype)
    found = given.resized((15, 10))
    weights = shares(given.alpha).reshape(10, 2, 15, 2)
    blocks = given.levels.astype(np.float64).reshape(10, 2, 15, 2, 3)
    expected = (blocks * weights[..., None]).sum(axis=(1, 3)) / weights.sum(axis=(1, 3))[..., None]
    full = 1.0 if dtype == np.float32 else float(np.iinfo(dtype).max)
    # Pillow multiplies 8-bit levels by alpha with rounding.
    np.testing.assert_allclose(
        found.levels / full, expected / full, atol={np.uint8: 0.03, np.uint16: 1e-4, np.float32: 1e-5}[dtype]
    )
    np.testing.assert_allclose(found.coverage(), weights.mean(axis=(1, 3)), atol=0.005)


def test_a_part_in_linear_light_is_the_part_of_the_whole():
    given = picture(np.uint8)
    part = slice(3, 9), slice(4, 20)
    np.testing.assert_array_equal(given.linear(part), given.linear()[part])
    np.testing.assert_array_equal(given.coverage(part), given.coverage()[part])


def test_grey_has_three_equal_channels():
    given = Picture(levels=np.full((2, 3, 1), 128, dtype=np.uint8), alpha=None, space=SRGB)
    assert given.linear().shape == given.srgb().shape == (2, 3, 3)
    np.testing.assert_allclose(given.linear(), 0.2158605, atol=1e-6)


def test_integers_clip_at_the_end_of_their_scale_and_floats_never():
    levels = np.array([[[251], [252], [255]]], dtype=np.uint8)
    given = Picture(levels=levels, alpha=None, space=SRGB)
    assert given.clipped()[..., 0].tolist() == [[False, True, True]]
    deep = Picture(levels=levels.astype(np.uint16) * 257, alpha=None, space=SRGB)
    assert deep.clipped()[..., 0].tolist() == [[False, True, True]]
    assert picture(np.float32).clipped() is None


def test_mirroring_exchanges_left_and_right_of_colours_and_alpha():
    given = picture(np.uint16)
    found = given.mirrored()
    np.testing.assert_array_equal(found.levels, given.levels[:, ::-1])
    np.testing.assert_array_equal(found.alpha, given.alpha[:, ::-1])


def test_averages_over_new_pixels_keep_the_mean():
    values = RNG.uniform(size=(12, 18)).astype(np.float32)
    assert box_averaged(values, (9, 4)).mean() == pytest.approx(values.mean(), abs=1e-6)
