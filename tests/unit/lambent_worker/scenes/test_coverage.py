"""Coverage of a picture by the object: alpha, mask file, or both."""

import numpy as np
import pytest
from lambent_proto.v1 import scene_pb2
from lambent_worker.scenes.coverage import frame_coverage, has_coverage, small_coverage
from lambent_worker.scenes.picture_error import PictureError
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
