"""Links are followed as far as they stay in the capture, in the sandbox of a check too; others are named."""

import shutil

import pytest
from lambent_capture.checks.check import check_capture
from lambent_capture.layouts.detect import describe_scene, detect_layout
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.scenes.links import files_below, leads_inside, link_out
from support.captures import write_tensoir
from support.layouts import BlenderFolder, ColmapBinaryFolder, NerfstudioFolder
from support.photographs import write_views

CAPTURES = pytest.mark.parametrize("layout", [NerfstudioFolder, BlenderFolder, ColmapBinaryFolder])


def codes(report):
    return {each.code for each in report.findings}


def move(path, target):
    """Move a file or folder and leave a link where it was."""
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.move(path, target)
    path.symlink_to(target)


@CAPTURES
def test_a_folder_of_photographs_may_be_a_link_inside_the_capture(tmp_path, layout):
    capture = layout(tmp_path / "scene")
    before = describe_scene(capture.folder)
    move(capture.picture(0).parent, capture.folder / "store" / "all")
    assert describe_scene(capture.folder) == before
    assert check_capture(capture.folder).report.usable


@CAPTURES
def test_photographs_may_be_links_inside_the_capture(tmp_path, layout):
    capture = layout(tmp_path / "scene")
    before = describe_scene(capture.folder)
    for index in range(8):
        move(capture.picture(index), capture.folder / ".store" / f"{index}")
    assert describe_scene(capture.folder) == before
    assert check_capture(capture.folder).report.usable


@CAPTURES
@pytest.mark.parametrize("what", ["folder", "files", "cameras"])
def test_links_out_of_the_capture_are_refused_by_name(tmp_path, layout, what):
    capture = layout(tmp_path / "scene")
    outside = tmp_path / "outside"
    if what == "folder":
        named = capture.picture(0).parent
        move(named, outside / "all")
    elif what == "files":
        named = capture.picture(0)
        for index in range(16):
            move(capture.picture(index), outside / capture.picture(index).name)
    else:
        files = [*capture.folder.glob("*.json"), *capture.folder.glob("sparse/0/cameras.bin")]
        named = files[0]
        move(named, outside / named.name)
    for report in (inspect_files(capture.folder).report, check_capture(capture.folder).report):
        assert codes(report) == {"scene.file_linked"}
        assert report.findings[0].subject == named.relative_to(capture.folder).as_posix()


def test_a_benchmark_with_a_link_out_is_refused_before_it_is_read(tmp_path):
    folder = write_tensoir(tmp_path / "scene")
    move(folder / "train_001", tmp_path / "outside" / "train_001")
    assert codes(check_capture(folder).report) == {"scene.file_linked"}


def test_a_link_out_that_nothing_needs_is_a_note(tmp_path):
    capture = NerfstudioFolder(tmp_path / "scene")
    (capture.folder / "results").symlink_to(tmp_path)
    report = check_capture(capture.folder).report
    assert report.usable
    assert "scene.file_linked" in codes(report)


@pytest.mark.parametrize("inside", ["", "images"])
def test_photographs_behind_a_link_out_are_refused_by_name(tmp_path, inside):
    write_views(tmp_path / "outside")
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / (inside or "photos")).symlink_to(tmp_path / "outside")
    report = check_capture(tmp_path / "scene").report
    assert not report.usable
    assert codes(report) == {"scene.file_linked"}


def test_photographs_may_be_links_to_files_in_a_hidden_store(tmp_path):
    write_views(tmp_path / "scene" / "images")
    for path in list((tmp_path / "scene" / "images").iterdir()):
        move(path, tmp_path / "scene" / ".store" / path.stem)
    assert detect_layout(tmp_path / "scene") == "photographs"
    assert check_capture(tmp_path / "scene").report.num_train_frames == 5


def test_what_several_links_lead_to_is_found_once(tmp_path):
    folder = tmp_path / "scene"
    (folder / "a").mkdir(parents=True)
    (folder / "a" / "1.jpg").touch()
    (folder / ".hidden").mkdir()
    (folder / ".hidden" / "2.jpg").touch()
    (folder / ".hidden" / "again").symlink_to(folder / ".hidden")
    for name, target in {
        "b": "a",
        "c": ".hidden",
        "d": ".hidden",
        "e": ".",
        "f": "nowhere",
        "g": "g",
    }.items():
        (folder / name).symlink_to(target)
    (folder / "3.jpg").symlink_to("a/1.jpg")
    astray = []
    found = [path.relative_to(folder).as_posix() for path in files_below(folder, folder, astray)]
    assert found == ["a/1.jpg", "c/2.jpg"]
    assert [path.name for path in astray] == ["f", "g"]


def test_the_link_on_the_way_is_the_one_that_is_named(tmp_path):
    folder = tmp_path / "scene"
    (folder / "a").mkdir(parents=True)
    (tmp_path / "out" / "b").mkdir(parents=True)
    (folder / "a" / "link").symlink_to(tmp_path / "out")
    path = type(folder)("a/link/b")
    assert link_out(folder, path).as_posix() == "a/link"
    assert not leads_inside(folder / path, folder)
    assert link_out(folder, path / "missing") is None, "a file that is not there is missing, not linked"
