"""OpenIllumination: lights in folders, cameras by name, masks by purpose."""

import json
import shutil

import numpy as np
import pytest
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.inspect import inspect_files
from lambent_proto.v1 import scene_pb2
from support.captures import save
from support.findings import only
from support.layouts import OpenIlluminationFolder
from support.uneven_object import NUM_VIEWS, SIDE, colours


@pytest.fixture
def capture(tmp_path):
    return OpenIlluminationFolder(tmp_path / "scene")


def test_the_paper_s_training_light_comes_first_then_its_others_then_the_rest(capture):
    for light in ("001", "011"):
        shutil.copytree(capture.base / "Lights" / "009", capture.base / "Lights" / light)
    assert list(describe_scene(capture.folder).lights) == ["013", "011", "009", "001"]


@pytest.mark.parametrize("above", ["", "lighting_patterns"])
def test_the_object_may_be_the_folder_or_lie_among_the_patterns(capture, tmp_path, above):
    folder = tmp_path / "upload"
    shutil.copytree(capture.base, folder / above / "obj" if above else folder)
    assert not inspect_files(folder).report.findings
    assert len(describe_scene(folder).frames) == NUM_VIEWS


def test_several_objects_are_an_error_that_names_them(capture):
    shutil.copytree(capture.base, capture.folder / "obj_04_stone")
    finding = only(capture.folder)
    assert finding.code == "scene.object_ambiguous"
    assert "obj_02_egg, obj_04_stone" in finding.message


def with_test_split(capture, *moved):
    """Move cameras from the training file to a test file."""
    frames = capture.frames()
    tested = {capture.key(index): frames.pop(capture.key(index)) for index in moved}
    capture.write_cameras(frames)
    (capture.base / "output" / "transforms_test.json").write_text(json.dumps({"frames": tested}))
    for index in moved:
        save(capture.base / "output" / "obj_masks" / f"{capture.key(index)}.png", capture.coverage[index])


def test_test_views_use_the_mask_of_the_object_without_its_stand(capture):
    with_test_split(capture, 5, 9)
    masks = {f.name: f.mask.split("/")[-2] for f in describe_scene(capture.folder).frames}
    assert [name for name, kind in masks.items() if kind == "obj_masks"] == [capture.key(5), capture.key(9)]
    assert not inspect_files(capture.folder).report.findings


def test_a_missing_mask_is_an_error_that_names_it(capture):
    with_test_split(capture, 5)
    path = capture.base / "output" / "obj_masks" / f"{capture.key(5)}.png"
    path.unlink()
    finding = only(capture.folder)
    assert (finding.code, finding.subject) == (
        "scene.file_missing",
        path.relative_to(capture.folder).as_posix(),
    )


def test_a_camera_in_both_splits_is_an_error_that_names_it(capture):
    with_test_split(capture, 5)
    capture.write_cameras()
    finding = only(capture.folder)
    assert (finding.code, finding.subject) == ("scene.frame_duplicate", capture.key(5))


def test_a_photograph_missing_under_one_light_is_an_error_that_names_it(capture):
    path = capture.photograph(3, "009")
    path.unlink()
    finding = only(capture.folder)
    assert (finding.code, finding.subject) == (
        "scene.file_missing",
        path.relative_to(capture.folder).as_posix(),
    )


def test_photographs_reduced_by_a_whole_factor_are_accepted_and_cropped_ones_not(capture):
    frames = capture.frames()
    for frame in frames.values():
        frame["calib_imgw"] = 2 * SIDE
    capture.write_cameras(frames)
    assert not inspect_files(capture.folder).report.findings
    for frame in frames.values():
        frame["calib_imgw"] = 1.5 * SIDE
    capture.write_cameras(frames)
    report = inspect_files(capture.folder).report
    assert {f.code for f in report.findings} == {"scene.image_size"}


def test_frames_that_are_no_dictionary_are_an_error(capture):
    path = capture.base / "output" / "transforms_train.json"
    path.write_text(json.dumps({"frames": [1, 2]}))
    assert only(capture.folder).code == "scene.metadata_unreadable"


def test_a_camera_called_like_a_path_is_refused(capture):
    frames = capture.frames()
    frames["../../x"] = frames.pop(capture.key(3))
    capture.write_cameras(frames)
    assert only(capture.folder).code == "scene.path_unsafe"


def test_poses_are_taken_from_opencv_axes(capture):
    frame = next(f for f in describe_scene(capture.folder).frames if f.name == capture.key(3))
    pose = np.array(frame.camera.camera_to_world).reshape(4, 4)
    np.testing.assert_allclose(pose[:3, :3], capture.poses[3][:3, :3], atol=1e-9)


def test_photographs_in_other_formats_are_found(capture):
    for index in range(NUM_VIEWS):
        for light in ("009", "013"):
            capture.photograph(index, light).unlink()
            save(capture.photograph(index, light).with_suffix(".png"), colours(index + 100 * int(light)))
    assert not inspect_files(capture.folder).report.findings
    assert all(
        f.split in (scene_pb2.SPLIT_TRAIN, scene_pb2.SPLIT_TEST)
        for f in describe_scene(capture.folder).frames
    )
