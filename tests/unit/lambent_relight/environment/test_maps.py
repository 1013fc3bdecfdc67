"""Environment maps: files from strangers, convention, interpolation, importance sampling."""

import json
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from lambent_core.directions import (
    directions_of_uv,
    normalise,
    pixel_directions,
    pixel_solid_angles,
    rotate_about_z,
    uv_of_directions,
)
from lambent_core.errors import EnvironmentFileError
from lambent_core.exr import write_exr
from lambent_relight.environment.light_sampling import LOBE_ALPHAS, LightSampler, lobe_of_alpha
from lambent_relight.environment.maps import environment_from_array, load_environment, write_environment
from support.statistics import assert_mean

GOLDEN = json.loads(
    (Path(__file__).parents[3] / "golden/environment_orientation.json").read_text(encoding="utf-8")
)


def random_map(height: int, width: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).gamma(0.4, 2.0, (height, width, 3)).astype(np.float32)


def rgbe_rows(image: np.ndarray) -> np.ndarray:
    """Return shared-exponent pixels of `image`, [height, width, 4]."""
    mantissa, exponent = np.frexp(image.max(axis=-1))
    scale = mantissa * 256.0 / np.maximum(image.max(axis=-1), 1e-32)
    return np.concatenate([image * scale[..., None], (exponent + 128)[..., None]], axis=-1).astype(np.uint8)


def hdr_bytes(pixels: np.ndarray, *, header: bytes = b"", coded: bool = True) -> bytes:
    height, width, _ = pixels.shape
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n" + header + b"\n-Y %d +X %d\n" % (height, width)
    if not coded:
        return head + pixels.tobytes()
    body = bytearray()
    for row in pixels:
        body += struct.pack(">BBH", 2, 2, width)
        for plane in row.T:
            for start in range(0, width, 100):
                run = plane[start : start + 100]
                body += (
                    bytes([128 + len(run), run[0]])
                    if len(run) > 1 and (run == run[0]).all()
                    else bytes([len(run)]) + run.tobytes()
                )
    return head + bytes(body)


@pytest.mark.parametrize("case", GOLDEN["cases"], ids=lambda c: f"{c['row']},{c['column']},{c['rotate_deg']}")
def test_one_texel_shines_from_the_golden_direction(case):
    image = np.zeros((GOLDEN["height"], GOLDEN["width"], 3), np.float32)
    image[case["row"], case["column"]] = (1.0, 2.0, 3.0)
    environment = environment_from_array(image).rotated(case["rotate_deg"])
    direction = np.array([case["direction"]])
    np.testing.assert_allclose(environment.lookup(direction), [[1.0, 2.0, 3.0]], rtol=1e-5)
    assert np.abs(environment.lookup(-direction)).max() == 0.0
    for lobe in range(1 + len(LOBE_ALPHAS)):
        axes = np.broadcast_to(direction, (500, 3))
        drawn = LightSampler(environment).sample(*np.random.default_rng(1).random((2, 500)), axes, lobe)
        assert normalise(drawn.mean(axis=0)) @ direction[0] > 0.97


def test_directions_and_pixels_are_inverse_to_each_other():
    directions = normalise(np.random.default_rng(0).normal(size=(2000, 3)))
    np.testing.assert_allclose(directions_of_uv(*uv_of_directions(directions)), directions, atol=1e-12)
    u, v = uv_of_directions(pixel_directions(5, 10))
    np.testing.assert_allclose(u[2], (np.arange(10) + 0.5) / 10, atol=1e-12)
    np.testing.assert_allclose(v[:, 3], (np.arange(5) + 0.5) / 5, atol=1e-12)


def test_solid_angles_of_a_map_add_up_to_the_sphere():
    assert pixel_solid_angles(7, 12).sum() * 12 == pytest.approx(4 * np.pi, rel=1e-12)


def test_lookup_at_a_pixel_centre_is_that_pixel_and_wraps_around_behind_minus_x():
    image = random_map(6, 12)
    environment = environment_from_array(image)
    np.testing.assert_allclose(environment.lookup(pixel_directions(6, 12)), image, rtol=1e-5)
    v = np.full(1, 2.5 / 6)
    seam = environment.lookup(directions_of_uv(np.zeros(1), v))
    np.testing.assert_allclose(seam[0], (image[2, 0] + image[2, -1]) / 2, rtol=1e-5)


def test_turning_by_whole_pixels_is_rolling_the_map():
    image = random_map(8, 16)
    turned = environment_from_array(image).rotated(90.0)
    rolled = environment_from_array(np.roll(image, -4, axis=1))
    directions = normalise(np.random.default_rng(2).normal(size=(500, 3)))
    np.testing.assert_allclose(turned.lookup(directions), rolled.lookup(directions), rtol=1e-4, atol=1e-5)


def test_light_from_plus_x_comes_from_plus_y_after_a_quarter_turn():
    x_axis = np.array([[1.0, 0.0, 0.0]])
    np.testing.assert_allclose(rotate_about_z(x_axis, 90.0), [[0.0, 1.0, 0.0]], atol=1e-12)
    image = np.zeros((8, 16, 3), np.float32)
    image[3:5, 7:9] = 1.0
    assert environment_from_array(image).rotated(90.0).lookup(np.array([[0.0, 1.0, 0.0]]))[
        0, 0
    ] == pytest.approx(1.0)


AXES = normalise(np.random.default_rng(8).normal(size=(3, 3)))


@pytest.mark.parametrize("lobe", range(1 + len(LOBE_ALPHAS)))
@pytest.mark.parametrize(("height", "width", "rotate_deg"), [(8, 16, 0.0), (8, 16, 37.0), (50, 90, 0.0)])
def test_importance_sampling_integrates_any_function_of_direction(height, width, rotate_deg, lobe):
    environment = environment_from_array(random_map(height, width)).rotated(rotate_deg)
    sampler = LightSampler(environment)
    axis = AXES[lobe % 3]
    axes = np.broadcast_to(axis, (30000, 3))
    directions = sampler.sample(*np.random.default_rng(3).random((2, 30000)), axes, lobe)
    density = sampler.pdf(directions, axes, lobe)
    # A function that the lobe fits, so that its tails do not drown the test in variance.
    sharpness = 0.5 if lobe == 0 else 0.7 / LOBE_ALPHAS[lobe - 1] ** 2

    def function(d):
        return (
            environment.lookup(d)
            * np.exp(sharpness * (d @ axis - 1.0))[..., None]
            * ((d @ axis) > 0)[..., None]
        )

    fine = (height * 16, width * 16) if height < 20 else (height * 5, width * 5)
    grid = directions_of_uv(
        *np.meshgrid((np.arange(fine[1]) + 0.5) / fine[1], (np.arange(fine[0]) + 0.5) / fine[0])
    )
    expected = (function(grid) * pixel_solid_angles(*fine)[:, None, None]).sum(axis=(0, 1))
    assert_mean(function(directions) / density, expected, expected_error=2e-3 * expected.max())


def test_directions_inside_a_pixel_are_even_in_solid_angle():
    sampler = LightSampler(environment_from_array(np.ones((2, 4, 3))))
    axes = np.broadcast_to(AXES[0], (8000, 3))
    z = sampler.sample(*np.random.default_rng(3).random((2, 8000)), axes, 0)[:, 2]
    assert_mean(z[z > 0.0], 0.5)
    assert_mean(z[z < 0.0], -0.5)


@pytest.mark.parametrize("shape", [(8, 16), (30, 70), (64, 128)])
def test_density_of_the_light_sampler_integrates_to_one_and_is_positive_wherever_light_is(shape):
    image = np.zeros((*shape, 3), np.float32)
    image[3, 5] = 100.0
    environment = environment_from_array(image)
    sampler = LightSampler(environment)
    grid = 24
    v, u = np.meshgrid(
        (np.arange(shape[0] * grid) + 0.5) / (shape[0] * grid),
        (np.arange(shape[1] * grid) + 0.5) / (shape[1] * grid),
        indexing="ij",
    )
    rows = slice(0, 8 * grid)
    columns = slice(0, 10 * grid)
    directions = directions_of_uv(u[rows, columns].ravel(), v[rows, columns].ravel())
    measure = np.repeat(pixel_solid_angles(*u.shape)[rows], 10 * grid)
    for lobe in range(1 + len(LOBE_ALPHAS)):
        density = sampler.pdf(directions, np.broadcast_to(AXES[0], directions.shape), lobe)[:, 0]
        assert (density * measure).sum() == pytest.approx(1.0, rel=1e-4)
        lit = environment.lookup(directions).max(axis=-1) > 0.0
        assert lit.any()
        assert (density[lit] > 0.0).all()


def test_a_map_above_the_table_size_is_sampled_by_blocks_of_pixels():
    image = np.full((1024, 2048, 3), 0.1, np.float32)
    image[300:310, 500:520] = 50.0
    environment = environment_from_array(image)
    sampler = LightSampler(environment)
    axes = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (20000, 3))
    directions = sampler.sample(*np.random.default_rng(0).random((2, 20000)), axes, 1)
    density = sampler.pdf(directions, axes, 1)
    measure = pixel_solid_angles(1024, 2048)[:, None, None]
    expected = (image.astype(np.float64) * measure).sum(axis=(0, 1))
    assert_mean(environment.lookup(directions) / density, expected, expected_error=1e-3 * expected.max())


def test_a_black_map_is_sampled_evenly_instead_of_dividing_by_zero():
    sampler = LightSampler(environment_from_array(np.zeros((16, 32, 3))))
    axes = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (2000, 3))
    directions = sampler.sample(*np.random.default_rng(5).random((2, 2000)), axes, 1)
    assert np.isfinite(directions).all()
    assert_mean(1.0 / sampler.pdf(directions, axes, 1), np.full(1, 4.0 * np.pi), expected_error=1e-3)


@pytest.mark.parametrize("lobe", range(5))
def test_the_mean_under_a_lobe_is_that_of_the_map(lobe):
    axis = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [-0.6, 0.0, 0.8]])
    even = LightSampler(environment_from_array(np.full((64, 128, 3), 7.0)))
    np.testing.assert_allclose(even.mean(axis, lobe), 1.0 / (4.0 * np.pi), rtol=0.05)
    # Light from one half of the sphere: all of it, half of it, and none.
    half = environment_from_array(np.ones((64, 128, 1)) * (np.arange(64) < 32)[:, None, None] * np.ones(3))
    above, aside, below = LightSampler(half).mean(np.array([[0, 0, 1.0], [1.0, 0, 0], [0, 0, -1.0]]), lobe)
    assert above > aside > below
    if lobe:
        sharpness = 0.84 / LOBE_ALPHAS[lobe - 1] ** 2
        share = 1.0 / (1.0 + np.exp(-sharpness))
        np.testing.assert_allclose(
            [above, below], np.array([share, 1.0 - share]) / (2.0 * np.pi), rtol=0.1, atol=2e-3
        )


def test_the_lobe_of_a_width_is_the_nearest_one():
    widths = np.array([[1.0], [0.6], [0.45], [0.2], [0.13], [0.01]])
    assert lobe_of_alpha(widths).tolist() == [1, 2, 2, 3, 4, 4]


@pytest.mark.parametrize("coded", [True, False])
def test_radiance_files_are_read_coded_and_flat(tmp_path, coded):
    image = random_map(6, 128)
    image[2] = 0.5
    pixels = rgbe_rows(image)
    path = tmp_path / "sky.hdr"
    path.write_bytes(hdr_bytes(pixels, header=b"EXPOSURE=2\nEXPOSURE= 0.5\n", coded=coded))
    environment = load_environment(path, layout="latlong")
    assert np.abs(environment.radiance - image).max() <= image.max() / 128
    np.testing.assert_array_equal(environment.radiance[2], np.float32(0.5))
    path.write_bytes(hdr_bytes(pixels, header=b"EXPOSURE=4\n", coded=coded))
    np.testing.assert_allclose(load_environment(path, layout="latlong").radiance * 4.0, environment.radiance)


def test_old_repeats_in_radiance_files_are_followed(tmp_path):
    pixels = np.array(
        [[10, 20, 30, 130], [1, 1, 1, 4], [50, 60, 70, 129], [1, 1, 1, 2], [1, 1, 1, 1]], np.uint8
    )
    path = tmp_path / "old.hdr"
    path.write_bytes(b"#?RADIANCE\n\n-Y 2 +X 132\n" + pixels.tobytes())
    row = load_environment(path, layout="latlong").radiance.reshape(-1, 3)
    np.testing.assert_allclose(row[:5], np.tile([[10, 20, 30]], (5, 1)) * 2.0**-6)
    np.testing.assert_allclose(row[5:], np.tile([[50, 60, 70]], (259, 1)) * 2.0**-7)


def test_flipped_radiance_scan_orders_are_turned_upright(tmp_path):
    image = random_map(4, 6)
    data = hdr_bytes(rgbe_rows(image), coded=False)
    path = tmp_path / "sky.hdr"
    path.write_bytes(data)
    upright = load_environment(path, layout="latlong").radiance
    path.write_bytes(data.replace(b"-Y 4 +X 6", b"+Y 4 -X 6"))
    np.testing.assert_array_equal(load_environment(path, layout="latlong").radiance, upright[::-1, ::-1])


@pytest.mark.parametrize("half", [True, False])
def test_an_environment_survives_being_written_and_read(tmp_path, half):
    image = random_map(4, 8)
    write_environment(tmp_path / "sky.exr", image, half=half)
    loaded = load_environment(tmp_path / "sky.exr")
    np.testing.assert_allclose(loaded.radiance, image, rtol=1e-3 if half else 0, atol=1e-6 if half else 0)
    assert not loaded.cleaning


def test_too_bright_values_are_clamped_to_what_half_floats_hold(tmp_path):
    write_environment(tmp_path / "sun.exr", np.full((2, 4, 3), 1e6))
    np.testing.assert_array_equal(load_environment(tmp_path / "sun.exr").radiance, 65504.0)


def test_the_part_with_colour_is_read_from_a_file_of_several_parts(tmp_path):
    image = random_map(4, 8)
    depth = OpenEXR.Part({}, {"Z": np.zeros((4, 8), np.float32)}, "depth")
    names = {name: np.ascontiguousarray(image[..., i]) for i, name in enumerate("RGB")}
    colour = OpenEXR.Part({}, names | {"A": np.ones((4, 8), np.float32)}, "colour")
    OpenEXR.File([depth, colour]).write(str(tmp_path / "parts.exr"))
    np.testing.assert_array_equal(load_environment(tmp_path / "parts.exr").radiance, image)


def test_the_parts_of_a_file_are_judged_together_before_any_is_decoded(tmp_path):
    zeros = np.zeros((512, 1024), np.float32)
    parts = [OpenEXR.Part({}, {"Z": zeros}, str(number)) for number in range(16)]
    colour = OpenEXR.Part({}, dict.fromkeys("RGB", zeros), "colour")
    OpenEXR.File([*parts, colour]).write(str(tmp_path / "parts.exr"))
    tracemalloc.start()
    with pytest.raises(EnvironmentFileError, match=r"environment\.too_large.*in all its channels"):
        load_environment(tmp_path / "parts.exr", max_file_pixels=2**19)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def spoilt(change):
    """Return what writes a small file of colours, changed byte by byte."""

    def write(path):
        write_exr(path, {name: np.ones((2, 4)) for name in "RGB"})
        path.write_bytes(change(path.read_bytes()))

    return write


def holding(data):
    return lambda path: path.write_bytes(data)


WINDOW = struct.pack("<4i", 0, 0, 3, 1)
HUGE, WIDER = struct.pack("<4i", 0, 0, 99_999, 99_999), struct.pack("<4i", 0, 0, 7, 3)


def show_more_than_is_stored(data):
    start = data.index(b"displayWindow")
    return data[:start] + data[start:].replace(WINDOW, WIDER, 1)


def make_red_green(data):
    return data.replace(struct.pack("<2f", 0.64, 0.33), struct.pack("<2f", 0.30, 0.60))


def write_integers(path):
    OpenEXR.File({}, {name: np.ones((2, 4), np.uint32) for name in "RGB"}).write(str(path))


def write_deep(path):
    samples = np.empty((2, 4), dtype=object)
    for place in np.ndindex(2, 4):
        samples[place] = np.ones(2, np.float32)
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    OpenEXR.File(header, {name: samples.copy() for name in "RGB"}).write(str(path))


@pytest.mark.parametrize(
    ("code", "name", "write"),
    [
        ("exr_deep", "a.exr", write_deep),
        ("exr_channels", "a.exr", lambda path: write_exr(path, dict.fromkeys("XY", np.ones((2, 4))))),
        ("exr_channels", "a.exr", write_integers),
        ("exr_damaged", "a.exr", holding(b"v/1\x01" + bytes(64))),
        ("exr_damaged", "a.exr", spoilt(lambda data: data[: len(data) // 2])),
        ("too_large", "a.exr", spoilt(lambda data: data.replace(WINDOW, HUGE))),
        ("exr_cropped", "a.exr", spoilt(show_more_than_is_stored)),
        ("exr_primaries", "a.exr", spoilt(make_red_green)),
        ("hdr_damaged", "a.hdr", holding(b"GIF89a")),
        ("hdr_damaged", "a.hdr", holding(b"#?RGBE\n\n-Y 4 +X 8\n" + bytes(20))),
        ("hdr_damaged", "a.hdr", holding(hdr_bytes(rgbe_rows(random_map(4, 64)))[:-40])),
        ("hdr_damaged", "a.hdr", holding(b"#?RGBE\n\n-Y 4 +X 8\n" + b"\1\1\1\7" * 9)),
        ("hdr_format", "a.hdr", holding(b"#?RGBE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n")),
        ("too_large", "a.hdr", holding(b"#?RGBE\n\n-Y 999999 +X 999999\n\2\2\1\1")),
        ("unknown_format", "a.png", holding(b"")),
        ("no_values", "a.exr", lambda path: write_environment(path, np.full((2, 4, 3), np.nan))),
    ],
)
def test_a_map_that_cannot_be_used_is_refused_with_a_reason_and_advice(tmp_path, code, name, write):
    write(tmp_path / name)
    with pytest.raises(EnvironmentFileError) as caught:
        load_environment(tmp_path / name)
    assert caught.value.code == f"environment.{code}"
    assert name in str(caught.value)
    assert caught.value.advice


def test_a_missing_file_and_a_wrong_shape_are_named(tmp_path):
    with pytest.raises(EnvironmentFileError, match=r"environment\.missing"):
        load_environment(tmp_path / "none.exr")
    with pytest.raises(EnvironmentFileError, match=r"environment\.shape"):
        environment_from_array(np.zeros((4, 8)))
