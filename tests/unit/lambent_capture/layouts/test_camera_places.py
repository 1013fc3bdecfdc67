"""Cameras one folder deeper are used if they are the only ones; all that are not used are named."""

import shutil

import pytest
from lambent_capture.checks.check import check_capture
from lambent_capture.layouts.camera_places import deeper
from lambent_capture.layouts.detect import collect_scene, describe_scene, detect_layout
from lambent_capture.masks.sparse import sparse_points
from lambent_capture.problems import Problems
from support.captures import write_tensoir
from support.layouts import BlenderFolder, ColmapBinaryFolder, ColmapTextFolder, NerfstudioFolder
from support.photographs import write_views
from support.uneven_object import NUM_VIEWS

CAPTURES = pytest.mark.parametrize("layout", [NerfstudioFolder, BlenderFolder, ColmapTextFolder])


def looked_at(folder):
    problems = Problems()
    return collect_scene(folder, None, problems), problems.findings()


@CAPTURES
@pytest.mark.parametrize("place", ["capture", "a/b"])
def test_a_capture_in_a_folder_is_read_with_its_cameras(tmp_path, layout, place):
    capture = layout(tmp_path / "scene" / place)
    inner = collect_scene(capture.folder, None, Problems())
    manifest, findings = looked_at(tmp_path / "scene")
    assert [(each.code, each.subject) for each in findings] == [("scene.cameras_in_folder", place)]
    assert (manifest.layout, manifest.bounds) == (inner.layout, inner.bounds)
    for ours, theirs in zip(manifest.frames, inner.frames, strict=True):
        assert ours.camera == theirs.camera
        assert ours.images[0].path == f"{place}/{theirs.images[0].path}"
        assert ours.mask == (f"{place}/{theirs.mask}" if theirs.mask else "")
    report = check_capture(tmp_path / "scene").report
    assert report.usable
    assert report.layout == layout.name


@CAPTURES
def test_cameras_in_a_folder_may_be_about_photographs_above_it(tmp_path, layout):
    capture = layout(tmp_path / "scene")
    inner = capture.folder / "solved"
    inner.mkdir()
    for name in ("sparse", "transforms.json", "transforms_train.json"):
        if (capture.folder / name).exists():
            (capture.folder / name).rename(inner / name)
    manifest, findings = looked_at(capture.folder)
    assert [each.code for each in findings] == ["scene.cameras_in_folder"]
    assert len(manifest.frames) == NUM_VIEWS
    assert all(bool(frame.mask) == capture.has_mask_files() for frame in manifest.frames)


def test_paths_may_lead_up_as_far_as_the_capture(tmp_path):
    capture = NerfstudioFolder(tmp_path / "scene")
    entries = [
        {**each, "file_path": "../" + each["file_path"], "mask_path": "../" + each["mask_path"]}
        for each in capture.entries()
    ]
    capture.write_cameras(entries)
    (capture.folder / "solved").mkdir()
    (capture.folder / "transforms.json").rename(capture.folder / "solved" / "transforms.json")
    assert len(describe_scene(capture.folder).frames) == NUM_VIEWS
    (capture.folder / "solved" / "transforms.json").rename(capture.folder / "transforms.json")
    assert {each.code for each in looked_at(capture.folder)[1]} >= {"scene.path_unsafe"}


def test_of_several_captures_none_is_chosen_and_all_are_named(tmp_path):
    for name in ("one", "two"):
        NerfstudioFolder(tmp_path / "scene" / name)
    assert detect_layout(tmp_path / "scene") == "photographs"
    findings = looked_at(tmp_path / "scene")[1]
    assert "one (nerfstudio), two (nerfstudio)" in next(
        each.message for each in findings if each.code == "scene.cameras_unused"
    )


def test_cameras_that_do_not_fit_the_photographs_are_named_with_the_reason(tmp_path):
    write_views(tmp_path / "scene" / "photos")
    capture = NerfstudioFolder(tmp_path / "other")
    (tmp_path / "scene" / "solved").mkdir()
    shutil.copy(capture.folder / "transforms.json", tmp_path / "scene" / "solved")
    manifest, findings = looked_at(tmp_path / "scene")
    assert manifest.layout == "photographs"
    (finding,) = findings
    assert finding.code == "scene.cameras_unused"
    assert "there is no solved/images/frame_00000.jpg" in finding.message


@pytest.mark.parametrize("layout", [NerfstudioFolder, ColmapBinaryFolder])
def test_cameras_beside_the_folder_that_was_given_are_named(tmp_path, layout):
    capture = layout(tmp_path / "scene")
    report = check_capture(capture.folder / "images").report
    message = next(each.message for each in report.findings if each.code == "scene.cameras_unused")
    assert 'give the folder "scene"' in message


FILES = (
    *("sparse/0/cameras.bin", "poses_bounds.npy", "cameras_sphere.npz", "cameras.xml", "sfm/scene.sfm"),
    "reconstruction.json",
)


@pytest.mark.parametrize("name", FILES)
def test_cameras_in_a_form_that_is_not_read_are_named(tmp_path, name):
    write_views(tmp_path / "scene" / "images")
    (tmp_path / "scene" / name).parent.mkdir(exist_ok=True, parents=True)
    (tmp_path / "scene" / name).touch()
    (finding,) = looked_at(tmp_path / "scene")[1]
    assert (finding.code, finding.subject) == ("scene.cameras_unused", name)


def test_the_points_of_a_model_in_a_folder_are_found(tmp_path):
    capture = ColmapTextFolder(tmp_path / "scene" / "capture")
    track = " ".join(f"{number} 0" for number in range(1, 9))
    text = f"1 0.1 0.2 0.3 9 9 9 0.5 {track}\n"
    (capture.folder / "sparse" / "0" / "points3D.txt").write_text(text)
    manifest = describe_scene(tmp_path / "scene")
    found = sparse_points(tmp_path / "scene", manifest)
    assert found is not None
    assert len(found.xyz) == 1


def test_cameras_that_a_run_has_found_are_not_those_of_the_capture(tmp_path):
    capture = ColmapTextFolder(tmp_path / "scene")
    found = capture.folder / "run" / "cameras"
    found.mkdir(parents=True)
    (capture.folder / "sparse").rename(found / "sparse")
    (found / "cameras.json").write_text("{}")
    assert detect_layout(capture.folder) == "photographs"
    assert not looked_at(capture.folder)[1]


def test_captures_inside_of_captures_are_one(tmp_path):
    ColmapTextFolder(tmp_path / "a")
    write_tensoir(tmp_path / "b")
    assert [(place.as_posix(), name) for place, name in deeper(tmp_path)] == [("a", "colmap")]
