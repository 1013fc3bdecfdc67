"""The solved model as others read it: cameras of the original files at full size, z up where that is known.

COLMAP solved it in work pixels with portrait photographs lying on their side (`database`). Here every
photograph gets a camera of its stored size; a lens that took portrait and landscape ones becomes two cameras
with the same parameters.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from lambent_capture.arrays import Pose64, Rotation64
from lambent_capture.poses.features import work_scale
from lambent_capture.poses.shots import Shot

STANDING = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Camera axes of a portrait photograph from those of the same one turned clockwise by a quarter."""


def full_size_model(model: Any, names: Sequence[str], shots: Sequence[Shot], max_side: int) -> Any:
    """Return a new `pycolmap.Reconstruction` of the original files from one of the database.

    Its images are named by `names` (the number of a photograph is its place there), cameras and points in the
    pictures are in stored pixels, points in space keep their places and numbers, and their errors become
    those in stored pixels (the mean over the photographs that see a point).
    """
    full = pycolmap.Reconstruction()
    cameras: dict[tuple[int, bool], int] = {}
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        number = int(image.name)
        shot = shots[number]
        scale = work_scale(shot.width, shot.height, max_side)
        key = image.camera_id, shot.is_portrait
        if key not in cameras:
            cameras[key] = len(cameras) + 1
            camera = _camera(model.camera(image.camera_id), shot, scale)
            camera.camera_id = cameras[key]
            full.add_camera_with_trivial_rig(camera)
        places = np.array([point.xy for point in image.points2D]).reshape(-1, 2) / scale
        if shot.is_portrait:
            places = np.stack([places[:, 1], shot.height - places[:, 0]], axis=1)
        pose = image.cam_from_world().matrix()
        made = pycolmap.Image(
            name=names[number], keypoints=places, camera_id=cameras[key], image_id=number + 1
        )
        full.add_image_with_trivial_frame(
            made, pycolmap.Rigid3d(STANDING @ pose if shot.is_portrait else pose)
        )
    _add_points(full, model)
    return full


def turn(model: Any, rotation: Rotation64) -> None:
    """Turn the world of a model."""
    matrix = np.concatenate([rotation, np.zeros((3, 1))], axis=1)
    model.transform(pycolmap.Sim3d(matrix))


def camera_poses(model: Any) -> dict[str, Pose64]:
    """Return camera-to-world of each registered image by name; axes x right, y down, z forward."""
    poses = {}
    for identity in model.reg_image_ids():
        image = model.image(identity)
        pose = np.eye(4)
        pose[:3] = image.cam_from_world().inverse().matrix()
        poses[image.name] = pose
    return poses


def widest_field_deg(model: Any) -> float:
    """Return the field of view of the widest lens along its longer side, degrees."""
    return max(
        float(np.degrees(2.0 * np.arctan(0.5 * max(camera.width, camera.height) / camera.params[0])))
        for camera in model.cameras.values()
    )


def write_model(model: Any, folder: Path) -> None:
    """Write a model as COLMAP's binary files."""
    folder.mkdir(parents=True, exist_ok=True)
    model.write_binary(folder)


def _camera(lens: Any, shot: Shot, scale: float) -> Any:
    focal, _, _, distortion = lens.params
    return pycolmap.Camera(
        model=lens.model,
        width=shot.width,
        height=shot.height,
        params=[focal / scale, 0.5 * shot.width, 0.5 * shot.height, distortion],
    )


def _add_points(full: Any, model: Any) -> None:
    """Add the points of `model` with their tracks; the images of `full` have its numbers plus one."""
    numbers = {image_id: int(model.image(image_id).name) + 1 for image_id in model.reg_image_ids()}
    for point_id in sorted(model.point3D_ids()):
        point = model.point3D(point_id)
        track = pycolmap.Track()
        for element in point.track.elements:
            track.add_element(numbers[element.image_id], element.point2D_idx)
        made = pycolmap.Point3D()
        made.xyz, made.color, made.track = point.xyz, point.color, track
        full.add_point3D_with_id(point_id, made)
    full.update_point_3d_errors()
