"""Cameras that cannot see a common object are refused with advice for whoever made them."""

import numpy as np
import pytest
from lambent_capture.problems import Problems
from lambent_capture.scenes.rig import check_rig
from lambent_proto.v1 import scene_pb2
from support.captures import look_at


@pytest.mark.parametrize(
    ("found_here", "advice"), [(True, "walk around the object"), (False, "axes of the poses")]
)
def test_cameras_that_look_outwards_are_refused(found_here, advice):
    frames = []
    for number in range(12):
        angle = 2.0 * np.pi * number / 12
        eye = np.array([np.cos(angle), np.sin(angle), 0.1 * np.sin(3.0 * angle)])
        camera = scene_pb2.Camera(width=40, height=30, focal_x=40, focal_y=40, centre_x=20, centre_y=15)
        camera.camera_to_world.extend(look_at(eye, 3.0 * eye).ravel().tolist())
        frames.append(scene_pb2.Frame(name=f"v{number}", camera=camera, split=scene_pb2.SPLIT_TRAIN))
    problems = Problems()
    check_rig(frames, problems, found_here=found_here)
    (finding,) = problems.findings()
    assert finding.code == "scene.cameras_look_away"
    assert advice in finding.message
    assert ("photographs" in finding.message) == found_here
