"""A lens with distortion is replaced by a pinhole that sees nothing the lens did not see."""

import numpy as np
import pytest
from lambent_capture.pictures.lens import LensFigures, camera_with_lens, distorted
from lambent_capture.problems import Problems


def figures(**changes):
    given = {
        "width": 640,
        "height": 480,
        "focal_x": 500.0,
        "focal_y": 510.0,
        "centre_x": 322.0,
        "centre_y": 236.0,
    }
    return LensFigures(**{**given, **changes})


def camera_of(**changes):
    problems = Problems()
    return camera_with_lens(figures(**changes), np.eye(4), "frame 3", problems), problems


def test_distortion_is_the_documented_rational_polynomial():
    coefficients = np.array([-0.2, 0.1, 0.01, -0.02, 0.05, 0.03, -0.04, 0.02])
    x, y = 0.3, -0.2
    r2 = x * x + y * y
    radial = (1 - 0.2 * r2 + 0.1 * r2**2 + 0.05 * r2**3) / (1 + 0.03 * r2 - 0.04 * r2**2 + 0.02 * r2**3)
    seen_x, seen_y = distorted(np.array(x), np.array(y), coefficients)
    assert seen_x == pytest.approx(x * radial + 2 * 0.01 * x * y - 0.02 * (r2 + 2 * x * x))
    assert seen_y == pytest.approx(y * radial + 0.01 * (r2 + 2 * y * y) - 2 * 0.02 * x * y)


def test_a_lens_without_distortion_is_a_pinhole_as_it_is():
    camera, problems = camera_of(distortion=(0.0, 0.0))
    assert problems.usable
    assert not camera.HasField("lens")
    assert (camera.focal_x, camera.focal_y) == (500.0, 510.0)


@pytest.mark.parametrize(
    "distortion", [(-0.2, 0.05), (0.15, 0.0), (-0.1, 0.0, 0.004, -0.003, 0.01, 0.1, 0.0, 0.0)]
)
def test_the_pinhole_fills_the_picture_of_the_lens_without_leaving_it(distortion):
    camera, problems = camera_of(distortion=distortion)
    assert problems.usable
    rim = np.linspace(0.0, 1.0, 400)
    u = np.concatenate([rim, rim, 0 * rim, 0 * rim + 1]) * camera.width
    v = np.concatenate([0 * rim, 0 * rim + 1, rim, rim]) * camera.height
    x, y = (u - camera.centre_x) / camera.focal_x, (v - camera.centre_y) / camera.focal_y
    seen_x, seen_y = distorted(x, y, np.array(camera.lens.distortion))
    columns = camera.lens.focal_x * seen_x + camera.lens.centre_x
    rows = camera.lens.focal_y * seen_y + camera.lens.centre_y
    room = [columns.min(), rows.min(), camera.width - columns.max(), camera.height - rows.max()]
    assert min(room) > -0.01  # never outside ...
    assert min(room) < 0.01  # ... and with no zoom to spare
    assert camera.focal_y / camera.focal_x == pytest.approx(510.0 / 500.0)


BAD = {
    "zero focal length": {"focal_x": 0.0},
    "negative focal length": {"focal_y": -3.0},
    "no number": {"centre_x": float("nan")},
    "infinite distortion": {"distortion": (float("inf"),)},
    "folding distortion": {"distortion": (-5.0, 0.0)},
}


@pytest.mark.parametrize("changes", BAD.values(), ids=BAD.keys())
def test_an_impossible_lens_is_one_error_that_names_the_frame(changes):
    camera, problems = camera_of(**changes)
    assert camera is None
    (finding,) = problems.findings()
    assert finding.code == "scene.lens_invalid"
    assert finding.subject == "frame 3"
