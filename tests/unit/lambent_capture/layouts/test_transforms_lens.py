"""Lenses in transforms files are understood or refused, never guessed."""

import math

import pytest
from lambent_capture.layouts.transforms_lens import read_lens
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.problems import Problems
from support.captures import edit_frame, write_blender
from support.findings import codes

LENSES = {
    "fisheye model": ({"camera_model": "OPENCV_FISHEYE"}, "scene.lens_unsupported"),
    "fisheye switch": ({"is_fisheye": True}, "scene.lens_unsupported"),
    "panorama": ({"camera_model": "EQUIRECTANGULAR"}, "scene.lens_unsupported"),
    "ambiguous coefficient": ({"k4": 0.1}, "scene.lens_unsupported"),
    "no number": ({"k1": "strong"}, "scene.lens_invalid"),
    "folding": ({"k1": -9.0}, "scene.lens_invalid"),
}


@pytest.mark.parametrize(("lens", "code"), LENSES.values(), ids=LENSES.keys())
def test_a_lens_that_no_pinhole_can_stand_in_for_is_refused_with_its_frame(tmp_path, lens, code):
    folder = write_blender(tmp_path)
    edit_frame(folder, 1, **lens)
    report = inspect_files(folder).report
    assert codes(report) == [code]
    assert "r_1" in report.findings[0].message


SIZE = (96, 80)


def lens(shared, own=None):
    problems = Problems()
    figures = read_lens(shared, own or {}, SIZE, "a.png", "frame 0", problems)
    assert figures is not None, [f"{f.code}: {f.message}" for f in problems.findings()]
    return (figures.focal_x, figures.focal_y, figures.centre_x, figures.centre_y)


def angle(focal, pixels):
    return 2.0 * math.atan(0.5 * pixels / focal)


FIGURES = {
    "angle": ({"camera_angle_x": angle(150, 96)}, {}, (150, 150, 48, 40)),
    "both angles": (
        {"camera_angle_x": angle(150, 96), "camera_angle_y": angle(90, 80)},
        {},
        (150, 90, 48, 40),
    ),
    "vertical angle alone": ({"camera_angle_y": angle(90, 80)}, {}, (90, 90, 48, 40)),
    "degrees": ({"x_fov": math.degrees(angle(150, 96))}, {}, (150, 150, 48, 40)),
    "pixels": ({"fl_x": 150, "fl_y": 90}, {}, (150, 90, 48, 40)),
    "vertical pixels alone": ({"fl_y": 90}, {}, (90, 90, 48, 40)),
    "pixels before angle": ({"fl_x": 150, "camera_angle_x": 1.0}, {}, (150, 150, 48, 40)),
    "one of each": ({"fl_x": 150, "camera_angle_y": angle(90, 80)}, {}, (150, 90, 48, 40)),
    "angle with centre": ({"camera_angle_x": angle(150, 96), "cx": 50, "cy": 30}, {}, (150, 150, 50, 30)),
    "centre of the frame": ({"fl_x": 150, "cx": 50, "cy": 30}, {"cx": 51}, (150, 150, 51, 30)),
    "angle of the frame": (
        {"fl_x": 80, "fl_y": 80, "cx": 50},
        {"camera_angle_x": angle(150, 96)},
        (150, 150, 50, 40),
    ),
    "pixels of the frame": ({"camera_angle_x": 1.0}, {"fl_x": 150}, (150, 150, 48, 40)),
    "one length of the frame": ({"fl_x": 80, "fl_y": 90}, {"fl_y": 100}, (80, 100, 48, 40)),
    "zoom of the frame": ({"fl_x": 80, "fl_y": 80}, {"fl_x": 150}, (150, 150, 48, 40)),
    "each gives one": ({"fl_y": 90}, {"fl_x": 150}, (150, 90, 48, 40)),
}


@pytest.mark.parametrize(("shared", "own", "expected"), FIGURES.values(), ids=FIGURES.keys())
def test_every_figure_has_one_precedence(shared, own, expected):
    assert lens(shared, own) == pytest.approx(expected)


def test_figures_in_pixels_are_of_the_size_that_is_stated_beside_them():
    stated = {"w": 192, "h": 160, "fl_x": 300, "cx": 100, "cy": 60}
    assert lens(stated) == (300, 300, 100, 60)
    half = {"w": 96, "h": 80}
    assert lens(stated, half) == (150, 150, 50, 30), "the frame is smaller than the file says"
    assert lens(stated, {**half, "fl_x": 70}) == (70, 70, 50, 30)
    angle_of_half = {"w": 192, "camera_angle_x": angle(300, 192), "cx": 100}
    assert lens(angle_of_half) == pytest.approx((300, 300, 100, 80)), "the height follows from the width"


def test_a_lens_for_another_shape_than_the_frame_is_refused():
    problems = Problems()
    shared = {"w": 96, "h": 80, "fl_x": 100}
    assert read_lens(shared, {"w": 80, "h": 96}, (80, 96), "a.png", "frame 0", problems) is None
    assert [each.code for each in problems.findings()] == ["scene.image_size"]
    assert read_lens(shared, {"w": 80, "h": 96, "fl_x": 100}, (80, 96), "a.png", "frame 0", problems)


FAULTS = {
    "negative length": ({"fl_x": -1}, "scene.lens_invalid"),
    "a length as text": ({"fl_x": "80"}, "scene.lens_invalid"),
    "no width": ({"w": 0, "fl_x": 80}, "scene.lens_invalid"),
    "an infinite centre": ({"fl_x": 80, "cx": math.inf}, "scene.lens_invalid"),
    "a vertical angle too wide": ({"camera_angle_y": 4.0}, "scene.camera_angle_invalid"),
    "an angle as text": ({"x_fov": "wide"}, "scene.camera_angle_invalid"),
    "nothing": ({"cx": 40}, "scene.camera_missing"),
    "a panorama": ({"fl_x": 80, "latlong": True}, "scene.lens_unsupported"),
}


@pytest.mark.parametrize(("shared", "code"), FAULTS.values(), ids=FAULTS.keys())
def test_a_figure_that_cannot_be_used_is_an_error(shared, code):
    problems = Problems()
    assert read_lens(shared, {}, SIZE, "a.png", "frame 0", problems) is None
    assert [each.code for each in problems.findings()] == [code]


def test_a_lens_may_be_a_matrix_and_counts_after_what_is_named():
    matrix = [[120.0, 0.0, 50.0], [0.0, 130.0, 42.0], [0.0, 0.0, 1.0]]
    assert lens({"w": 96, "h": 80, "K": matrix}) == (120.0, 130.0, 50.0, 42.0)
    assert lens({"fl_x": 99.0}, {"K": matrix}) == (120.0, 130.0, 50.0, 42.0)
    assert lens({}, {"K": matrix, "fl_x": 99.0})[:2] == (99.0, 99.0)


@pytest.mark.parametrize("matrix", [[], [[1.0]], "K", [[1.0, 0.0], [0.0, 1.0]], 5, [1, 2, 3]])
def test_a_matrix_of_another_shape_is_no_lens(matrix):
    problems = Problems()
    assert read_lens({"K": matrix}, {}, SIZE, "a.png", "frame 0", problems) is None
    assert [finding.code for finding in problems.findings()] == ["scene.camera_missing"]
