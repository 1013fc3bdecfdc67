"""Maps at the edge of what can be used: unusable values, the smallest and the largest sizes."""

import numpy as np
import OpenEXR
import pytest
from lambent_core.directions import normalise, pixel_solid_angles
from lambent_core.errors import EnvironmentFileError
from lambent_relight.environment.light_sampling import LightSampler
from lambent_relight.environment.maps import environment_from_array, load_environment, write_environment
from support.statistics import assert_mean


def random_map(height, width):
    return np.random.default_rng(0).gamma(0.4, 2.0, (height, width, 3)).astype(np.float32)


def write_flat_hdr(path, image):
    """Write an uncoded Radiance file."""
    mantissa, exponent = np.frexp(image.max(axis=-1))
    scale = mantissa * 256.0 / np.maximum(image.max(axis=-1), 1e-32)
    pixels = np.concatenate([image * scale[..., None], (exponent + 128)[..., None]], axis=-1)
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % image.shape[:2]
    path.write_bytes(head + pixels.astype(np.uint8).tobytes())


def unusable_map():
    image = np.ones((2, 4, 3), np.float32)
    image[0, 0, 0], image[0, 1, 1], image[1, 2, 2], image[1, 3] = np.nan, np.inf, -1.0, -np.inf
    image[0, 3, 0] = 7.0
    return image


def test_unusable_values_are_counted_and_refused(tmp_path):
    counts = r"1 NaN, 4 infinite and 1 negative values, the first in row 0, column 0"
    with pytest.raises(EnvironmentFileError, match=counts) as caught:
        environment_from_array(unusable_map())
    assert caught.value.code == "environment.unusable_values"
    channels = {name: np.ascontiguousarray(unusable_map()[..., i]) for i, name in enumerate("RGB")}
    OpenEXR.File({}, channels).write(str(tmp_path / "bad.exr"))
    with pytest.raises(EnvironmentFileError, match=counts):
        load_environment(tmp_path / "bad.exr")
    assert load_environment(tmp_path / "bad.exr", mend=True).cleaning.num_infinite == 4


def test_unusable_values_are_replaced_on_request():
    environment = environment_from_array(unusable_map(), mend=True)
    cleaning = environment.cleaning
    assert (cleaning.num_nan, cleaning.num_infinite, cleaning.num_negative) == (1, 4, 1)
    assert environment.radiance[0, 0, 0] == 0.0
    assert environment.radiance[0, 1, 1] == 7.0
    assert environment.radiance.min() == 0.0
    assert environment.radiance[1, 3].max() == 0.0


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (2, 2)])
def test_the_smallest_maps_are_light_like_any_other(shape):
    environment = environment_from_array(random_map(*shape) + 0.1)
    directions = normalise(np.random.default_rng(4).normal(size=(20000, 3)))
    radiance = environment.lookup(directions)
    low, high = environment.radiance.min(axis=(0, 1)), environment.radiance.max(axis=(0, 1))
    assert (radiance >= low * 0.9999).all()
    assert (radiance <= high * 1.0001).all()
    axes = np.broadcast_to(np.array([0.0, 0.0, 1.0]), directions.shape)
    sampler = LightSampler(environment)
    drawn = sampler.sample(*np.random.default_rng(0).random((2, 20000)), axes, 1)
    assert_mean(1.0 / sampler.pdf(drawn, axes, 1), np.full(1, 4.0 * np.pi), expected_error=1e-2)


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
def test_a_map_above_the_limit_is_reduced_and_says_so(tmp_path, suffix):
    image = np.round(random_map(16, 32) * 8.0) / 8.0
    path = tmp_path / f"sky{suffix}"
    if suffix == ".exr":
        write_environment(path, image, half=False)
    else:
        write_flat_hdr(path, image)
    whole = load_environment(path)
    reduced = load_environment(path, max_pixels=8 * 16)
    assert whole.reduced_from is None
    assert reduced.reduced_from == (16, 32)
    assert reduced.radiance.shape == (8, 16, 3)
    weights = pixel_solid_angles(16, 32)[:2]
    block = np.tensordot(weights / weights.sum(), whole.radiance[:2, 4:6].mean(axis=1), axes=1)
    np.testing.assert_allclose(reduced.radiance[0, 2], block, rtol=1e-5)
    with pytest.raises(EnvironmentFileError, match=r"environment\.too_large"):
        load_environment(path, max_file_pixels=511)
    with pytest.raises(EnvironmentFileError, match="blocks of 3 x 3 do not divide"):
        load_environment(path, max_pixels=70)
