"""Coverage of a picture by the object: alpha, mask file, or both."""

import numpy as np
import pytest
from lambent_capture.pictures.coverage import (
    fits,
    frame_coverage,
    has_coverage,
    photograph_mask,
    small_coverage,
)
from lambent_capture.pictures.exif import exif_facts
from lambent_capture.pictures.mask_levels import write_mask
from lambent_capture.pictures.picture import turned
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import picture_size, read_picture
from lambent_proto.v1 import scene_pb2
from PIL import Image
from support.captures import save

LEVEL = np.tile(np.arange(0, 240, 20, dtype=np.uint8), (12, 1))


def frame(mask="", picture="a.png"):
    camera = scene_pb2.Camera(width=12, height=12, focal_x=10.0, focal_y=10.0, centre_x=6.0, centre_y=6.0)
    return scene_pb2.Frame(images=[scene_pb2.Image(path=picture)], mask=mask, camera=camera)


@pytest.fixture
def folder(tmp_path):
    rgb = np.full((12, 12, 3), 90, dtype=np.uint8)
    save(tmp_path / "opaque.png", rgb)
    save(tmp_path / "a.png", np.dstack([rgb, LEVEL]))
    save(tmp_path / "mask.png", LEVEL.T.copy())
    return tmp_path


def test_a_picture_without_alpha_or_mask_says_nothing(folder):
    assert not has_coverage(folder, frame(picture="opaque.png"))
    assert frame_coverage(folder, frame(picture="opaque.png")) is None
    assert small_coverage(folder, frame(picture="opaque.png"), 6) is None


def test_alpha_is_coverage(folder):
    assert has_coverage(folder, frame())
    np.testing.assert_allclose(frame_coverage(folder, frame()), LEVEL / 255.0, atol=1e-6)


def test_a_mask_file_covers_an_opaque_picture(folder):
    assert has_coverage(folder, frame("mask.png", "opaque.png"))
    np.testing.assert_allclose(
        frame_coverage(folder, frame("mask.png", "opaque.png")), LEVEL.T / 255.0, atol=1e-6
    )


def test_of_alpha_and_mask_the_smaller_holds(folder):
    expected = np.minimum(LEVEL, LEVEL.T) / 255.0
    np.testing.assert_allclose(frame_coverage(folder, frame("mask.png")), expected, atol=1e-6)


def test_a_small_coverage_is_the_mean_over_each_new_pixel(folder):
    expected = (LEVEL / 255.0).reshape(6, 2, 6, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(small_coverage(folder, frame(), 6), expected, atol=1e-6)


def test_a_mask_that_is_no_picture_is_refused(folder):
    (folder / "mask.png").write_text("no")
    with pytest.raises(PictureError):
        frame_coverage(folder, frame("mask.png"))


# ---- orientation -----------------------------------------------------------------------------------------

ORIENTATION = 0x0112
ROWS, COLUMNS = np.mgrid[:40, :56]
THING = ((ROWS - 12) ** 2 + (COLUMNS - 38) ** 2 < 90) | ((abs(ROWS - 30) < 5) & (abs(COLUMNS - 12) < 8))
"""No turn and no mirroring brings it to itself."""


def upside(orientation, upright):
    """Return the pixels that a file with an EXIF orientation stores of what people are to see."""
    stored = {
        1: lambda v: v,
        2: np.fliplr,
        3: lambda v: np.rot90(v, 2),
        4: np.flipud,
        5: lambda v: np.swapaxes(v, 0, 1),
        6: lambda v: np.rot90(v, 1),
        7: lambda v: np.rot90(np.swapaxes(v, 0, 1), 2),
        8: lambda v: np.rot90(v, -1),
    }
    return np.ascontiguousarray(stored[orientation](upright))


def taken(path, orientation, upright):
    """Write a photograph of `upright` as a camera held that way would store it."""
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    Image.fromarray(upside(orientation, upright)).save(path, exif=exif)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("painted", ["upright", "tagged like the photograph", "on the rows of the file"])
@pytest.mark.parametrize("square", [False, True])
def test_a_mask_lies_on_its_photograph_however_both_are_turned(tmp_path, orientation, painted, square):
    thing = THING[:, 4:44] if square else THING
    shown = np.where(thing[..., None], (200, 120, 40), (30, 60, 90)).astype(np.uint8)
    taken(tmp_path / "p.png", orientation, shown)
    mask = np.where(thing, 255, 0).astype(np.uint8)
    if painted == "upright":
        Image.fromarray(mask).save(tmp_path / "m.png")
    elif painted == "tagged like the photograph":
        taken(tmp_path / "m.png", orientation, mask)
    else:
        Image.fromarray(upside(orientation, mask)).save(tmp_path / "m.png")
    found = photograph_mask(tmp_path / "m.png", tmp_path / "p.png").coverage
    seen = read_picture(tmp_path / "p.png").levels[..., 0] == 200
    np.testing.assert_array_equal(found, seen)
    # What is left of the orientation is a turn: the picture is never a mirror image of the scene.
    facts = exif_facts(tmp_path / "p.png")
    assert facts.orientation in (1, 3, 6, 8)
    np.testing.assert_array_equal(turned(found, facts.orientation), thing)


def test_a_mask_that_fits_no_way_is_refused_with_both_ways(tmp_path):
    rng = np.random.default_rng(2)
    taken(tmp_path / "p.png", 3, rng.integers(0, 255, (40, 56, 3), dtype=np.uint8))
    Image.fromarray(np.where(THING, 255, 0).astype(np.uint8)).save(tmp_path / "m.png")
    with pytest.raises(PictureError, match="EXIF orientation") as caught:
        photograph_mask(tmp_path / "m.png", tmp_path / "p.png")
    assert caught.value.code == "scene.mask_orientation"


def test_a_mask_of_ours_is_taken_as_it_is(tmp_path):
    rng = np.random.default_rng(2)
    taken(tmp_path / "p.png", 3, rng.integers(0, 255, (40, 56, 3), dtype=np.uint8))
    write_mask(tmp_path / "m.png", THING.astype(np.float32))
    np.testing.assert_array_equal(photograph_mask(tmp_path / "m.png", tmp_path / "p.png").coverage, THING)


def test_a_mask_of_another_size_stays_as_it_is(tmp_path):
    taken(tmp_path / "p.png", 6, np.zeros((40, 56, 3), dtype=np.uint8))
    Image.fromarray(np.where(THING, 255, 0).astype(np.uint8)[:30]).save(tmp_path / "m.png")
    assert photograph_mask(tmp_path / "m.png", tmp_path / "p.png").coverage.shape == (30, 56)


def test_a_mask_fits_as_stored_and_as_seen_and_no_other_way(tmp_path):
    for orientation, expected in ((1, False), (3, False), (6, True), (8, True)):
        taken(tmp_path / "p.png", orientation, np.zeros((40, 56, 3), dtype=np.uint8))
        width, height = picture_size(tmp_path / "p.png")
        Image.new("L", (height, width)).save(tmp_path / "turned.png")
        Image.new("L", (width, height)).save(tmp_path / "same.png")
        assert fits(tmp_path / "turned.png", tmp_path / "p.png") == expected
        assert fits(tmp_path / "same.png", tmp_path / "p.png")
    Image.new("L", (30, 30)).save(tmp_path / "other.png")
    assert not fits(tmp_path / "other.png", tmp_path / "p.png")
