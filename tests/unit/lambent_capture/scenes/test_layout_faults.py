"""Whatever is wrong with a capture, in whichever layout: one clear finding that names the file or frame."""

import numpy as np
import pytest
from lambent_capture.loading.inspect import inspect_files
from lambent_core.layouts import LAYOUTS
from lambent_proto.v1 import scene_pb2
from support.captures import save
from support.findings import only
from support.layouts import LAYOUT_FOLDERS, OPENCV, BlenderFolder, LayoutFolder
from support.uneven_object import NUM_VIEWS, SIDE, colours, coverage

ROLL = np.diag([-1.0, -1.0, 1.0, 1.0])
QUARTER = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@pytest.fixture(params=LAYOUT_FOLDERS, ids=lambda layout: layout.__name__.removesuffix("Folder"))
def capture(request, tmp_path) -> LayoutFolder:
    return request.param(tmp_path / "scene")


def test_a_sound_capture_has_no_findings(capture):
    report = inspect_files(capture.folder).report
    assert report.usable
    assert report.layout == capture.name
    assert [f"{f.code}: {f.message}" for f in report.findings] == []
    assert report.num_train_frames + report.num_test_frames == NUM_VIEWS


def test_a_missing_photograph_is_named_and_left_out_where_the_layout_allows_it(capture):
    capture.picture(3).unlink()
    finding = only(capture.folder)
    tolerant = LAYOUTS[capture.name].tolerant
    assert finding.code == ("scene.frames_without_picture" if tolerant else "scene.file_missing")
    assert finding.subject.rsplit(".", maxsplit=1)[0] == capture.path(3).rsplit(".", maxsplit=1)[0]


def test_a_photograph_that_ends_too_early_is_named_and_left_out_where_the_layout_allows_it(capture):
    path = capture.picture(3)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    tolerant = LAYOUTS[capture.name].tolerant
    inspection = inspect_files(capture.folder)
    (finding,) = inspection.report.findings
    assert finding.code == ("scene.pictures_left_out" if tolerant else "scene.image_broken")
    assert finding.subject == capture.path(3)
    assert inspection.report.usable == tolerant
    assert inspection.left_out == ((capture.path(3),) if tolerant else ())


def test_a_photograph_without_a_camera_is_a_note_that_names_it(capture):
    save(capture.extra(), colours(77))
    finding = only(capture.folder)
    assert finding.code == "scene.extra_file"
    assert finding.subject == capture.extra().relative_to(capture.folder).as_posix()


def test_too_few_numbers_are_an_error_that_names_their_file(capture):
    capture.wrong_count()
    finding = only(capture.folder)
    assert finding.code == capture.count_code
    assert finding.severity == scene_pb2.SEVERITY_ERROR
    assert finding.subject


def test_a_frame_described_twice_is_an_error_that_names_it(capture):
    capture.duplicate()
    finding = only(capture.folder)
    assert finding.code == capture.duplicate_code
    assert finding.severity == scene_pb2.SEVERITY_ERROR


def test_a_photograph_of_another_shape_is_found_and_named(capture):
    tall = np.zeros((SIDE + 16, SIDE), dtype=np.uint8)
    tall[8:-8] = capture.coverage[3]
    rgb = np.zeros((SIDE + 16, SIDE, 3), dtype=np.uint8)
    rgb[8:-8] = colours(3)
    capture.save_picture(3, rgb, tall)
    finding = only(capture.folder)
    assert finding.code == capture.size_code
    assert f"{SIDE} x {SIDE + 16}" in finding.message
    assert "3" in finding.subject


def test_a_singular_pose_is_an_error_that_names_its_frame(capture):
    capture.set_pose(3, np.diag([1.0, 1.0, 0.0, 1.0]))
    finding = only(capture.folder)
    assert finding.code == "scene.camera_not_rigid"
    assert "is singular" in finding.message
    assert "3" in finding.subject


def test_a_pose_without_numbers_is_an_error_that_names_its_frame(capture):
    pose = capture.poses[3].copy()
    pose[0, 3] = np.nan
    capture.set_pose(3, pose)
    finding = only(capture.folder)
    assert finding.code == "scene.camera_not_finite"
    assert "3" in finding.subject


def test_a_lens_without_focal_length_is_an_error(capture):
    capture.zero_focal()
    report = inspect_files(capture.folder).report
    assert not report.usable
    assert {f.code for f in report.findings} == {capture.zero_focal_code}


def test_an_unreadable_mask_is_an_error_that_names_it(capture):
    path = capture.mask(3) or capture.picture(3)
    path.write_text("no picture")
    finding = only(capture.folder)
    lost = capture.mask(3) is None and LAYOUTS[capture.name].tolerant
    assert finding.code == ("scene.pictures_left_out" if lost else "scene.image_not_a_picture")
    assert finding.subject == path.relative_to(capture.folder).as_posix()


def test_an_empty_mask_is_found_and_named(capture):
    capture.save_picture(3, colours(3), np.zeros((SIDE, SIDE), dtype=np.uint8))
    finding = only(capture.folder)
    path = capture.mask(3) or capture.picture(3)
    assert finding.code == ("scene.mask_empty" if capture.has_mask_files() else "scene.image_empty")
    assert finding.subject == path.relative_to(capture.folder).as_posix()


@pytest.mark.parametrize("layout", LAYOUT_FOLDERS[2:], ids=lambda layout: layout.__name__)
def test_a_mask_of_another_size_is_an_error_that_names_it(tmp_path, layout):
    capture = layout(tmp_path / "scene")
    value = coverage(capture.poses[3], side=SIDE // 2)
    depth = np.where(value > 0, 3.6, 15.0) / 15.0 * 65535.0
    save(capture.mask(3), depth.astype(np.uint16) if capture.name == "glossy_synthetic" else value)
    finding = only(capture.folder)
    assert finding.code == "scene.mask_size"
    assert finding.subject == capture.mask(3).relative_to(capture.folder).as_posix()


def test_cameras_that_look_the_other_way_are_recognised_as_the_other_convention(capture):
    capture.turn_all(OPENCV)
    finding = only(capture.folder)
    assert finding.code == "scene.cameras_look_away"
    assert "diag(1, -1, -1, 1)" in finding.message


def test_axes_that_only_the_silhouettes_give_away_are_named(capture):
    capture.turn_all(ROLL)
    finding = only(capture.folder)
    assert finding.code == "scene.axes_wrong"
    assert "diag(-1, -1, 1, 1)" in finding.message
    assert finding.subject


def test_pictures_turned_by_a_quarter_are_recognised(tmp_path):
    capture = BlenderFolder(tmp_path / "scene")
    capture.turn_all(QUARTER)
    finding = only(capture.folder)
    assert finding.code == "scene.axes_wrong"
    assert "quarter to the right" in finding.message


def test_inverted_matrices_are_recognised_as_such(capture):
    capture.poses = [np.linalg.inv(pose) for pose in capture.poses]
    capture.write_cameras()
    finding = only(capture.folder)
    assert finding.code in ("scene.cameras_coincide", "scene.axes_wrong", "scene.cameras_look_away")
    assert "invert each" in finding.message


def test_a_single_pose_that_fits_no_mask_is_a_note_that_names_its_frame(tmp_path):
    capture = BlenderFolder(tmp_path / "scene")
    capture.set_pose(3, QUARTER @ capture.poses[3])
    finding = only(capture.folder)
    assert finding.code == "scene.mask_disagrees"
    assert finding.subject == "train_r_3"


def test_masks_of_other_pictures_are_a_note_that_claims_no_convention(tmp_path):
    capture = BlenderFolder(tmp_path / "scene")
    order = np.random.default_rng(1).permutation(NUM_VIEWS)
    for index in range(NUM_VIEWS):
        capture.save_picture(index, colours(index), capture.coverage[order[index]])
    finding = only(capture.folder)
    assert finding.code == "scene.silhouettes_disagree"
