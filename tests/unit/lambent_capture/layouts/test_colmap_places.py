"""Sparse models and their photographs are found wherever programs put them."""

import shutil

import pytest
from lambent_capture.layouts.colmap_places import model_folder, picture_folder
from lambent_capture.layouts.detect import describe_scene, detect_layout
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.scenes.reading import ROOT
from support.layouts import ColmapBinaryFolder, ColmapTextFolder
from support.uneven_object import NUM_VIEWS

KINDS = pytest.mark.parametrize("kind", [ColmapTextFolder, ColmapBinaryFolder])
PLACES = [
    "sparse",
    "sparse/1",
    "sparse/aligned",
    "colmap/sparse/0",
    "colmap/sparse",
    "distorted/sparse/0",
    ".",
]


def move_model(capture, place):
    """Move the model of a capture to another folder."""
    target = capture.folder / place
    source = capture.folder / "model"
    (capture.folder / "sparse" / "0").rename(source)
    (capture.folder / "sparse").rmdir()
    target.mkdir(parents=True, exist_ok=True)
    for path in source.iterdir():
        path.rename(target / path.name)
    source.rmdir()


@KINDS
@pytest.mark.parametrize("place", PLACES)
def test_the_model_may_lie_in_any_usual_place(tmp_path, kind, place):
    capture = kind(tmp_path / "scene")
    before = describe_scene(capture.folder)
    move_model(capture, place)
    assert model_folder(capture.folder) == place
    assert describe_scene(capture.folder) == before
    assert not inspect_files(capture.folder).report.findings


def test_a_list_of_images_alone_is_no_model(tmp_path):
    (tmp_path / "images.txt").write_text("a.png\nb.png\n")
    assert detect_layout(tmp_path) is None


@KINDS
@pytest.mark.parametrize("order", [("0", "1"), ("1", "0"), ("2", "10")])
def test_the_largest_of_several_models_is_used_and_the_others_are_named(tmp_path, kind, order):
    capture = kind(tmp_path / "scene")
    before = describe_scene(capture.folder)
    capture.write_model(capture.rows()[:4])
    small, large = order
    move_model(capture, "kept")
    kept = capture.folder / "kept"
    capture.write_cameras()
    shutil.copytree(capture.folder / "sparse" / "0", tmp_path / "large")
    shutil.rmtree(capture.folder / "sparse")
    shutil.copytree(kept, capture.folder / "sparse" / small)
    shutil.copytree(tmp_path / "large", capture.folder / "sparse" / large)
    shutil.rmtree(kept)
    assert describe_scene(capture.folder) == before
    (finding,) = inspect_files(capture.folder).report.findings
    assert finding.code == "scene.models_several"
    assert f"sparse/{large} with {NUM_VIEWS} photographs" in finding.message
    assert f"sparse/{small} (4)" in finding.message


def test_of_models_of_one_size_the_first_is_used(tmp_path):
    capture = ColmapBinaryFolder(tmp_path / "scene")
    for name in ("1", "10", "2"):
        shutil.copytree(capture.folder / "sparse" / "0", capture.folder / "sparse" / name)
    assert model_folder(capture.folder) == "sparse/0"
    shutil.rmtree(capture.folder / "sparse" / "0")
    assert model_folder(capture.folder) == "sparse/1"


def test_a_model_that_cannot_be_read_does_not_hide_one_that_can(tmp_path):
    capture = ColmapBinaryFolder(tmp_path / "scene")
    before = describe_scene(capture.folder)
    shutil.copytree(capture.folder / "sparse" / "0", capture.folder / "sparse" / "1")
    (capture.folder / "sparse" / "0" / "images.bin").write_bytes(b"\xff" * 80)
    assert describe_scene(capture.folder) == before


@pytest.mark.parametrize("name", ["input", "image", "photos", "images_4", "frames", "mine/all", "."])
def test_the_photographs_may_lie_in_any_usual_folder(tmp_path, name):
    capture = ColmapTextFolder(tmp_path / "scene")
    shutil.copytree(capture.folder / "images", capture.folder / name, dirs_exist_ok=True)
    shutil.rmtree(capture.folder / "images")
    manifest = describe_scene(capture.folder)
    assert len(manifest.frames) == NUM_VIEWS
    assert manifest.frames[0].images[0].path == f"{name}/IMG_0000.png".removeprefix("./")


def test_names_may_begin_with_the_folder_of_the_photographs(tmp_path):
    capture = ColmapTextFolder(tmp_path / "scene")
    shutil.rmtree(capture.folder / "masks")
    capture.write_model([(turn, shift, f"images/{name}") for turn, shift, name in capture.rows()])
    assert len(describe_scene(capture.folder).frames) == NUM_VIEWS


def test_undistorted_photographs_are_used_with_the_undistorted_model(tmp_path):
    names = [f"{number}.png" for number in range(4)]
    for folder, count in (("images", 3), ("input", 4)):
        (tmp_path / folder).mkdir()
        for name in names[:count]:
            (tmp_path / folder / name).touch()
    assert picture_folder(tmp_path, ROOT, "sparse/0", names).as_posix() == "images", "most are enough"
    assert picture_folder(tmp_path, ROOT, "distorted/sparse/0", names).as_posix() == "input"
