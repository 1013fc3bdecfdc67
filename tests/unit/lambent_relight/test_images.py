"""Writing pictures."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from lambent_core.colour import linear_from_srgb, srgb_from_linear
from lambent_core.exr import REC709_CHROMATICITIES, write_exr
from lambent_relight.images import encode_png, read_picture_exr, write_picture_exr, write_png
from lambent_relight.picture import RelitPicture
from PIL import Image


def test_a_tone_curve_changes_the_png_and_keeps_its_alpha(tmp_path):
    bright = picture().exposed(2.0)
    write_png(tmp_path / "clipped.png", bright)
    write_png(tmp_path / "curved.png", bright, tone_mapping="neutral")
    clipped, curved = (np.asarray(Image.open(tmp_path / f"{name}.png")) for name in ("clipped", "curved"))
    np.testing.assert_array_equal(clipped[..., 3], curved[..., 3])
    assert (curved[..., :3] == 255).sum() < 0.2 * (clipped[..., :3] == 255).sum()


def picture(*, opaque: bool = False) -> RelitPicture:
    rng = np.random.default_rng(0)

    def image(channels: int) -> np.ndarray:
        return rng.random((3, 5, channels)).astype(np.float32)

    opacity = np.ones((3, 5, 1), np.float32) if opaque else image(1)
    colours = ("standard_error", "direct", "indirect", "diffuse", "specular", "albedo", "normal")
    planes = ("visibility", "perceptual_roughness", "metalness", "depth")
    rest = {name: image(3) for name in colours} | {name: image(1) for name in planes}
    far = 2.0 * image(1)
    return RelitPicture(
        rgb=2.0 * image(3), opacity=opacity, distance=far, coverage=opacity, num_samples=8, **rest
    )


def part_of(folder: Path) -> OpenEXR.Part:
    """Return the one part of the file that a test has written."""
    return OpenEXR.File(str(folder / "p.exr"), separate_channels=True).parts[0]


def test_srgb_encoding_is_undone_by_decoding_and_hits_known_values():
    values = np.linspace(0.0, 1.0, 1001)
    np.testing.assert_allclose(linear_from_srgb(srgb_from_linear(values)), values, atol=1e-6)
    assert srgb_from_linear(np.array(0.5)) == pytest.approx(0.735357, abs=1e-6)
    assert srgb_from_linear(np.array([-1.0, 2.0])) == pytest.approx([0.0, 1.0])


def test_png_has_straight_alpha_and_exposure_doubles_radiance(tmp_path):
    source = picture()
    write_png(tmp_path / "a" / "p.png", source.exposed(-1.0))
    with Image.open(tmp_path / "a" / "p.png") as opened:
        assert opened.mode == "RGBA"
        pixels = np.asarray(opened)
    expected = np.round(255 * srgb_from_linear(source.rgb / 2.0))
    np.testing.assert_array_equal(pixels[..., :3], expected)
    np.testing.assert_array_equal(pixels[..., 3], np.round(255 * source.opacity[..., 0]))


def test_an_opaque_picture_becomes_a_png_without_alpha():
    assert encode_png(picture(opaque=True)).shape == (3, 5, 3)


def test_exr_is_linear_premultiplied_named_and_states_its_primaries(tmp_path):
    source = picture()
    write_picture_exr(tmp_path / "p.exr", source, half=False)
    part = part_of(tmp_path)
    np.testing.assert_allclose(part.header["chromaticities"], REC709_CHROMATICITIES, atol=1e-6)
    channels = {name: channel.pixels for name, channel in part.channels.items()}
    np.testing.assert_array_equal(channels["G"], (source.rgb * source.opacity)[..., 1])
    np.testing.assert_array_equal(channels["A"], source.opacity[..., 0])
    np.testing.assert_array_equal(channels["albedo.B"], (source.albedo * source.coverage)[..., 2])
    np.testing.assert_array_equal(channels["normal.Z"], source.normal[..., 2])
    assert {"direct.R", "indirect.R", "standard_error.R", "perceptual_roughness.V", "metalness.V"} <= set(
        channels
    )


def test_exr_without_passes_is_half_rgba(tmp_path):
    write_picture_exr(tmp_path / "p.exr", picture(), passes=False)
    channels = part_of(tmp_path).channels
    assert set(channels) == set("RGBA")
    assert channels["R"].pixels.dtype == np.float16


def test_exr_holds_the_passes_that_are_named_and_no_others(tmp_path):
    write_picture_exr(tmp_path / "p.exr", picture(), passes=("normal", "depth", "indirect"))
    channels = part_of(tmp_path).channels
    layers = {f"normal.{letter}" for letter in "XYZ"} | {f"indirect.{letter}" for letter in "RGB"}
    assert set(channels) == {*"RGBAZ", "distance.V"} | layers


def test_the_mask_is_a_cryptomatte_of_the_named_object_whatever_the_background(tmp_path):
    source = replace(picture(opaque=True), coverage=picture().opacity.copy())
    source.coverage[0, 0] = 0.0
    write_picture_exr(tmp_path / "p.exr", source, passes=["cryptomatte"], object_name="vase")
    part = part_of(tmp_path)
    ident, share, *second = (part.channels[f"CryptoObject00.{letter}"].pixels for letter in "RGBA")
    assert {plane.dtype.type for plane in (ident, share, *second)} == {np.float32}
    np.testing.assert_array_equal(share, source.coverage[..., 0])
    (key,) = {name.split("/")[1] for name in part.header if name.startswith("cryptomatte/")}
    stated = {name: part.header[f"cryptomatte/{key}/{name}"] for name in ("name", "hash", "conversion")}
    assert stated == {
        "name": "CryptoObject",
        "hash": "MurmurHash3_32",
        "conversion": "uint32_to_float32",
    }
    manifest = json.loads(part.header[f"cryptomatte/{key}/manifest"])
    picked = ident.view(np.uint32) == int(manifest["vase"], 16)
    np.testing.assert_array_equal(picked, source.coverage[..., 0] > 0.0)
    assert not np.any(second)
    assert ident[0, 0] == 0.0


def test_a_file_without_the_mask_says_nothing_of_one(tmp_path):
    write_picture_exr(tmp_path / "p.exr", picture(), passes=["normal"])
    header = OpenEXR.File(str(tmp_path / "p.exr"), header_only=True).parts[0].header
    assert not [name for name in header if name.startswith("cryptomatte")]


@pytest.mark.parametrize("half", [True, False])
def test_depth_is_planar_far_where_nothing_is_and_never_rounded(tmp_path, half):
    source = picture()
    source.coverage[0, 0] = 0.0
    write_picture_exr(tmp_path / "p.exr", source, half=half)
    channels = part_of(tmp_path).channels
    colour = np.float16 if half else np.float32
    assert {channels[name].pixels.dtype.type for name in ("R", "albedo.G", "normal.Z")} == {colour}
    for name, expected in (("Z", source.depth), ("distance.V", source.distance)):
        plane = channels[name].pixels
        assert plane.dtype == np.float32
        assert plane[0, 0] == np.float32(1e10)
        np.testing.assert_array_equal(plane[1:], expected[1:, :, 0])


def test_a_file_from_before_planar_depth_is_read_as_one_of_today(tmp_path):
    old = {name: np.full((2, 3), 0.5, np.float32) for name in ("R", "G", "B", "A", "Z")}
    old["Z"][0] = 0.0
    header = {"lambent:depth": "distance from the camera along the ray, scene units"}
    write_exr(tmp_path / "old.exr", old, attributes=header)
    channels = read_picture_exr(tmp_path / "old.exr")
    assert set(channels) == {*"RGBA", "distance.V"}
    np.testing.assert_array_equal(channels["distance.V"], np.float32([[1e10] * 3, [0.5] * 3]))


def test_a_file_of_today_is_read_as_it_was_written(tmp_path):
    write_picture_exr(tmp_path / "p.exr", picture(), half=False)
    channels = read_picture_exr(tmp_path / "p.exr")
    np.testing.assert_array_equal(channels["Z"], picture().depth[..., 0])
    np.testing.assert_array_equal(channels["distance.V"], picture().distance[..., 0])


def test_colours_of_all_layers_are_multiplied_by_coverage_and_measurements_are_not(tmp_path):
    """A compositing program divides what has R, G and B by alpha, and finds edges as soft as the beauty."""
    source = replace(picture(), coverage=picture().opacity * np.float32(0.5))
    write_picture_exr(tmp_path / "p.exr", source, half=False)
    part = part_of(tmp_path)
    found = {name: channel.pixels for name, channel in part.channels.items()}
    for name in ("direct", "indirect", "diffuse", "specular", "albedo"):
        np.testing.assert_array_equal(found[f"{name}.G"], (getattr(source, name) * source.coverage)[..., 1])
    np.testing.assert_array_equal(found["G"], (source.rgb * source.opacity)[..., 1])
    for name in ("visibility", "perceptual_roughness", "metalness"):
        np.testing.assert_array_equal(found[f"{name}.V"], getattr(source, name)[..., 0])
    np.testing.assert_array_equal(found["normal.X"], source.normal[..., 0])
    assert part.header["lambent:premultiplied"] == "R, G, B of every layer"


@pytest.mark.parametrize("mask", [True, False])
def test_the_albedo_of_an_older_file_is_read_as_one_of_today(tmp_path, mask):
    old = {name: np.full((2, 3), 0.5, np.float32) for name in ("A", "albedo.R", "albedo.G", "albedo.B")}
    if mask:
        old |= {f"CryptoObject00.{letter}": np.full((2, 3), 0.25, np.float32) for letter in "RGBA"}
    write_exr(tmp_path / "old.exr", old, half=False)
    np.testing.assert_array_equal(read_picture_exr(tmp_path / "old.exr")["albedo.G"], 0.125 if mask else 0.25)
