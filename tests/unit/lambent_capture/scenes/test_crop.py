"""A crop shows the object with a margin, and every pixel of it shows what it showed in the frame."""

import numpy as np
import pytest
import torch
from flashcache.geometry.rays import pixel_directions
from lambent_capture.loading.load import camera_of
from lambent_capture.pictures.lens import LensFigures, camera_with_lens
from lambent_capture.pictures.resample import resampled
from lambent_capture.problems import Problems
from lambent_capture.scenes.crop import (
    LEAST_SIDE,
    LENS_SIDE,
    covered_box,
    cropped,
    object_crop,
    whole_frame,
    with_margin,
)
from lambent_proto.v1 import scene_pb2

BARREL = (-0.25, 0.08, 0.002, -0.001)


def camera(width=400, height=300, distortion=()):
    figures = LensFigures(
        width=width,
        height=height,
        focal_x=350.0 * width / 400,
        focal_y=340.0 * height / 300,
        centre_x=0.52 * width,
        centre_y=0.48 * height,
        distortion=distortion,
    )
    found = camera_with_lens(figures, np.eye(4), "a", Problems())
    assert found is not None
    return found


def coverage_with(columns: slice, rows: slice, value=1.0, shape=(300, 400)):
    coverage = np.zeros(shape, dtype=np.float32)
    coverage[rows, columns] = value
    return coverage


def directions(of: scene_pb2.Camera, columns, rows):
    c = camera_of(scene_pb2.Frame(camera=of))
    pose = torch.from_numpy(c.camera_to_world).float().expand(len(columns), 4, 4)
    ends = torch.tensor([[c.focal_x, c.focal_y], [c.centre_x, c.centre_y]]).float()
    return pixel_directions(
        torch.as_tensor(columns).float(),
        torch.as_tensor(rows).float(),
        ends[0].expand(len(columns), 2),
        ends[1].expand(len(columns), 2),
        pose,
    )


def test_the_box_holds_what_is_covered_and_no_more():
    coverage = coverage_with(slice(40, 90), slice(100, 130))
    assert covered_box(coverage, camera()) == (40, 100, 90, 130)


def test_the_noise_of_a_lossy_mask_does_not_widen_the_box():
    coverage = coverage_with(slice(40, 90), slice(100, 130))
    coverage[0, 0] = coverage[-1, -1] = 9 / 255
    assert covered_box(coverage, camera()) == (40, 100, 90, 130)


def test_an_empty_mask_leaves_the_frame_whole():
    empty = coverage_with(slice(0, 0), slice(0, 0))
    assert object_crop(camera(), [empty]) == whole_frame(camera())
    assert object_crop(camera(), []) == whole_frame(camera())


def test_the_crop_holds_what_any_photograph_shows():
    one = coverage_with(slice(100, 180), slice(100, 180))
    other = coverage_with(slice(120, 220), slice(90, 150))
    left, top, right, bottom = object_crop(camera(), [one, other]).pinhole
    assert (left, top, right, bottom) == (95, 85, 225, 185)


@pytest.mark.parametrize(
    ("box", "expected"),
    [
        ((0, 0, 400, 300), (0, 0, 400, 300)),
        ((100, 100, 200, 150), (96, 96, 204, 154)),
        ((1, 290, 101, 300), (0, 250, 105, 300)),  # at the border, and narrow
        ((200, 100, 202, 102), (193, 93, 209, 109)),  # tiny
    ],
)
def test_a_box_gets_room_inside_the_frame(box, expected):
    assert with_margin(box, camera()) == expected


def test_a_frame_smaller_than_the_least_crop_stays_whole():
    small = camera(width=LEAST_SIDE - 4, height=9)
    assert with_margin((3, 3, 5, 5), small) == (0, 0, LEAST_SIDE - 4, 9)


@pytest.mark.parametrize("distortion", [(), BARREL])
def test_a_pixel_of_the_crop_looks_where_it_looked_in_the_frame(distortion):
    full = camera(distortion=distortion)
    part = cropped(full, (80, 60, 240, 200)).camera
    assert (part.width, part.height) == (160, 140)
    columns, rows = np.array([0.5, 33.5, 159.5]), np.array([0.5, 101.5, 139.5])
    np.testing.assert_allclose(
        directions(part, columns, rows), directions(full, columns + 80, rows + 60), atol=1e-6
    )


@pytest.mark.parametrize("size", [(160, 140), (40, 35)])
@pytest.mark.parametrize("distortion", [(), BARREL])
def test_a_crop_shows_what_the_whole_frame_shows_there(distortion, size):
    full = camera(distortion=distortion)
    columns, rows = np.meshgrid(np.arange(400) + 0.5, np.arange(300) + 0.5)
    picture = np.stack([np.sin(0.05 * columns), np.cos(0.04 * rows), columns / 400], axis=-1)
    picture = picture.astype(np.float32)
    crop = cropped(full, (80, 60, 240, 200))
    left, top, right, bottom = crop.file
    found = resampled(picture[top:bottom, left:right], crop.camera, size)
    scale = 160 // size[0]
    whole = resampled(picture, full, (400 // scale, 300 // scale))
    expected = whole[60 // scale : 200 // scale, 80 // scale : 240 // scale]
    # Through a lens reduced pictures are looked up, and theirs are different pixels.
    np.testing.assert_allclose(found, expected, atol=1e-6 if not distortion or scale == 1 else 4e-3)


@pytest.mark.parametrize("scale", [1, 6])
def test_through_a_lens_the_box_is_the_pinholes(scale):
    full = camera(400 * scale, 300 * scale, BARREL)
    columns, rows = slice(20 * scale, 60 * scale), slice(30 * scale, 80 * scale)
    seen = coverage_with(columns, rows, shape=(300 * scale, 400 * scale))
    straight = resampled(seen[..., None], full, (full.width, full.height))[..., 0] >= 0.1
    down, across = np.nonzero(straight)
    exact = np.array([across.min(), down.min(), across.max() + 1, down.max() + 1])
    larger = (np.array(covered_box(seen, full)) - exact) * [-1, -1, 1, 1]
    assert (larger >= 0).all()
    assert (larger <= 2 * -(-400 * scale // LENS_SIDE) + 1).all()


def test_of_a_lens_only_the_part_that_is_looked_up_is_kept():
    crop = cropped(camera(distortion=BARREL), (80, 60, 240, 200))
    left, top, right, bottom = crop.file
    assert left > 0
    assert top > 0
    assert right - left < 200
    assert bottom - top < 180
