"""EXIF tells lens, zoom and where up was; what it says wrongly does no harm."""

import numpy as np
import pytest
from lambent_capture.poses.shots import read_shot
from PIL import Image, ImageOps
from PIL.TiffImagePlugin import IFDRational

FOCAL_MM, FOCAL_35MM, ORIENTATION = 0x920A, 0xA405, 0x0112


def photograph(path, size=(80, 60), main=None, **tags):
    """Write a JPEG with EXIF: `main` are tags of the picture, `tags` (as `_0x920A`) those of the camera."""
    exif = Image.Exif()
    exif.update(main or {})
    exif.get_ifd(0x8769).update({int(name.lstrip("_"), 16): value for name, value in tags.items()})
    Image.new("RGB", size).save(path, exif=exif)
    return read_shot(path)


def test_the_focal_length_compares_diagonals(tmp_path):
    shot = photograph(tmp_path / "a.jpg", (4000, 3000), _0xA405=26)
    assert shot.focal_px == pytest.approx(26.0 / np.hypot(36.0, 24.0) * 5000.0, rel=1e-4)
    assert photograph(tmp_path / "b.jpg", (3000, 4000), _0xA405=26).focal_px == shot.focal_px


def test_the_sensor_tells_the_focal_length_where_the_equivalent_is_missing(tmp_path):
    # 100 pixels per millimetre when taken with 800 pixels; the file has half of them.
    tags = {"_0x920A": 8.0, "_0xA20E": IFDRational(1000, 1), "_0xA210": 3, "_0xA002": 800, "_0xA003": 600}
    assert photograph(tmp_path / "a.jpg", (400, 300), **tags).focal_px == pytest.approx(400.0)
    del tags["_0xA20E"]
    assert photograph(tmp_path / "b.jpg", (400, 300), **tags).focal_px == 0.0


def test_portrait_and_landscape_share_a_lens_but_not_zooms_sizes_or_devices(tmp_path):
    plain = photograph(tmp_path / "a.jpg", main={0x0110: "Phone 3"}, _0x920A=5.7)
    assert photograph(tmp_path / "b.jpg", (60, 80), {0x0110: "Phone 3"}, _0x920A=5.7).lens == plain.lens
    others = [
        photograph(tmp_path / "c.jpg", main={0x0110: "Phone 3"}, _0x920A=9.0),
        photograph(tmp_path / "d.jpg", (80, 62), {0x0110: "Phone 3"}, _0x920A=5.7),
        photograph(tmp_path / "e.jpg", main={0x0110: "Phone 4"}, _0x920A=5.7),
        photograph(tmp_path / "f.jpg"),
    ]
    assert len({shot.lens for shot in (plain, *others)}) == 5


@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (6, 3), (3, 2), (8, 1), (0, 0), (99, 0)])
def test_orientation_tells_where_up_was_and_turns_nothing(tmp_path, orientation, turns):
    shot = photograph(tmp_path / "a.jpg", (80, 60), {ORIENTATION: orientation})
    assert (shot.width, shot.height) == (80, 60)
    assert shot.up_turns == turns


def test_up_is_where_a_viewer_that_obeys_orientation_shows_the_upper_side(tmp_path):
    for orientation in range(1, 9):
        stored = np.zeros((60, 80), np.uint8)
        shot = photograph(tmp_path / "a.jpg", (80, 60), {ORIENTATION: orientation})
        # Marks the side of the stored picture that `up_turns` names: 0 upper, 1 right, 2 lower, 3 left.
        # Mirror images are read mirrored back, so of these it is the side of the picture as it is read.
        read = stored[:, ::-1] if orientation in (2, 4, 5, 7) else stored
        side = [read[:10], read[:, -10:], read[-10:], read[:, :10]][shot.up_turns]
        side[:] = 255
        exif = Image.Exif()
        exif[ORIENTATION] = orientation
        Image.fromarray(stored).save(tmp_path / "marked.png", exif=exif)
        with Image.open(tmp_path / "marked.png") as picture:
            shown = np.asarray(ImageOps.exif_transpose(picture))
        assert shown[:10].min() == 255, orientation


def test_impossible_exif_says_nothing(tmp_path):
    assert photograph(tmp_path / "b.jpg", _0xA405=60000).focal_px == 0.0
    assert photograph(tmp_path / "c.jpg", _0xA405=1).focal_px == 0.0
    Image.new("RGB", (80, 60)).save(tmp_path / "d.png")
    assert read_shot(tmp_path / "d.png").focal_px == 0.0
