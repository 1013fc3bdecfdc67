"""Points are found where they are in the stored picture, whatever it was reduced or cropped to."""

import numpy as np
import pytest
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.poses.features import Features, covered_box, find_features, grey_picture, work_scale
from PIL import Image
from support.captures import save

WIDTH, HEIGHT = 1201, 903


def spotted(width, height, places, sigma):
    """Return a grey picture with a soft spot at each place (x, y), a pixel's middle being at 0.5."""
    picture = np.full((height, width), 60.0)
    rows, columns = np.mgrid[:height, :width] + 0.5
    for number, (x, y) in enumerate(places):
        near = (abs(columns - x) < 5 * sigma) & (abs(rows - y) < 5 * sigma)
        squares = (columns[near] - x) ** 2 + 1.6 * (rows[near] - y) ** 2
        picture[near] += (80.0 + number) * np.exp(-0.5 * squares / sigma**2)
    return np.round(picture).astype(np.uint8)


GRID = np.stack(np.meshgrid(np.arange(8), np.arange(6)), axis=-1).reshape(-1, 2)
PLACES = 140.0 * GRID + 90.0 + np.random.default_rng(0).uniform(0.0, 20.0, GRID.shape)


def nearest(features, places):
    """Return the distance of each place to the nearest point; SIFT misses a spot now and then."""
    return np.linalg.norm(features.points[None, :, :2] - places[:, None], axis=-1).min(axis=1)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
@pytest.mark.parametrize("max_side", [300, 525])
def test_points_are_where_the_spots_are(tmp_path, suffix, max_side):
    path = tmp_path / f"picture{suffix}"
    save(path, spotted(WIDTH, HEIGHT, PLACES, 9.0))
    found = find_features(path, max_side, 500)
    scale = work_scale(WIDTH, HEIGHT, max_side)
    assert scale == min(1.0, max_side / WIDTH)
    assert np.quantile(nearest(found, scale * PLACES), 0.85) < 0.1


def test_large_photographs_of_a_jpeg_are_decoded_at_a_part_of_their_size(tmp_path, monkeypatch):
    path = tmp_path / "large.jpg"
    save(path, spotted(WIDTH, HEIGHT, PLACES, 9.0))
    decoded = []
    convert = Image.Image.convert

    def watched(self, mode):
        decoded.append(self.size)
        return convert(self, mode)

    monkeypatch.setattr(Image.Image, "convert", watched)
    grey, scale = grey_picture(path, (0, 0, WIDTH, HEIGHT), 300)
    assert decoded == [(301, 226)]
    assert grey.shape == (226, 300)
    assert scale == 300 / WIDTH


def test_a_mask_keeps_its_points_and_shows_them_larger(tmp_path):
    path = tmp_path / "small_object.png"
    places = np.array([[700.3, 600.2], [760.7, 640.1], [730.1, 560.3], [100.3, 100.7]])
    save(path, spotted(WIDTH, HEIGHT, places, 3.4))
    covered = np.zeros((HEIGHT, WIDTH), bool)
    covered[500:700, 650:820] = True
    scale = work_scale(WIDTH, HEIGHT, 300)
    found = find_features(path, 300, 500, covered)
    # The spots are less than a pixel wide at 300 pixels, yet found to a tenth of one.
    assert nearest(found, scale * places[:3]).max() < 0.1
    assert nearest(found, scale * places[3:]).min() > 50.0


def test_the_box_of_a_mask_stays_in_the_picture():
    covered = np.zeros((100, 200), bool)
    covered[0:50, 150:200] = True
    left, upper, right, lower = covered_box(covered)
    assert (upper, right) == (0, 200)
    assert 130 < left < 150
    assert 50 < lower < 70
    assert covered_box(np.zeros((4, 4), bool)) is None


def test_the_clearest_points_come_first_and_no_more_than_asked_for(tmp_path):
    path = tmp_path / "noise.png"
    save(path, np.random.default_rng(0).integers(0, 256, (300, 300), dtype=np.uint8))
    all_of_them, few = find_features(path, 300, 5000), find_features(path, 300, 50)
    assert len(all_of_them) > 200
    assert len(few) == 50
    # Points with two directions are equally clear.
    assert np.array_equal(few.points[:40, :2], all_of_them.points[:40, :2])
    assert few.descriptors.dtype == np.uint8


def test_deep_and_linear_pictures_are_read(tmp_path):
    spots = spotted(400, 300, PLACES / 3.0, 3.2)
    Image.fromarray(spots.astype(np.uint16) * 257).save(tmp_path / "deep.png")
    found = find_features(tmp_path / "deep.png", 400, 100)
    assert np.quantile(nearest(found, PLACES / 3.0), 0.85) < 0.1


def test_a_picture_that_ends_early_is_a_finding(tmp_path):
    save(tmp_path / "whole.jpg", spotted(400, 300, PLACES / 3.0, 4.0))
    (tmp_path / "cut.jpg").write_bytes((tmp_path / "whole.jpg").read_bytes()[:1500])
    with pytest.raises(PictureError, match="cannot be decoded") as caught:
        find_features(tmp_path / "cut.jpg", 400, 100)
    assert caught.value.code == "scene.image_broken"


def test_a_plain_picture_has_no_points(tmp_path):
    save(tmp_path / "plain.png", np.full((60, 80), 99, np.uint8))
    found = find_features(tmp_path / "plain.png", 80, 100)
    assert len(found) == 0
    assert found.descriptors.shape == (0, 128)


def test_points_survive_in_a_file(tmp_path):
    save(tmp_path / "noise.png", np.random.default_rng(1).integers(0, 256, (100, 100), dtype=np.uint8))
    found = find_features(tmp_path / "noise.png", 100, 100)
    found.save(tmp_path / "points.npz")
    again = Features.load(tmp_path / "points.npz")
    assert np.array_equal(again.points, found.points)
    assert np.array_equal(again.descriptors, found.descriptors)
    assert [path.name for path in tmp_path.glob("points*")] == ["points.npz"]
