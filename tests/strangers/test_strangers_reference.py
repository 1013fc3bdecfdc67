"""The reference agrees with published numbers, and its files with the libraries that read them."""

import io

import numpy as np
import pytest
from PIL import Image, ImageCms, ImageOps
from strangers import floats, profiles
from strangers.ball import COVER, disc
from strangers.colours import SPACES, decoded, encoded, levels_of, light_of, to_rec709
from strangers.pictures import object_alpha, turned


def test_matrices_are_the_published_ones():
    """ITU-R BT.2087-0 has BT.2020 to BT.709; the other is CSS Color 4's of Display P3 to sRGB."""
    rec2020 = [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]]
    p3 = [[1.2249, -0.2249, 0.0], [-0.0421, 1.0421, 0.0], [-0.0196, -0.0786, 1.0983]]
    np.testing.assert_allclose(to_rec709(SPACES["rec2020"]), rec2020, atol=2e-4)
    np.testing.assert_allclose(to_rec709(SPACES["p3"]), p3, atol=2e-4)


def test_white_is_white_in_every_space():
    for space in SPACES.values():
        np.testing.assert_allclose(light_of(np.ones(3), space), 1.0, atol=1e-9)


@pytest.mark.parametrize("curve", ["srgb", "rec709", 1.0, 2.2])
def test_curves_are_the_inverse_of_each_other(curve: str | float):
    light = np.linspace(0.0, 1.0, 101)
    np.testing.assert_allclose(decoded(curve, encoded(curve, light)), light, atol=2e-4)


@pytest.mark.parametrize("name", ["srgb", "p3", "adobe", "rec2020", "prophoto", "linear"])
def test_profiles_mean_to_little_cms_what_the_formulas_say(name: str):
    colours = np.random.default_rng(1).uniform(0.1, 0.8, (40, 3))
    levels = levels_of(colours, SPACES[name])
    inside = (levels >= 0.0).all(axis=-1) & (levels <= 1.0).all(axis=-1)
    stored = np.round(255 * levels[inside]).astype(np.uint8)
    given = ImageCms.ImageCmsProfile(io.BytesIO(profiles.rgb_profile(SPACES[name])))
    image = ImageCms.profileToProfile(
        Image.fromarray(stored[None]), given, ImageCms.createProfile("sRGB"), renderingIntent=1
    )
    found = np.asarray(image)[0] / 255
    wanted = np.clip(levels_of(light_of(stored / 255, SPACES[name]), SPACES["srgb"]), 0.0, 1.0)
    np.testing.assert_allclose(found, wanted, atol=2.5 / 255)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_png_files_hold_what_was_given(channels: int):
    levels = np.random.default_rng(2).integers(0, 256, (5, 7, channels)).astype(np.uint8)
    found = np.asarray(Image.open(io.BytesIO(profiles.png(levels))))
    np.testing.assert_array_equal(found.reshape(levels.shape), levels)


def test_masks_of_one_bit_hold_what_was_given():
    levels = np.random.default_rng(3).integers(0, 2, (5, 11)).astype(np.uint8)
    found = np.asarray(Image.open(io.BytesIO(profiles.png(levels, bits=1))))
    np.testing.assert_array_equal(found, levels.astype(bool))


def test_exif_holds_orientation_colour_space_and_interoperability():
    exif = Image.Exif()
    exif.load(profiles.exif(orientation=6, colour_space=0xFFFF, interoperability="R03"))
    assert exif[0x0112] == 6
    assert exif.get_ifd(0x8769)[0xA001] == 0xFFFF
    assert exif.get_ifd(0xA005)[1] == "R03"


@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_turn_as_pillow_turns_them(orientation: int):
    pixels = (255 * object_alpha(soft=True)).astype(np.uint8)
    image = Image.fromarray(pixels)
    image.getexif()[0x0112] = orientation
    np.testing.assert_array_equal(turned(pixels, orientation), np.asarray(ImageOps.exif_transpose(image)))


def test_radiance_pixels_keep_their_light():
    light = np.random.default_rng(4).uniform(0.0, 8.0, (50, 3))
    pixels = floats.rgbe(light)
    step = np.ldexp(1.0, pixels[:, 3:].astype(int) - 136)
    lost = light - floats.rgbe_light(pixels)
    assert ((lost >= -1e-9) & (lost <= step + 1e-9)).all()


def test_the_ball_covers_what_the_corpus_says():
    assert disc().mean() == pytest.approx(COVER, abs=5e-5)
