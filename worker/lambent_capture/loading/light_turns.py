"""The part of a scene that its light stands still with, and how it turns from photograph to photograph.

A turn is a rotation from world directions at one photograph to the frame of the light, which has the world's
axes at the reference photograph: there it is the identity, and a map of the light is upright.
"""

from typing import Literal, cast, get_args

import numpy as np
from lambent_core.errors import UsageError
from lambent_proto.v1 import scene_pb2

from lambent_capture.arrays import Rotation64

LEAST_HORIZONTAL = 0.25
"""Horizontal part of a camera's axis from which it has an azimuth: 14 degrees from the vertical."""

LightFixedTo = Literal["auto", "scene", "camera", "room"]
"""scene: the light stands still with the object, as where a camera is carried around it. camera: it keeps its
place in the camera's picture, whichever way the object was turned or tilted. room: the object turned about
the vertical, and the camera may have been raised or tilted meanwhile. auto: camera, where the search for
cameras has seen a background that stands still, else scene."""


def as_light_fixed_to(name: str) -> LightFixedTo:
    """Return `name` where it is one of the settings; raises `UsageError` otherwise."""
    if name not in get_args(LightFixedTo):
        known = ", ".join(get_args(LightFixedTo))
        raise UsageError(
            "light.fixed_to_unknown", f'--light-fixed-to "{name}": expected one of {known}; choose one'
        )
    return cast(LightFixedTo, name)


def fix_light(manifest: scene_pb2.SceneManifest, fixed_to: Literal["scene", "camera", "room"]) -> None:
    """Say in `manifest` what the light stands still with; the reference is its first training photograph."""
    manifest.light_fixed_to = "" if fixed_to == "scene" else fixed_to
    del manifest.light_frame[:]
    if manifest.light_fixed_to:
        frames = [frame for frame in manifest.frames if frame.split == scene_pb2.SPLIT_TRAIN]
        manifest.light_frame.extend(_rotation(frames[0]).ravel().tolist())


def adopt_light(manifest: scene_pb2.SceneManifest, trained: scene_pb2.SceneManifest) -> None:
    """Give `manifest` the light's frame of the capture that was trained on; both are in one world."""
    manifest.light_fixed_to = trained.light_fixed_to
    manifest.light_frame[:] = trained.light_frame


def light_turn(manifest: scene_pb2.SceneManifest, frame: scene_pb2.Frame) -> Rotation64 | None:
    """Return the rotation from the world to the light's frame at `frame`, None where the light does not turn.

    Fixed to the camera it is C_ref C^T, with the rotations C from camera axes to the world; fixed to the room
    it is the turn about +z from the azimuth of this camera to that of the reference.
    """
    if not manifest.light_fixed_to:
        return None
    reference = np.array(manifest.light_frame).reshape(3, 3)
    here = _rotation(frame)
    if manifest.light_fixed_to == "camera":
        return reference @ here.T
    angle = _turn_about_vertical(reference, here)
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _rotation(frame: scene_pb2.Frame) -> Rotation64:
    return np.array(frame.camera.camera_to_world).reshape(4, 4)[:3, :3]


def _turn_about_vertical(reference: Rotation64, here: Rotation64) -> float:
    """Return by which angle about +z a camera has to turn to look from where the reference looks, radians.

    From the horizontal parts of where they look from, however they were rolled. For cameras that look almost
    straight down or up it is the twist about +z in the rotation from one to the other.
    """
    back = [reference[:, 2], here[:, 2]]
    if min(float(np.hypot(axis[0], axis[1])) for axis in back) > LEAST_HORIZONTAL:
        there, from_here = (np.arctan2(axis[1], axis[0]) for axis in back)
        return float(there - from_here)
    between = reference @ here.T
    return float(np.arctan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1]))
