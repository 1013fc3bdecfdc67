"""Pictures in formats that are not read are named with their number and a remedy, in every layout."""

import pytest
from lambent_capture.checks.check import check_capture
from lambent_capture.layouts.unread_formats import counted, is_unread, note_unread
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.pictures.pictures import PICTURE_SUFFIXES
from lambent_capture.problems import Problems
from support.captures import write_tensoir
from support.layouts import LAYOUT_FOLDERS
from support.photographs import write_views


@pytest.mark.parametrize("layout", LAYOUT_FOLDERS)
def test_they_are_named_in_every_layout(tmp_path, layout):
    capture = layout(tmp_path / "scene")
    for number in range(3):
        (capture.picture(3).parent / f"more_{number}.JP2").write_bytes(b"\0")
    (finding,) = (each for each in inspect_files(capture.folder).report.findings)
    assert finding.code == "scene.image_format"
    assert "3 .jp2 are not read" in finding.message
    assert "more_0.JP2" in finding.message


def test_they_are_named_among_photographs_without_cameras(tmp_path):
    write_views(tmp_path / "scene")
    (tmp_path / "scene" / "IMG_9.psd").write_bytes(b"\0")
    report = check_capture(tmp_path / "scene").report
    assert report.usable
    assert "1 .psd is not read" in next(f.message for f in report.findings if f.code == "scene.image_format")


def test_where_there_are_no_others_they_are_the_reason(tmp_path):
    for number in range(12):
        (tmp_path / f"IMG_{number}.jxl").write_bytes(b"\0")
    report = check_capture(tmp_path).report
    assert "12 .jxl are not read; export" in report.findings[0].message
    assert [each.code for each in report.findings] == ["scene.image_format"]


def test_the_remedy_fits_the_format():
    assert counted(["a.jfif", "b.JPE"]) == (
        "1 .jfif, 1 .jpe are not read; these are JPEG under another name, so rename them to .jpg"
    )
    assert "export" in counted(["a.gif"])


def test_formats_that_are_read_and_hidden_files_are_not_named(tmp_path):
    assert not any(is_unread(f"a{suffix}") for suffix in PICTURE_SUFFIXES)
    (tmp_path / ".thumbnails").mkdir()
    (tmp_path / ".thumbnails" / "a.gif").touch()
    problems = Problems()
    note_unread(write_tensoir(tmp_path), problems)
    assert not problems.findings()
