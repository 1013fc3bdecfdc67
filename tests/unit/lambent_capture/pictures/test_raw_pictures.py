"""A camera's raw file opens as linear colours, the same balance and scale for every photograph of a
camera."""

import numpy as np
import pytest
from lambent_capture.pictures import raw_pictures
from lambent_capture.pictures.exif import exif_facts
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import (
    encoding_of,
    has_alpha,
    picture_facts,
    picture_size,
    read_levels,
    read_picture,
)
from lambent_capture.scenes.exposure import exif_exposure
from support.raw_files import write_dng

COLOURS = np.zeros((40, 60, 3))
COLOURS[:, :30] = (0.5, 0.25, 0.1)
COLOURS[:, 30:] = (0.1, 0.2, 0.8)


def test_a_dng_gives_its_linear_colours_at_half_the_sensor(tmp_path):
    write_dng(tmp_path / "a.DNG", COLOURS)
    assert picture_size(tmp_path / "a.DNG") == (30, 20)
    pixels = read_levels(tmp_path / "a.DNG")
    assert pixels.dtype == np.float32
    np.testing.assert_allclose(pixels, COLOURS[::2, ::2], atol=1e-3)
    assert encoding_of("a.DNG") == "linear"
    assert read_picture(tmp_path / "a.DNG").is_linear
    assert not has_alpha(tmp_path / "a.DNG")
    assert picture_facts(tmp_path / "a.DNG").is_finite


def test_an_odd_sensor_is_halved_upwards(tmp_path):
    write_dng(tmp_path / "a.dng", COLOURS[:39, :59])
    assert picture_size(tmp_path / "a.dng") == (30, 20)
    assert read_levels(tmp_path / "a.dng").shape == (20, 30, 3)


def test_neither_the_cameras_balance_nor_the_brightest_pixel_changes_the_scale(tmp_path):
    write_dng(tmp_path / "a.dng", 0.1 * COLOURS, neutral=(0.5, 1.0, 0.7))
    np.testing.assert_allclose(read_levels(tmp_path / "a.dng"), 0.1 * COLOURS[::2, ::2], atol=1e-3)


def test_the_orientation_is_told_and_not_applied(tmp_path):
    write_dng(tmp_path / "a.dng", COLOURS, orientation=6)
    assert picture_size(tmp_path / "a.dng") == (30, 20)
    np.testing.assert_allclose(read_levels(tmp_path / "a.dng"), COLOURS[::2, ::2], atol=1e-3)
    assert exif_facts(tmp_path / "a.dng").orientation == 6


def test_a_dng_tells_how_it_was_taken(tmp_path):
    write_dng(tmp_path / "a.dng", COLOURS, exposure=(0.02, 4.0, 200))
    facts = exif_facts(tmp_path / "a.dng")
    assert facts.camera == "Lambent Test camera"
    assert (facts.focal_mm, facts.focal_35mm) == (26.0, 39.0)
    exposure = exif_exposure(tmp_path / "a.dng")
    assert (exposure.time_s, exposure.f_number, exposure.iso) == pytest.approx((0.02, 4.0, 200.0))


def test_a_raw_file_that_is_tiff_but_for_its_first_bytes_tells_the_same(tmp_path):
    write_dng(tmp_path / "a.dng", COLOURS)
    (tmp_path / "a.orf").write_bytes(b"IIRO" + (tmp_path / "a.dng").read_bytes()[4:])
    assert exif_facts(tmp_path / "a.orf") == exif_facts(tmp_path / "a.dng")


def test_what_libraw_knows_stands_in_where_there_is_no_exif_to_be_read(tmp_path, monkeypatch):
    write_dng(tmp_path / "a.dng", COLOURS, orientation=8)
    monkeypatch.setattr("lambent_capture.pictures.exif._TIFF_STARTS", ())
    facts = exif_facts(tmp_path / "a.dng")
    assert (facts.time_s, facts.f_number, facts.iso) == pytest.approx((0.01, 8.0, 100.0))
    assert facts.focal_mm == pytest.approx(26.0)
    assert facts.orientation == 8


def test_colours_that_come_whole_are_halved_too():
    whole = np.arange(5 * 4 * 3, dtype=np.float32).reshape(5, 4, 3)
    halved = raw_pictures._halved(whole)
    assert halved.shape == (3, 2, 3)
    np.testing.assert_allclose(halved[0, 0], whole[:2, :2].mean(axis=(0, 1)))
    np.testing.assert_allclose(halved[2, 1], whole[4, 2:].mean(axis=0))


def test_without_rawpy_the_advice_is_to_install_the_extra(tmp_path, monkeypatch):
    write_dng(tmp_path / "a.dng", COLOURS)
    monkeypatch.setattr(raw_pictures, "find_spec", lambda name: None)
    with pytest.raises(PictureError, match=r"pip install 'lambent\[raw\]'") as refused:
        picture_size(tmp_path / "a.dng")
    assert refused.value.code == "scene.raw_not_installed"


def test_text_and_a_cut_off_file_are_refused_with_a_reason(tmp_path):
    (tmp_path / "text.nef").write_text("no photograph")
    write_dng(tmp_path / "whole.dng", COLOURS)
    content = bytearray((tmp_path / "whole.dng").read_bytes())
    at = content.find(b"\x11\x01\x04\x00")
    content[at + 8 : at + 12] = len(content).to_bytes(4, "little")  # the pixels begin where the file ends
    (tmp_path / "cut.dng").write_bytes(content)
    for name, code in (("text.nef", "scene.image_not_a_picture"), ("cut.dng", "scene.image_broken")):
        with pytest.raises(PictureError) as refused:
            read_levels(tmp_path / name)
        assert refused.value.code == code


def test_more_pixels_than_the_limit_are_refused_by_the_header(tmp_path):
    write_dng(tmp_path / "a.dng", COLOURS)
    content = bytearray((tmp_path / "a.dng").read_bytes())
    for tag in (b"\x00\x01\x04\x00", b"\x01\x01\x04\x00"):
        at = content.find(tag + b"\x01\0\0\0")
        content[at + 8 : at + 12] = (60000).to_bytes(4, "little")
    (tmp_path / "a.dng").write_bytes(content)
    with pytest.raises(PictureError) as refused:
        read_levels(tmp_path / "a.dng")
    assert refused.value.code == "scene.image_too_large"
