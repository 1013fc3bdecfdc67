"""Glossy Synthetic: objects in folders, splits from a pickle, masks from depth, nothing run."""

import os
import pickle
import shutil

import numpy as np
import pytest
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.loading.load import load_scene
from lambent_proto.v1 import scene_pb2
from support.findings import only
from support.layouts import GlossyFolder
from support.uneven_object import NUM_VIEWS


@pytest.fixture
def capture(tmp_path):
    return GlossyFolder(tmp_path / "GlossySynthetic")


def held_out(folder):
    return {f.name for f in describe_scene(folder).frames if f.split == scene_pb2.SPLIT_TEST}


def test_the_published_split_is_used(capture):
    assert held_out(capture.folder) == {"7", "15"}


@pytest.mark.parametrize("levels", [0, 1, 2])
def test_the_object_may_lie_in_the_folder_or_one_or_two_below(capture, tmp_path, levels):
    folder = tmp_path / "upload"
    shutil.copytree(capture.base, folder.joinpath(*["a", "b"][:levels]))
    split = capture.folder / "synthetic_split_128.pkl"
    shutil.copy(split, folder.joinpath(*["a", "b"][: max(levels - 1, 0)]))
    assert not inspect_files(folder).report.findings
    assert held_out(folder) == {"7", "15"}


def test_without_the_split_every_eighth_view_is_held_out_and_a_note_says_so(capture):
    finding = only(capture.base)
    assert finding.code == "scene.split_missing"
    assert held_out(capture.base) == {"7", "15"}


def test_frames_are_in_the_order_of_their_numbers(capture):
    assert [frame.name for frame in describe_scene(capture.folder).frames] == [
        str(i) for i in range(NUM_VIEWS)
    ]


def test_the_mask_is_what_is_nearer_than_the_background(capture):
    scene = load_scene(capture.folder, describe_scene(capture.folder), max_side=64)
    for view in (*scene.train, *scene.test):
        alpha = view.images["capture"][..., 3]
        np.testing.assert_array_equal(alpha * 255, capture.coverage[int(view.name)])


def test_several_objects_are_an_error_that_names_them(capture):
    shutil.copytree(capture.base, capture.folder / "teapot")
    finding = next(
        f for f in inspect_files(capture.folder).report.findings if f.severity == scene_pb2.SEVERITY_ERROR
    )
    assert finding.code == "scene.object_ambiguous"
    assert "potion, teapot" in finding.message


class Command:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.system, (f"touch {self.path}",)


@pytest.mark.parametrize("place", ["potion/3-camera.pkl", "synthetic_split_128.pkl"])
def test_a_pickle_that_would_run_something_is_refused_and_does_not(capture, tmp_path, place):
    mark = tmp_path / "was_here"
    (capture.folder / place).write_bytes(pickle.dumps([Command(mark), np.eye(3)]))
    finding = next(
        f for f in inspect_files(capture.folder).report.findings if f.severity == scene_pb2.SEVERITY_ERROR
    )
    assert (finding.code, finding.subject) == ("scene.pickle_refused", place)
    assert "system" in finding.message
    assert not mark.exists()


def test_a_pickle_that_is_no_camera_is_still_suspect(capture):
    (capture.base / "network.pkl").write_bytes(pickle.dumps([1]))
    finding = only(capture.folder)
    assert (finding.code, finding.subject) == ("scene.unsupported_file", "potion/network.pkl")


@pytest.mark.parametrize(
    "value",
    [[np.eye(4)], [np.eye(3), np.eye(3)], ["a", "b"], [np.zeros((3, 4)), 5], np.eye(4)],
    ids=["one", "3x3", "texts", "number", "array"],
)
def test_a_pickle_of_something_else_than_two_matrices_is_an_error(capture, value):
    (capture.base / "3-camera.pkl").write_bytes(pickle.dumps(value))
    finding = only(capture.folder)
    assert (finding.code, finding.subject) == ("scene.camera_invalid", "potion/3-camera.pkl")


def test_a_split_of_pictures_that_are_not_there_names_one(capture):
    capture.write_split(["7", "15", "99"])
    finding = only(capture.folder)
    assert (finding.code, finding.subject) == ("scene.file_missing", "99-camera.pkl")


def test_a_split_that_is_none_is_an_error(capture):
    (capture.folder / "synthetic_split_128.pkl").write_bytes(pickle.dumps("all"))
    assert only(capture.folder).code == "scene.metadata_unreadable"


def test_an_object_without_depth_uses_the_transparency_of_its_pictures(capture):
    for index in range(NUM_VIEWS):
        capture.mask(index).unlink()
    assert only(capture.folder).code == "scene.no_mask"
