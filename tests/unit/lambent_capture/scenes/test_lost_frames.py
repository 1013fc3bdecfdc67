"""Frames whose pictures are missing or broken are left out as long as they are few; then they are errors."""

import pytest
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.scenes.lost_frames import are_few
from lambent_core.errors import SceneRefusedError
from lambent_proto.v1 import scene_pb2
from support.captures import write_blender, write_tensoir
from support.layouts import NerfstudioFolder
from support.uneven_object import NUM_VIEWS


def found(folder):
    report = inspect_files(folder).report
    return report, {finding.code: finding for finding in report.findings}


@pytest.mark.parametrize(
    ("lost", "kept", "few"), [(1, 3, True), (17, 50, True), (5, 5, True), (6, 5, False), (1, 2, False)]
)
def test_half_of_the_pictures_may_be_lost_if_three_are_left(lost, kept, few):
    assert are_few(lost, kept) == few


def test_a_quarter_of_the_frames_without_pictures_as_in_the_fox_is_one_note(tmp_path):
    capture = NerfstudioFolder(tmp_path / "scene")
    lost = range(0, NUM_VIEWS, 4)
    for index in lost:
        capture.picture(index).unlink()
    report, findings = found(capture.folder)
    assert report.usable
    assert list(findings) == ["scene.frames_without_picture"]
    note = findings["scene.frames_without_picture"]
    assert f"{len(lost)} of {NUM_VIEWS} frames" in note.message
    assert capture.path(0) in note.message
    assert len(describe_scene(capture.folder).frames) == NUM_VIEWS - len(lost)


def test_most_frames_without_pictures_are_an_error_for_each(tmp_path):
    folder = write_blender(tmp_path)
    for index in range(4):
        (folder / "train" / f"r_{index}.png").unlink()
    report, _ = found(folder)
    assert not report.usable
    assert [finding.code for finding in report.findings].count("scene.file_missing") == 4
    with pytest.raises(SceneRefusedError):
        describe_scene(folder)


def test_missing_and_broken_pictures_count_together(tmp_path):
    folder = write_blender(tmp_path, num_train=6, num_test=0)
    for index in range(2):
        (folder / "train" / f"r_{index}.png").unlink()
    for index in (2, 3):
        path = folder / "train" / f"r_{index}.png"
        path.write_bytes(path.read_bytes()[:-30])
    report, _ = found(folder)
    assert not report.usable
    assert {finding.code for finding in report.findings if finding.severity == scene_pb2.SEVERITY_ERROR} >= {
        "scene.image_broken",
    }


def test_a_run_describes_the_scene_without_what_the_check_left_out(tmp_path):
    folder = write_blender(tmp_path, num_train=9, num_test=0)
    path = folder / "train" / "r_1.png"
    path.write_bytes(path.read_bytes()[:-30])
    inspection = inspect_files(folder)
    assert inspection.report.usable
    assert inspection.left_out == ("train/r_1.png",)
    described = describe_scene(folder, left_out=inspection.left_out)
    assert [frame.name for frame in described.frames] == [frame.name for frame in inspection.manifest.frames]
    assert [frame.split for frame in described.frames] == [
        frame.split for frame in inspection.manifest.frames
    ]
    assert "train_r_1" not in {frame.name for frame in described.frames}


def test_a_picture_that_brought_the_reader_down_is_left_out_too(tmp_path):
    folder = write_blender(tmp_path)
    inspection = inspect_files(folder, skip={"train/r_2.png": "scene.image_too_large"})
    assert inspection.report.usable
    assert inspection.left_out == ("train/r_2.png",)
    (note,) = (f for f in inspection.report.findings if f.code == "scene.pictures_left_out")
    assert "more memory or time" in note.message


def test_benchmarks_with_several_lights_stay_strict(tmp_path):
    folder = write_tensoir(tmp_path)
    path = folder / "train_001" / "rgba_sunset.png"
    path.write_bytes(path.read_bytes()[:-30])
    report, findings = found(folder)
    assert not report.usable
    assert "scene.image_broken" in findings
