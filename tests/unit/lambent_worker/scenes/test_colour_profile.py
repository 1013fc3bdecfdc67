"""Colours of photographs with a profile are brought to sRGB; masks and what has no profile stay as they
are."""

import numpy as np
import pytest
from lambent_worker.capture_qa.observe import read_small
from lambent_worker.scenes.colour_profile import profile_fault
from lambent_worker.scenes.pictures import picture_facts, read_coverage, read_pixels
from PIL import Image, ImageCms
from support.colour_profiles import display_p3

# Linear Display P3 to linear sRGB: both have the white point D65.
SRGB_FROM_P3 = np.array([[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]])
P3_COLOURS = np.array([[200, 120, 60], [90, 160, 110], [128, 128, 128], [60, 70, 150]], dtype=np.uint8)


def decoded(encoded):
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def encoded(linear):
    linear = linear.clip(0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def as_srgb(p3):
    return 255.0 * encoded(decoded(p3 / 255.0) @ SRGB_FROM_P3.T)


def picture(colours=P3_COLOURS, size=8):
    return np.repeat(np.repeat(colours[None], size, axis=0), size, axis=1)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".heic", ".webp"])
def test_display_p3_becomes_srgb(tmp_path, suffix):
    if suffix == ".heic":
        import pillow_heif

        pillow_heif.register_heif_opener()
    path = tmp_path / f"a{suffix}"
    options = {"quality": 100} | ({"lossless": True} if suffix == ".webp" else {})
    Image.fromarray(picture(size=16)).save(path, icc_profile=display_p3(), **options)
    expected = as_srgb(P3_COLOURS)
    assert np.abs(expected - P3_COLOURS).max() > 10.0
    found = read_pixels(path)[8, 8::16, :3]
    np.testing.assert_allclose(found, expected, atol=1.5 if suffix in (".png", ".webp") else 4.0)
    small, _, is_linear = read_small(path, 32)
    assert not is_linear
    np.testing.assert_allclose(small[4, 4::8], expected, atol=2.0 if suffix in (".png", ".webp") else 4.0)


def test_alpha_is_no_colour(tmp_path):
    alpha = np.full((8, 32, 1), 77, dtype=np.uint8)
    rgba = np.concatenate([picture(), alpha], axis=-1)
    Image.fromarray(rgba).save(tmp_path / "a.png", icc_profile=display_p3())
    found = read_pixels(tmp_path / "a.png")
    assert (found[..., 3] == 77).all()
    np.testing.assert_allclose(found[4, 4::8, :3], as_srgb(P3_COLOURS), atol=1.5)


def test_a_profile_of_srgb_changes_nothing(tmp_path):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(picture()).save(tmp_path / "a.png", icc_profile=profile)
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.png"), picture())


def test_a_mask_keeps_its_numbers_whatever_its_profile(tmp_path):
    Image.fromarray(picture()).save(tmp_path / "a.png", icc_profile=display_p3())
    np.testing.assert_allclose(read_coverage(tmp_path / "a.png"), picture().mean(axis=-1) / 255.0, atol=1e-6)


def test_a_damaged_profile_is_told_and_the_picture_taken_for_srgb(tmp_path):
    Image.fromarray(picture()).save(tmp_path / "a.png", icc_profile=display_p3()[:200])
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.png"), picture())
    assert picture_facts(tmp_path / "a.png").profile_fault


def test_a_profile_for_other_channels_is_told():
    image = Image.new("L", (4, 4))
    image.info["icc_profile"] = display_p3()
    assert "RGB colours, the picture is L" in profile_fault(image)


def test_a_cmyk_jpeg_is_read_as_colours(tmp_path):
    cmyk = Image.merge("CMYK", [Image.new("L", (16, 16), level) for level in (0, 255, 255, 0)])
    cmyk.save(tmp_path / "a.jpg", quality=100)
    pixels = read_pixels(tmp_path / "a.jpg")
    assert pixels.shape == (16, 16, 3)
    np.testing.assert_allclose(pixels[8, 8], [255, 0, 0], atol=3)
