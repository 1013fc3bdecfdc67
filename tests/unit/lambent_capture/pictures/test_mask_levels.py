"""A mask means what its author meant, or is refused."""

import numpy as np
import pytest
from lambent_capture.pictures.exr_pictures import LEAST_ALPHA
from lambent_capture.pictures.mask_levels import read_mask, write_mask
from lambent_capture.pictures.picture_error import PictureError
from PIL import Image
from strangers.profiles import chunk, png

DISC = np.hypot(*(np.mgrid[:24, :32] - np.array([11.5, 15.5])[:, None, None])) < 7.0


def levels_of(values, dtype=np.uint8):
    return np.asarray(values, dtype=dtype)


def written(tmp_path, values, name="m.png", **options):
    Image.fromarray(np.asarray(values)).save(tmp_path / name, **options)
    return tmp_path / name


@pytest.mark.parametrize("pair", [(0, 255), (0, 1), (0, 128), (1, 2), (10, 245)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_two_levels_are_background_and_object(tmp_path, pair, dtype):
    path = written(tmp_path, np.where(DISC, pair[1], pair[0]).astype(dtype))
    np.testing.assert_array_equal(read_mask(path).coverage, DISC)


def test_soft_edges_are_kept(tmp_path):
    soft = np.linspace(0.0, 1.0, 32)[None] * DISC
    path = written(tmp_path, np.round(255 * soft).astype(np.uint8))
    np.testing.assert_allclose(read_mask(path).coverage, soft, atol=0.002)
    path = written(tmp_path, np.round(65535 * soft).astype(np.uint16))
    np.testing.assert_allclose(read_mask(path).coverage, soft, atol=1e-5)


@pytest.mark.parametrize("full", [255, 1023, 4095])
def test_16_bits_may_hold_fewer(tmp_path, full):
    soft = np.linspace(0.0, 1.0, 32)[None] * np.ones((24, 1))
    path = written(tmp_path, np.round(full * soft).astype(np.uint16))
    np.testing.assert_allclose(read_mask(path).coverage, soft, atol=0.003)


@pytest.mark.parametrize("depth", [2, 4])
def test_labels_of_few_bits_are_objects_and_a_whole_scale_is_grey(tmp_path, depth):
    labels = np.where(DISC, 1 + (np.arange(32)[None] > 15), 0)[..., None]
    (tmp_path / "m.png").write_bytes(png(labels, bits=depth))
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png").coverage, DISC)
    full = 2**depth - 1
    grey = np.where(DISC, 1 + (full - 1) * (np.arange(32)[None] > 15), 0)[..., None]
    (tmp_path / "g.png").write_bytes(png(grey, bits=depth))
    np.testing.assert_allclose(read_mask(tmp_path / "g.png").coverage, grey[..., 0] / full, atol=1e-6)


@pytest.mark.parametrize(
    "palette",
    [
        [0, 0, 0, 128, 0, 0, 0, 128, 0],
        [255, 255, 255, 20, 20, 200, 200, 0, 0],
        [0, 0, 0, 1, 1, 1, 2, 2, 2],
    ],
)
def test_colours_of_a_palette_are_labels(tmp_path, palette):
    image = Image.fromarray(np.where(DISC, 1 + (np.arange(32)[None] > 15), 0).astype(np.uint8))
    image = image.convert("P")
    image.putpalette(palette)
    image.save(tmp_path / "m.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png").coverage, DISC)


@pytest.mark.parametrize("colour", [(128, 0, 0), (0, 255, 0), (255, 255, 255)])
def test_an_object_in_one_colour_on_black_is_an_object(tmp_path, colour):
    soft = np.clip(8.0 - np.hypot(*(np.mgrid[:24, :32] - np.array([11.5, 15.5])[:, None, None])), 0.0, 1.0)
    path = written(tmp_path, np.round(soft[..., None] * colour).astype(np.uint8))
    np.testing.assert_allclose(read_mask(path).coverage, soft, atol=0.01)


def test_a_few_colours_on_a_background_are_objects(tmp_path):
    colours = np.full((24, 32, 3), (250, 250, 255), dtype=np.uint8)
    colours[DISC] = (200, 30, 30)
    colours[DISC & (np.arange(32)[None] > 15)] = (30, 30, 200)
    np.testing.assert_array_equal(read_mask(written(tmp_path, colours)).coverage, DISC)


def test_alpha_counts_where_it_leaves_something_out(tmp_path):
    rgba = np.dstack([np.full((24, 32, 3), 90, dtype=np.uint8), np.where(DISC, 255, 0).astype(np.uint8)])
    np.testing.assert_array_equal(read_mask(written(tmp_path, rgba)).coverage, DISC)
    grey = np.dstack([np.where(DISC, 255, 0).astype(np.uint8)] * 3 + [np.full((24, 32), 255, dtype=np.uint8)])
    np.testing.assert_array_equal(read_mask(written(tmp_path, grey)).coverage, DISC)


def test_a_colour_key_leaves_its_level_out(tmp_path):
    (tmp_path / "m.png").write_bytes(
        png(np.where(DISC, 90, 7)[..., None], chunk(b"tRNS", (7).to_bytes(2, "big")), bits=8)
    )
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png").coverage, DISC)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_mask_that_is_white_all_around_is_inverted(tmp_path, dtype):
    mask = read_mask(written(tmp_path, np.where(DISC, 0, np.iinfo(dtype).max).astype(dtype)))
    assert mask.is_inverted
    np.testing.assert_array_equal(mask.coverage, DISC)


def test_an_object_that_leaves_the_picture_is_no_reason_to_invert(tmp_path):
    half = np.zeros((24, 32), dtype=np.uint8)
    half[:, 6:] = 255
    mask = read_mask(written(tmp_path, half))
    assert not mask.is_inverted
    np.testing.assert_array_equal(mask.coverage, half > 0)


def test_black_is_empty_and_one_level_is_everything(tmp_path):
    assert not read_mask(written(tmp_path, np.zeros((24, 32), dtype=np.uint8))).coverage.any()
    assert read_mask(written(tmp_path, np.full((24, 32), 255, dtype=np.uint8))).coverage.all()


def test_a_mask_in_floats_is_read_like_one_in_integers(tmp_path):
    from lambent_core.exr import write_exr

    for full in (1.0, 255.0):
        write_exr(tmp_path / "m.exr", {"Y": np.where(DISC, full, 0.0)})
        np.testing.assert_array_equal(read_mask(tmp_path / "m.exr").coverage, DISC)
    assert LEAST_ALPHA < 0.01


@pytest.mark.parametrize(
    ("values", "name"),
    [
        (np.linspace(0, 90, 32)[None] * np.ones((24, 1)), "m.png"),
        (np.where(DISC, 1.0, 0.0), "m.jpg"),
        (np.linspace(0, 9000, 32)[None] * np.ones((24, 1)), "m16.png"),
    ],
)
def test_levels_that_could_mean_anything_are_refused(tmp_path, values, name):
    path = written(tmp_path, values.astype(np.uint16 if "16" in name else np.uint8), name)
    with pytest.raises(PictureError, match="brightest level") as caught:
        read_mask(path)
    assert caught.value.code == "scene.mask_levels"


def test_a_photograph_is_no_mask(tmp_path):
    noise = np.random.default_rng(1).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    for name in ("m.png", "m.jpg"):
        with pytest.raises(PictureError, match="colour"):
            read_mask(written(tmp_path, noise, name))


def test_a_mask_that_we_write_says_that_it_is_as_stored(tmp_path):
    write_mask(tmp_path / "a" / "m.png", DISC.astype(np.float32))
    mask = read_mask(tmp_path / "a" / "m.png")
    assert mask.is_as_stored
    np.testing.assert_array_equal(mask.coverage, DISC)
    assert not read_mask(written(tmp_path, 255 * DISC.astype(np.uint8))).is_as_stored
