"""Lenses in transforms files are understood or refused, never guessed."""

import pytest
from lambent_proto.v1 import scene_pb2
from lambent_worker.scenes.inspect import inspect_capture
from support.captures import edit_frame, write_blender


def codes(report):
    return [f.code for f in report.findings if f.severity == scene_pb2.SEVERITY_ERROR]


LENSES = {
    "fisheye model": ({"camera_model": "OPENCV_FISHEYE"}, "scene.lens_unsupported"),
    "fisheye switch": ({"is_fisheye": True}, "scene.lens_unsupported"),
    "panorama": ({"camera_model": "EQUIRECTANGULAR"}, "scene.lens_unsupported"),
    "ambiguous coefficient": ({"k4": 0.1}, "scene.lens_unsupported"),
    "no number": ({"k1": "strong"}, "scene.lens_invalid"),
    "folding": ({"k1": -9.0}, "scene.lens_invalid"),
}


@pytest.mark.parametrize(("lens", "code"), LENSES.values(), ids=LENSES.keys())
def test_a_lens_that_no_pinhole_can_stand_in_for_is_refused_with_its_frame(tmp_path, lens, code):
    folder = write_blender(tmp_path)
    edit_frame(folder, 1, **lens)
    report = inspect_capture(folder)[0]
    assert codes(report) == [code]
    assert "r_1" in report.findings[0].message
