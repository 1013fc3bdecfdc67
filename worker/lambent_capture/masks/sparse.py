"""Reads the sparse points of a COLMAP model into the coordinates of a manifest."""

from pathlib import Path

import numpy as np
from lambent_proto.v1 import scene_pb2

from lambent_capture.arrays import Points64, Pose64
from lambent_capture.layouts import colmap
from lambent_capture.layouts.camera_places import place_of
from lambent_capture.layouts.colmap_model import read_images
from lambent_capture.layouts.colmap_places import images_file, model_folder
from lambent_capture.layouts.colmap_points import read_points
from lambent_capture.layouts.named_files import folded
from lambent_capture.masks.photograph import SparsePoints

_MOST_ERROR_PX = 2.0
"""Points that are seen further from where they should be are left out."""
_LEAST_VIEWS = 3


def sparse_points(
    folder: Path, manifest: scene_pb2.SceneManifest, cameras: Path | None = None
) -> SparsePoints | None:
    """Return the points of a capture's COLMAP model in the coordinates of `manifest`, or None.

    The model is that in `cameras`, where cameras were found for photographs, else the capture's own. None
    where there is no model with points, or it does not have the manifest's cameras. Raises `ModelError` where
    its files cannot be read.
    """
    root = cameras or folder
    if cameras is None:
        root = root / place_of(folder, colmap.NAME)
    place = model_folder(root)
    return None if place is None else points_of_model(root / place, manifest)


def points_of_model(model: Path, manifest: scene_pb2.SceneManifest) -> SparsePoints | None:
    """Return the points of the COLMAP model in the folder `model`; see `sparse_points`."""
    points = read_points(model)
    if points is None:
        return None
    frames = [frame for frame in manifest.frames if frame.images]
    numbers = {folded(frame.images[0].path): number for number, frame in enumerate(frames)}
    images = {}
    for image in read_images(images_file(model)):
        name = folded(image.name.replace("\\", "/"))
        number = next((i for path, i in numbers.items() if path == name or path.endswith(f"/{name}")), None)
        if number is not None:
            images[image.number] = (number, image.position)
    if len(images) < _LEAST_VIEWS:
        return None
    theirs = np.array([position for _, position in images.values()])
    ours = np.array(
        [np.array(frames[i].camera.camera_to_world).reshape(4, 4)[:3, 3] for i, _ in images.values()]
    )
    fit = fitted_similarity(theirs, ours)
    seen_by = [tuple(sorted(images[i][0] for i in seen if i in images)) for seen in points.images]
    kept = [
        i for i, seen in enumerate(seen_by) if len(seen) >= _LEAST_VIEWS and points.error[i] <= _MOST_ERROR_PX
    ]
    if fit is None or not kept:
        return None
    return SparsePoints(
        xyz=points.xyz[kept] @ fit[:3, :3].T + fit[:3, 3], seen_by=tuple(seen_by[i] for i in kept)
    )


def fitted_similarity(source: Points64, target: Points64) -> Pose64 | None:
    """Return the similarity that takes `source` to `target`, or None where none does to a hundredth.

    Source: Umeyama, Least-squares estimation of transformation parameters, PAMI 1991, Eq. 40 to 42.
    """
    from_middle, to_middle = source - source.mean(axis=0), target - target.mean(axis=0)
    left, scales, right = np.linalg.svd(to_middle.T @ from_middle)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ sign @ right
    size = float((from_middle**2).sum())
    if size <= 0.0:
        return None
    scale = float((scales * np.diag(sign)).sum()) / size
    matrix = np.eye(4)
    matrix[:3, :3] = scale * rotation
    matrix[:3, 3] = target.mean(axis=0) - scale * rotation @ source.mean(axis=0)
    error = np.linalg.norm(source @ matrix[:3, :3].T + matrix[:3, 3] - target, axis=1)
    spread = float(np.sqrt((to_middle**2).sum(axis=1).mean()))
    return matrix if float(np.median(error)) <= 0.01 * spread else None
