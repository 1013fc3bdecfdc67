"""TIFF photographs of 8, 16 and 32 bits, and raw files that only look like them."""

import numpy as np
import pytest
import tifffile
from lambent_capture.pictures.colour_space import SRGB
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import has_alpha, picture_facts, picture_size, read_picture
from PIL import Image
from strangers.colours import SPACES
from strangers.profiles import rgb_profile

DISPLAY_P3 = rgb_profile(SPACES["p3"])
LEVELS = np.random.default_rng(3).integers(0, 65536, (12, 16, 3), dtype=np.uint16)


@pytest.mark.parametrize("compression", [None, "lzw", "zlib", "packbits"])
@pytest.mark.parametrize("byteorder", ["<", ">"])
def test_16_bits_are_read_in_full(tmp_path, compression, byteorder):
    tifffile.imwrite(
        tmp_path / "a.tif", LEVELS, photometric="rgb", compression=compression, byteorder=byteorder
    )
    assert picture_size(tmp_path / "a.tif") == (16, 12)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif").levels, LEVELS)


@pytest.mark.parametrize("compression", ["raw", "tiff_lzw", "tiff_adobe_deflate", "jpeg"])
def test_8_bits_are_read(tmp_path, compression):
    smooth = np.dstack([np.linspace(20, 200, 16)[None] * np.ones((12, 1))] * 3).astype(np.uint8)
    options = {"quality": 100} if compression == "jpeg" else {}
    Image.fromarray(smooth).save(tmp_path / "a.tiff", compression=compression, **options)
    found = read_picture(tmp_path / "a.tiff").levels.astype(int)
    assert np.abs(found - smooth).max() <= (4 if compression == "jpeg" else 0)


def test_planes_one_after_another_are_the_same_picture(tmp_path):
    tifffile.imwrite(
        tmp_path / "a.tif", np.moveaxis(LEVELS, -1, 0), photometric="rgb", planarconfig="separate"
    )
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif").levels, LEVELS)


def test_alpha_is_divided_out_where_it_is_associated(tmp_path):
    alpha = np.full((12, 16, 1), 32768, dtype=np.uint16)
    half = np.concatenate([LEVELS // 2, alpha], axis=-1)
    tifffile.imwrite(tmp_path / "a.tif", half, photometric="rgb", extrasamples=["assocalpha"])
    found = read_picture(tmp_path / "a.tif")
    assert np.abs(found.levels.astype(int) - LEVELS).max() <= 3
    np.testing.assert_allclose(found.coverage(), 0.5, atol=1e-4)
    tifffile.imwrite(tmp_path / "b.tif", half, photometric="rgb", extrasamples=["unassalpha"])
    np.testing.assert_array_equal(read_picture(tmp_path / "b.tif").levels, LEVELS // 2)
    assert has_alpha(tmp_path / "b.tif")


def test_white_is_zero_turns_levels_round(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", LEVELS[..., 0], photometric="miniswhite")
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif").levels[..., 0], 65535 - LEVELS[..., 0])


def test_floats_are_light(tmp_path):
    light = (LEVELS / 20000.0).astype(np.float32)
    tifffile.imwrite(tmp_path / "a.tif", light, photometric="rgb")
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif").linear(), light)
    assert picture_facts(tmp_path / "a.tif").is_finite


def test_a_profile_is_obeyed_in_16_bits(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", LEVELS, photometric="rgb", iccprofile=DISPLAY_P3)
    encoded = LEVELS / 65535.0
    light = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    matrix = np.array([[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]])
    expected = np.maximum(light @ matrix.T, 0.0)
    np.testing.assert_allclose(read_picture(tmp_path / "a.tif").linear(), expected, atol=1e-3)
    tifffile.imwrite(tmp_path / "b.tif", LEVELS, photometric="rgb")
    assert read_picture(tmp_path / "b.tif").space == SRGB


@pytest.mark.parametrize("kind", [np.int16, np.uint32, np.float64])
def test_other_numbers_are_refused(tmp_path, kind):
    tifffile.imwrite(tmp_path / "a.tif", LEVELS.astype(kind), photometric="rgb")
    with pytest.raises(PictureError, match="8 or 16 bits"):
        read_picture(tmp_path / "a.tif")


def test_a_raw_file_under_another_suffix_is_refused(tmp_path):
    tifffile.imwrite(
        tmp_path / "a.tif", LEVELS, photometric="rgb", extratags=[(50706, "B", 4, b"\1\4\0\0", True)]
    )
    with pytest.raises(PictureError, match="raw file"):
        read_picture(tmp_path / "a.tif")


def test_a_damaged_file_is_refused(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", LEVELS, photometric="rgb")
    content = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "a.tif").write_bytes(content[: len(content) // 2])
    with pytest.raises(PictureError):
        read_picture(tmp_path / "a.tif")
    (tmp_path / "b.tif").write_bytes(b"II*\0" + bytes(40))
    with pytest.raises(PictureError):
        picture_size(tmp_path / "b.tif")


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("compression", [None, "lzw"])
@pytest.mark.parametrize("alpha", [False, True])
def test_rows_are_those_of_the_file_and_mirror_images_are_mirrored_back(
    tmp_path, orientation, kind, compression, alpha
):
    levels = (LEVELS >> 8).astype(np.uint8) if kind == np.uint8 else LEVELS
    stored = np.dstack([levels, levels[..., 0]]) if alpha else levels
    tifffile.imwrite(
        tmp_path / "a.tif",
        stored,
        photometric="rgb",
        compression=compression,
        extrasamples=["unassalpha"] if alpha else None,
        extratags=[(274, "H", 1, orientation, True)],
    )
    expected = levels[:, ::-1] if orientation in (2, 4, 5, 7) else levels
    assert picture_size(tmp_path / "a.tif") == (16, 12)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif").levels, expected)
    assert read_picture(tmp_path / "a.tif", side=8).size == (8, 6)


def test_grey_with_associated_alpha_is_divided(tmp_path):
    grey = np.dstack([np.full((12, 16), 60), np.full((12, 16), 128)]).astype(np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", grey, photometric="minisblack", extrasamples=["assocalpha"])
    found = read_picture(tmp_path / "a.tif")
    assert abs(int(found.levels[0, 0, 0]) - 120) <= 1
    np.testing.assert_allclose(found.coverage(), 128 / 255, atol=1e-6)
