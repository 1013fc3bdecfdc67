"""Frames have names that tell them apart, whatever their files are called."""

import pytest
from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import check_names, check_sizes, frame_names, listed
from lambent_proto.v1 import scene_pb2


@pytest.mark.parametrize(
    ("paths", "expected"),
    [
        (["images/a.png", "images/b.jpg"], ["a", "b"]),
        (["a.png"], ["a"]),
        (["images/one/a.png", "images/two/a.png"], ["one_a", "two_a"]),
        (["images/a.png", "images/two/a.png"], ["a", "two_a"]),
        (["x/y/IMG.0001.JPG", "x/y/IMG.0002.JPG"], ["IMG.0001", "IMG.0002"]),
        ([], []),
    ],
)
def test_names_leave_out_the_folders_that_all_pictures_share(paths, expected):
    names = frame_names(paths)
    assert [names[path] for path in paths] == expected


def frame(name, path, width=10):
    camera = scene_pb2.Camera(width=width, height=10)
    return scene_pb2.Frame(name=name, images=[scene_pb2.Image(path=path)], camera=camera)


def test_names_that_differ_only_in_case_are_one_name():
    problems = Problems()
    check_names([frame("A", "A.png"), frame("b", "b.png"), frame("a", "a.jpg")], problems)
    (finding,) = problems.findings()
    assert (finding.code, finding.subject) == ("scene.frame_duplicate", "a.jpg")
    assert "A.png" in finding.message


def test_the_odd_sizes_out_are_named():
    problems = Problems()
    check_sizes([frame("a", "a.png"), frame("b", "b.png", 12), frame("c", "c.png")], problems)
    (finding,) = problems.findings()
    assert (finding.code, finding.subject) == ("scene.image_sizes_mixed", "b.png")
    assert "12 x 10" in finding.message


def test_long_lists_are_cut():
    assert listed([str(i) for i in range(8)]) == "0, 1, 2, 3, 4 and 3 more"
    assert listed(["a", "b"]) == "a, b"
