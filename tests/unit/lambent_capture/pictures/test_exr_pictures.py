"""OpenEXR photographs: associated alpha, windows, layers, chroma; the corpus has rows of parts, primaries."""

from types import SimpleNamespace

import numpy as np
import OpenEXR
import pytest
from lambent_capture.pictures import exr_pictures
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import picture_size, read_picture

HEIGHT, WIDTH = 24, 32
DISTANCE = np.hypot(*(np.mgrid[:HEIGHT, :WIDTH] - np.array([11.5, 15.5])[:, None, None]))
ALPHA = np.clip((9.0 - DISTANCE) / 3.0, 0.0, 1.0).astype(np.float32)
COLOURS = np.dstack([0.6 + 0.01 * DISTANCE, 0.2 + 0 * DISTANCE, 0.1 + 0.02 * DISTANCE]).astype(np.float32)


def channels(colours, alpha=None, prefix=""):
    planes = {f"{prefix}{name}": np.ascontiguousarray(colours[..., at]) for at, name in enumerate("RGB")}
    return planes | ({} if alpha is None else {f"{prefix}A": alpha})


def write(path, planes, **header):
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, planes).write(str(path))
    return path


def test_colours_are_divided_by_alpha(tmp_path):
    found = read_picture(write(tmp_path / "a.exr", channels(COLOURS * ALPHA[..., None], ALPHA)))
    np.testing.assert_allclose(found.coverage(), ALPHA, atol=1e-6)
    np.testing.assert_allclose(found.linear()[ALPHA > 0.01], COLOURS[ALPHA > 0.01], rtol=1e-4)


@pytest.mark.parametrize("background", [0.0, 0.3])
def test_colours_that_were_clearly_not_multiplied_are_not_divided(tmp_path, background):
    straight = np.where(ALPHA[..., None] > 0.0, COLOURS, np.float32(background))
    found = read_picture(write(tmp_path / "a.exr", channels(straight, ALPHA)))
    assert "straight" in found.colour_doubt
    np.testing.assert_allclose(found.linear()[ALPHA > 0.01], COLOURS[ALPHA > 0.01], rtol=1e-4)


@pytest.mark.parametrize("rim", [0.5, 2.0, 4.0])
def test_a_rim_of_another_brightness_is_no_reason_to_doubt_the_alpha(tmp_path, rim):
    colours = np.where((ALPHA < 1.0)[..., None], rim * COLOURS, COLOURS)
    found = read_picture(write(tmp_path / "a.exr", channels(colours * ALPHA[..., None], ALPHA)))
    assert not found.colour_doubt
    np.testing.assert_allclose(found.linear()[ALPHA > 0.01], colours[ALPHA > 0.01], rtol=1e-4)


def test_a_data_window_is_a_part_of_the_frame(tmp_path):
    part = slice(4, 20), slice(8, 28)
    write(
        tmp_path / "a.exr",
        channels((COLOURS * ALPHA[..., None])[part], np.ascontiguousarray(ALPHA[part])),
        dataWindow=((8, 4), (27, 19)),
        displayWindow=((0, 0), (WIDTH - 1, HEIGHT - 1)),
    )
    assert picture_size(tmp_path / "a.exr") == (WIDTH, HEIGHT)
    found = read_picture(tmp_path / "a.exr")
    expected = np.zeros_like(ALPHA)
    expected[part] = ALPHA[part]
    np.testing.assert_allclose(found.coverage(), expected, atol=1e-6)
    inside = expected > 0.01
    np.testing.assert_allclose(found.linear()[inside], COLOURS[inside], rtol=1e-4)


def test_overscan_is_cut_off(tmp_path):
    write(
        tmp_path / "a.exr",
        channels(COLOURS),
        dataWindow=((-4, -2), (WIDTH - 5, HEIGHT - 3)),
        displayWindow=((0, 0), (15, 11)),
    )
    assert picture_size(tmp_path / "a.exr") == (16, 12)
    np.testing.assert_allclose(read_picture(tmp_path / "a.exr").linear(), COLOURS[2:14, 4:20], rtol=1e-4)


@pytest.mark.parametrize("layer", ["ViewLayer.Combined.", "beauty.", "anything."])
def test_a_layer_is_read_by_its_name(tmp_path, layer):
    planes = channels(COLOURS, prefix=layer)
    if layer != "anything.":
        planes |= channels(np.zeros_like(COLOURS), prefix="ViewLayer.Normal.")
    write(tmp_path / "a.exr", planes)
    np.testing.assert_allclose(read_picture(tmp_path / "a.exr").linear(), COLOURS, rtol=1e-4)


def test_layers_without_a_usual_name_are_refused_by_their_names(tmp_path):
    write(tmp_path / "a.exr", channels(COLOURS, prefix="left.") | channels(COLOURS, prefix="right."))
    with pytest.raises(PictureError, match=r"left\.B"):
        read_picture(tmp_path / "a.exr")


def test_luminance_and_chroma_become_colours(tmp_path):
    smooth = np.dstack([0.4 + 0.004 * DISTANCE, 0.3 + 0 * DISTANCE, 0.2 + 0 * DISTANCE]).astype(np.float32)
    luminance = (smooth @ [0.2126, 0.7152, 0.0722]).astype(np.float32)
    planes = {"Y": luminance}
    for name, at in (("RY", 0), ("BY", 2)):
        planes[name] = ((smooth[..., at] - luminance) / luminance).astype(np.float32)
    write(tmp_path / "a.exr", planes)
    np.testing.assert_allclose(read_picture(tmp_path / "a.exr").linear(), smooth, atol=2e-3)


def test_a_channel_of_every_second_pixel_is_spread_over_all():
    # The library reads such files and does not write them.
    channel = SimpleNamespace(xSampling=2, ySampling=2)
    ramp = np.arange(8, dtype=np.float32)[None] + 10.0 * np.arange(6, dtype=np.float32)[:, None]
    found = exr_pictures._upsampled(np.ascontiguousarray(ramp[::2, ::2]), (0, 0), (8, 6), channel)
    np.testing.assert_allclose(found[:5, :7], ramp[:5, :7], rtol=1e-6)
    # A window that begins at odd coordinates has its first sample one pixel in.
    odd = exr_pictures._upsampled(np.ascontiguousarray(ramp[2::2, 2::2]), (1, 1), (7, 5), channel)
    np.testing.assert_allclose(odd[1:4, 1:6], ramp[2:5, 2:7], rtol=1e-6)


def test_luminance_of_tristimulus_values_is_their_second(tmp_path):
    xyz = np.dstack([0.3 + 0 * DISTANCE, 0.4 + 0 * DISTANCE, 0.2 + 0 * DISTANCE]).astype(np.float32)
    planes = {"Y": xyz[..., 1].copy()}
    for name, at in (("RY", 0), ("BY", 2)):
        planes[name] = ((xyz[..., at] - xyz[..., 1]) / xyz[..., 1]).astype(np.float32)
    write(tmp_path / "a.exr", planes, chromaticities=(1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3))
    matrix = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
    found = read_picture(tmp_path / "a.exr").linear()[0, 0]
    np.testing.assert_allclose(found, matrix @ [0.3, 0.4, 0.2], atol=1e-3)


def test_grey_is_grey(tmp_path):
    write(tmp_path / "a.exr", {"Y": np.ascontiguousarray(COLOURS[..., 0])})
    np.testing.assert_allclose(
        read_picture(tmp_path / "a.exr").linear(), np.dstack([COLOURS[..., 0]] * 3), rtol=1e-4
    )
