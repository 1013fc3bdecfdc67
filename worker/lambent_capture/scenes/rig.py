"""Checks whether the cameras of a capture can see a common object."""

from dataclasses import replace

import numpy as np
from lambent_proto.v1 import scene_pb2

from lambent_capture.arrays import Pose64, Vector64
from lambent_capture.problems import Problems
from lambent_capture.scenes.conventions import CONVENTIONS
from lambent_capture.scenes.extent import camera_axes, looked_at_point, stand_apart
from lambent_capture.scenes.picture_camera import PictureCamera

MIN_TRAIN_FRAMES = 3


def check_rig(frames: list[scene_pb2.Frame], problems: Problems, *, found_here: bool = False) -> None:
    """Note in `problems` what makes it impossible or unlikely to reconstruct anything from these cameras.

    `found_here`: they were not given by the user, so the advice is about photographs.
    """
    trained = [frame for frame in frames if frame.split == scene_pb2.SPLIT_TRAIN]
    if len(trained) < MIN_TRAIN_FRAMES:
        problems.error(
            "scene.too_few_images",
            f"found {len(trained)} usable training photographs, at least {MIN_TRAIN_FRAMES} are needed (40 "
            "or more for a good result); add photographs from other sides",
        )
    if len(frames) < 2:
        return
    positions, directions = camera_axes(frames)
    spread = np.linalg.norm(positions - positions[0], axis=-1).max()
    if spread <= 1e-6 * max(1.0, float(np.abs(positions).max())):
        problems.error(
            "scene.cameras_coincide",
            "all cameras stand on one spot, so depth cannot be seen; photograph the object from several "
            f"places and solve the poses again{_fitting_convention(frames)}",
        )
        return
    centre = looked_at_point(positions, directions)
    if centre is None:
        problems.error(
            "scene.cameras_parallel",
            "all cameras look in the same direction, so there is no point they look at; photograph the "
            "object from several sides, or check the axes of the poses (looking along -z)"
            f"{_fitting_convention(frames)}",
        )
        return
    _check_sight(frames, centre, problems, found_here=found_here)


def _fitting_convention(frames: list[scene_pb2.Frame]) -> str:
    """Return the end of a message: how the poses would make sense, if there is such a way."""
    poses = np.array([frame.camera.camera_to_world for frame in frames]).reshape(-1, 4, 4)
    for convention in CONVENTIONS:
        turned = convention.applied(poses)
        positions, directions = turned[:, :3, 3], -turned[:, :3, 2]
        centre = looked_at_point(positions, directions)
        if centre is None or not stand_apart(positions, centre):
            continue
        sights = [_sight(frame.camera, pose, centre) for frame, pose in zip(frames, turned, strict=True)]
        if all(shown for _, shown in sights):
            return f"; they make sense read {convention.advice}"
    return ""


def _check_sight(
    frames: list[scene_pb2.Frame], centre: Vector64, problems: Problems, *, found_here: bool
) -> None:
    poses = np.array([frame.camera.camera_to_world for frame in frames]).reshape(-1, 4, 4)
    sights = [_sight(frame.camera, pose, centre) for frame, pose in zip(frames, poses, strict=True)]
    depth, inside = np.array(sights).T
    if (depth < 0.0).mean() > 0.5:
        advice = (
            "the photographs were taken outwards, from one spot or around it: walk around the object, and "
            "keep it in the picture"
            if found_here
            else f"check the axes of the poses{_fitting_convention(frames)}"
        )
        problems.error(
            "scene.cameras_look_away",
            f"{int((depth < 0.0).sum())} of {len(frames)} cameras look away from the point they surround; "
            f"{advice}",
        )
        return
    blind = [frame for frame, ok in zip(frames, inside, strict=True) if not ok]
    if len(blind) > 0.5 * len(frames):
        problems.error(
            "scene.no_overlap",
            f"{len(blind)} of {len(frames)} cameras do not have the common point in the picture, so their "
            "views do not overlap; check poses, focal length and that the files belong together"
            f"{_fitting_convention(frames)}",
        )
        return
    for frame in blind:
        problems.warning(
            "scene.camera_looks_elsewhere",
            f'frame "{frame.name}" does not show the point the other cameras look at; check its pose or '
            "leave it out",
            frame.name,
        )


def _sight(camera: scene_pb2.Camera, pose: Pose64, point: Vector64) -> tuple[float, bool]:
    """Return the depth of a point in front of a camera (scene units) and whether the picture shows it."""
    seen = replace(PictureCamera.of_pinhole(camera), camera_to_world=pose)
    (column,), (row,), (depth,) = seen.project(point[None])
    shown = depth > 0.0 and 0.0 <= column <= camera.width and 0.0 <= row <= camera.height
    return depth, bool(shown)
