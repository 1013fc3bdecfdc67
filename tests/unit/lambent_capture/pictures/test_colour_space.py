"""Colours arrive in linear Rec. 709 whatever states them, and what cannot be converted is refused by name."""

import io
import struct

import numpy as np
import pytest
from lambent_capture.pictures.colour_space import (
    ADOBE_RGB,
    SRGB,
    of_chromaticities,
    of_code_points,
    of_gamma,
    of_profile,
)
from lambent_capture.pictures.mask_levels import read_mask
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import picture_facts, read_levels, read_picture
from lambent_core.colour import rec709_matrix
from PIL import Image, ImageCms
from strangers.colours import SPACES
from strangers.profiles import chunk, png, rgb_profile

DISPLAY_P3 = rgb_profile(SPACES["p3"])
# Linear Display P3 to linear sRGB: both have the white point D65.
SRGB_FROM_P3 = np.array([[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]])
P3_COLOURS = np.array([[200, 120, 60], [90, 160, 110], [128, 128, 128], [60, 70, 150]], dtype=np.uint8)
AP1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)


def decoded(encoded):
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def as_linear(p3):
    return decoded(p3 / 255.0) @ SRGB_FROM_P3.T


def picture(colours=P3_COLOURS, size=8):
    return np.repeat(np.repeat(colours[None], size, axis=0), size, axis=1)


def with_profile(profile, levels=None, **options):
    buffer = io.BytesIO()
    image = Image.fromarray(picture() if levels is None else levels)
    image.save(buffer, "PNG", icc_profile=profile, **options)
    return buffer.getvalue()


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".heic", ".webp", ".tif", ".avif"])
def test_display_p3_becomes_rec_709(tmp_path, suffix):
    if suffix == ".heic":
        import pillow_heif

        pillow_heif.register_heif_opener()
    path = tmp_path / f"a{suffix}"
    lossless = suffix in (".png", ".webp", ".tif")
    options = {"quality": 100} if not lossless else {"lossless": True} if suffix == ".webp" else {}
    Image.fromarray(picture(size=16)).save(path, icc_profile=DISPLAY_P3, **options)
    expected = as_linear(P3_COLOURS)
    assert np.abs(expected - decoded(P3_COLOURS / 255.0)).max() > 0.05
    found = read_picture(path)
    np.testing.assert_allclose(found.linear()[8, 8::16], expected, atol=1e-3 if lossless else 0.02)
    small = read_picture(path, side=32)
    np.testing.assert_allclose(small.linear()[4, 4::8], expected, atol=2e-3 if lossless else 0.02)
    np.testing.assert_allclose(
        decoded(small.srgb()[4, 4::8] / 255.0), expected, atol=0.006 if lossless else 0.02
    )


def test_a_colour_beyond_rec_709_keeps_its_brightness_and_has_no_negative_channel():
    space, doubt = of_profile(DISPLAY_P3, 3)
    assert not doubt
    found = space.linear(np.array([[[255, 0, 0]]], dtype=np.uint8))
    np.testing.assert_allclose(found[0, 0], [1.2249, 0.0, 0.0], atol=1e-3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_a_level_means_the_same_in_8_16_and_32_bits(dtype):
    full = 1.0 if dtype == np.float32 else np.iinfo(dtype).max
    levels = (np.array([[[51, 102, 204]]]) / 255.0 * full).astype(dtype)
    for space in (SRGB, ADOBE_RGB, of_profile(DISPLAY_P3, 3)[0], of_code_points(9, 1), of_gamma(0.5, None)):
        expected = space.linear(np.array([[[51, 102, 204]]], dtype=np.uint8))
        np.testing.assert_allclose(space.linear(levels), expected, atol=2e-5)


def test_alpha_is_no_colour(tmp_path):
    alpha = np.full((8, 32, 1), 77, dtype=np.uint8)
    rgba = np.concatenate([picture(), alpha], axis=-1)
    (tmp_path / "a.png").write_bytes(with_profile(DISPLAY_P3, rgba))
    found = read_picture(tmp_path / "a.png")
    assert (found.alpha == 77).all()
    np.testing.assert_allclose(found.linear()[4, 4::8], as_linear(P3_COLOURS), atol=1e-3)


def test_a_profile_of_srgb_changes_nothing(tmp_path):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    (tmp_path / "a.png").write_bytes(with_profile(profile))
    assert read_picture(tmp_path / "a.png").space == SRGB
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png").srgb(), picture())


def test_a_mask_keeps_its_numbers_whatever_its_profile(tmp_path):
    grey = np.linspace(0, 255, 64).astype(np.uint8).reshape(8, 8)
    (tmp_path / "a.png").write_bytes(with_profile(DISPLAY_P3, np.dstack([grey] * 3)))
    np.testing.assert_allclose(read_mask(tmp_path / "a.png").coverage, grey / 255.0, atol=1e-6)


def test_a_damaged_profile_is_reported_and_the_picture_taken_for_srgb(tmp_path):
    (tmp_path / "a.png").write_bytes(with_profile(DISPLAY_P3[:200]))
    np.testing.assert_array_equal(read_levels(tmp_path / "a.png"), picture())
    assert "cannot be used" in picture_facts(tmp_path / "a.png").colour_doubt


def test_a_profile_of_colours_serves_a_grey_picture_and_one_of_greys_no_colours(tmp_path):
    grey = np.full((4, 4), 100, dtype=np.uint8)
    (tmp_path / "a.png").write_bytes(with_profile(DISPLAY_P3, grey))
    np.testing.assert_allclose(read_picture(tmp_path / "a.png").linear(), decoded(100 / 255.0), atol=1e-3)
    import imagecodecs

    profile = imagecodecs.cms_profile("gray", whitepoint=(0.3127, 0.329, 1.0), gamma=1.0)
    (tmp_path / "b.png").write_bytes(with_profile(profile, grey))
    np.testing.assert_allclose(read_picture(tmp_path / "b.png").linear(), 100 / 255.0, atol=1e-3)
    assert "describes GRAY" in of_profile(profile, 3)[1]


def test_a_cmyk_jpeg_is_read_as_colours(tmp_path):
    cmyk = Image.merge("CMYK", [Image.new("L", (16, 16), level) for level in (0, 255, 255, 0)])
    cmyk.save(tmp_path / "a.jpg", quality=100)
    assert read_picture(tmp_path / "a.jpg").levels.shape == (16, 16, 3)
    np.testing.assert_allclose(read_picture(tmp_path / "a.jpg").levels[8, 8], [255, 0, 0], atol=3)


# ---- what PNG states, in the order of its standard ---------------------------------------------------

CICP_P3 = chunk(b"cICP", bytes([12, 13, 0, 1]))
SRGB_CHUNK = chunk(b"sRGB", b"\0")
LINEAR_GAMMA = chunk(b"gAMA", struct.pack(">I", 100_000))
P3_CORNERS = chunk(b"cHRM", struct.pack(">8I", 31270, 32900, 68000, 32000, 26500, 69000, 15000, 6000))


@pytest.mark.parametrize(
    ("chunks", "expected"),
    [
        ((), lambda v: decoded(v)),
        ((SRGB_CHUNK, LINEAR_GAMMA, P3_CORNERS), lambda v: decoded(v)),
        ((LINEAR_GAMMA,), lambda v: v),
        ((LINEAR_GAMMA, P3_CORNERS), lambda v: v @ SRGB_FROM_P3.T),
        ((chunk(b"gAMA", struct.pack(">I", 45455)),), lambda v: v**2.2),
        ((SRGB_CHUNK, CICP_P3), lambda v: decoded(v) @ SRGB_FROM_P3.T),
        ((chunk(b"cICP", bytes([1, 8, 0, 1])), SRGB_CHUNK), lambda v: v),
        ((P3_CORNERS,), lambda v: decoded(v)),
    ],
)
def test_a_png_is_read_by_the_statement_that_comes_first_in_the_standard(tmp_path, chunks, expected):
    (tmp_path / "a.png").write_bytes(png(picture(), *chunks, bits=8))
    found = read_picture(tmp_path / "a.png").linear()[4, 4::8]
    np.testing.assert_allclose(found, np.maximum(expected(P3_COLOURS / 255.0), 0.0), atol=1e-3)


@pytest.mark.parametrize(("transfer", "named"), [(16, "PQ"), (18, "HLG")])
def test_high_dynamic_range_transfers_are_refused_by_name(tmp_path, transfer, named):
    (tmp_path / "a.png").write_bytes(png(picture(), chunk(b"cICP", bytes([9, transfer, 0, 1])), bits=8))
    with pytest.raises(PictureError, match=named) as caught:
        read_picture(tmp_path / "a.png")
    assert caught.value.code == "scene.colour_space"
    profile = bytearray(DISPLAY_P3)
    count = int.from_bytes(profile[128:132], "big")
    end = 132 + 12 * count
    # The tag in place of the copyright: a profile of its own would say the same.
    at = next(at for at in range(132, end, 12) if profile[at : at + 4] == b"cprt")
    start = int.from_bytes(profile[at + 4 : at + 8], "big")
    profile[at : at + 4], profile[start : start + 12] = b"cicp", b"cicp\0\0\0\0" + bytes([9, transfer, 0, 1])
    with pytest.raises(PictureError, match=named):
        of_profile(bytes(profile), 3)


@pytest.mark.parametrize(("primaries", "transfer"), [(3, 13), (1, 3), (255, 13)])
def test_unknown_code_points_are_refused(primaries, transfer):
    with pytest.raises(PictureError, match="code points"):
        of_code_points(primaries, transfer)


def test_code_points_that_state_nothing_leave_srgb():
    levels = P3_COLOURS[None]
    np.testing.assert_allclose(of_code_points(2, 2).linear(levels), SRGB.linear(levels), atol=1e-6)


@pytest.mark.parametrize("gamma", [0.0001, 20.0])
def test_a_gamma_that_cannot_be_is_refused(gamma):
    with pytest.raises(PictureError, match="gamma"):
        of_gamma(gamma, None)


# ---- EXIF --------------------------------------------------------------------------------------------


def adobe_linear(encoded):
    matrix = rec709_matrix((0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290))
    return (encoded ** (563 / 256)) @ matrix.T


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
@pytest.mark.parametrize(
    ("space", "index", "doubted"), [(65535, "R03", False), (2, "", False), (65535, "", True)]
)
def test_adobe_rgb_is_known_by_exif_alone(tmp_path, suffix, space, index, doubted):
    exif = Image.Exif()
    exif[0x010F] = "Maker"
    exif.get_ifd(0x8769)[0xA001] = space
    if index:
        exif.get_ifd(0x8769)[0xA005] = {1: index}
    options = {"quality": 100} if suffix == ".jpg" else {"lossless": True} if suffix == ".webp" else {}
    Image.fromarray(picture(size=16)).save(tmp_path / f"a{suffix}", exif=exif, **options)
    found = read_picture(tmp_path / f"a{suffix}")
    expected = np.maximum(adobe_linear(P3_COLOURS / 255.0), 0.0)
    np.testing.assert_allclose(found.linear()[8, 8::16], expected, atol=0.02 if suffix == ".jpg" else 1e-3)
    assert ("Adobe RGB" in found.colour_doubt) == doubted


# ---- matrices ------------------------------------------------------------------------------------------


def test_acescg_becomes_rec_709_as_published():
    # Source: the AP1 to Rec. 709 matrix of OpenColorIO's ACES configuration (Bradford).
    expected = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]
    levels = np.array([[[0.5, 0.4, 0.3]]], dtype=np.float32)
    np.testing.assert_allclose(
        of_chromaticities(AP1).linear(levels)[0, 0], np.array(expected) @ [0.5, 0.4, 0.3], atol=1e-3
    )


def test_primaries_without_colours_are_refused():
    with pytest.raises(PictureError, match="span no colours") as caught:
        of_chromaticities((0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.31, 0.33))
    assert caught.value.code == "scene.colour_space"
