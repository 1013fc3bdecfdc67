"""Whatever people hand over as photographs: a clear finding, nothing raised, nothing left behind."""

import numpy as np
import pytest
import support.bad_files
import support.bad_photographs  # noqa: F401  # these two fill the list
from lambent_capture.checks.photograph_findings import note_photographs
from lambent_capture.checks.photograph_limits import PhotographLimits
from lambent_capture.checks.photographs import PhotographsFigures, look
from lambent_capture.layouts.picture_files import photographs_in
from lambent_capture.problems import Problems
from lambent_proto.v1 import scene_pb2
from PIL import Image
from support.bad_captures import CAPTURES
from support.bad_views import NEED_CAMERAS, write_needing_cameras
from support.photographs import view, write_views


def look_at_folder(folder, problems) -> PhotographsFigures:
    """Return the figures of all photographs below `folder`, after noting in `problems` what is wrong."""
    names = photographs_in(folder, problems)
    figures = look(folder, names if problems.usable else (), PhotographLimits())
    if names and problems.usable:
        note_photographs(figures, problems)
    return figures


def files_below(folder):
    return sorted((path.relative_to(folder), path.lstat().st_mtime_ns) for path in folder.rglob("*"))


@pytest.mark.parametrize("name", CAPTURES)
def test_a_bad_capture_gets_the_findings_that_tell_what_to_do(tmp_path, name, recwarn):
    capture = CAPTURES[name]
    capture.write(tmp_path / "capture")
    before = files_below(tmp_path)
    problems = Problems()
    figures = look_at_folder(tmp_path / "capture", problems)
    findings = [finding for finding in problems.findings() if finding.code != "scene.views_few"]
    assert {finding.code for finding in findings} == set(capture.codes), [f.message for f in findings]
    assert problems.usable != capture.is_error
    for finding in findings:
        assert ";" in finding.message  # what is wrong; what to do
        finding.SerializeToString()
    if problems.usable:
        assert len(figures.usable) >= 3
    assert files_below(tmp_path) == before
    assert not recwarn.list


def test_there_are_at_least_sixty_bad_captures():
    assert len(CAPTURES) + len(NEED_CAMERAS) >= 60


def test_a_sound_capture_has_no_finding_but_that_photographs_are_few(tmp_path):
    write_views(tmp_path / "capture")
    problems = Problems()
    figures = look_at_folder(tmp_path / "capture", problems)
    assert [finding.code for finding in problems.findings()] == ["scene.views_few"]
    assert len(figures.usable) == 5
    assert not any(each.same_as for each in figures.usable)


def test_folders_that_a_camera_makes_are_one_capture(tmp_path):
    write_views(tmp_path / "capture" / "100CANON", 8)
    write_views(tmp_path / "capture" / "101CANON", 8, first=8)
    problems = Problems()
    look_at_folder(tmp_path / "capture", problems)
    assert [finding.code for finding in problems.findings()] == ["scene.views_few"]


@pytest.mark.parametrize("name", NEED_CAMERAS)
def test_what_only_cameras_show_passes_the_look_at_single_photographs(tmp_path, name):
    originals = tmp_path / "originals"
    originals.mkdir()
    for index in range(6):
        view(index + 20).save(originals / f"{index}.png")
    write_needing_cameras(name, tmp_path / "capture", list(originals.iterdir()))
    problems = Problems()
    look_at_folder(tmp_path / "capture", problems)
    assert problems.usable
    with Image.open(originals / "1.png") as before, Image.open(tmp_path / "capture" / "001.jpg") as after:
        changed = np.abs(np.asarray(before).astype(int) - np.asarray(after)).mean() > 10.0
    assert changed or name == "two objects"


def test_errors_come_as_errors_and_notes_as_notes(tmp_path):
    CAPTURES["one JPEG cut off"].write(tmp_path / "capture")
    problems = Problems()
    figures = look_at_folder(tmp_path / "capture", problems)
    severities = {finding.code: finding.severity for finding in problems.findings()}
    assert severities["scene.image_broken"] == scene_pb2.SEVERITY_WARNING
    assert figures.left_out == ("IMG_0001.jpg",)
