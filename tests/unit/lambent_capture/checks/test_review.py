"""The look at a usable capture adds its findings, and settles what the first look only guessed."""

import pytest
from lambent_capture.checks.limits import CaptureLimits
from lambent_capture.checks.review import review
from lambent_capture.layouts.detect import collect_scene
from lambent_capture.problems import MAX_FINDINGS, Problems
from lambent_proto.v1 import scene_pb2
from support.captures import write_tensoir


def reviewed(tmp_path, *codes: str, num_train: int = 12):
    """Return the codes of a report that had these, after the review of a capture of squares."""
    folder = write_tensoir(tmp_path, num_train=num_train)
    report = scene_pb2.SceneReport(usable=True, findings=[scene_pb2.Finding(code=code) for code in codes])
    examination = review(folder, collect_scene(folder, None, Problems()), report, CaptureLimits())
    return [finding.code for finding in report.findings], examination


def test_findings_are_added_after_those_that_are_there(tmp_path):
    codes, examination = reviewed(tmp_path, "scene.off_centre")
    assert codes[:2] == ["scene.off_centre", "scene.views_few"]
    assert examination.figures.num_train_views == 12
    assert set(examination.thumbnails) == {view.name for view in examination.figures.views}


def test_single_silhouettes_are_judged_by_the_finer_look(tmp_path):
    codes, examination = reviewed(tmp_path, "scene.mask_disagrees")
    assert examination.figures.has_hull
    assert "scene.mask_disagrees" not in codes


def test_without_a_hull_the_coarse_word_stays(tmp_path):
    codes, examination = reviewed(tmp_path, "scene.mask_disagrees", num_train=3)
    assert not examination.figures.has_hull
    assert codes[0] == "scene.mask_disagrees"


def test_there_are_never_more_findings_than_a_report_may_have(tmp_path):
    codes, _ = reviewed(tmp_path, *["scene.image_duplicate"] * MAX_FINDINGS)
    assert len(codes) == MAX_FINDINGS


@pytest.mark.parametrize("known", [False, True])
def test_poses_that_fit_nothing_are_told_once(tmp_path, known):
    folder = write_tensoir(tmp_path, num_train=12)
    manifest = collect_scene(folder, None, Problems())
    for frame in manifest.frames:
        # Every camera looks away from the object.
        pose = frame.camera.camera_to_world
        for index in (0, 2, 4, 6, 8, 10):
            pose[index] = -pose[index]
    codes = ["scene.silhouettes_disagree"] if known else []
    report = scene_pb2.SceneReport(usable=True, findings=[scene_pb2.Finding(code=code) for code in codes])
    review(folder, manifest, report, CaptureLimits())
    found = [finding.code for finding in report.findings]
    assert ("scene.silhouettes_disagree" in found) is known
    assert ("scene.poses_inconsistent" in found) is not known
