"""Reads the sparse points of a COLMAP model into the coordinates of a manifest."""

from pathlib import Path

import numpy as np
import pycolmap
from jaxtyping import Float64
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_worker.masks.photograph import SparsePoints
from lambent_worker.scenes.colmap import MODEL_FOLDERS

_MOST_ERROR_PX = 2.0
"""Points that are seen further from where they should be are left out."""
_LEAST_VIEWS = 3


def sparse_points(folder: Path, manifest: scene_pb2.SceneManifest) -> SparsePoints | None:
    """Return the points of the capture's COLMAP model in the coordinates of `manifest`, or None.

    None where the capture has no model with points, or the model does not have the manifest's cameras.
    """
    places = [folder / place for place in MODEL_FOLDERS]
    model = next((place for place in places if _has_points(place)), None)
    return None if model is None else points_of_model(model, manifest)


def points_of_model(model: Path, manifest: scene_pb2.SceneManifest) -> SparsePoints | None:
    """Return the points of the COLMAP model in the folder `model`; see `sparse_points`."""
    reconstruction = pycolmap.Reconstruction(model)
    numbers = {frame.images[0].path: i for i, frame in enumerate(f for f in manifest.frames if f.images)}
    views = {}
    for identity in reconstruction.reg_image_ids():
        name = reconstruction.image(identity).name
        number = next((i for path, i in numbers.items() if path == name or path.endswith(f"/{name}")), None)
        if number is not None:
            views[identity] = number
    frames = [frame for frame in manifest.frames if frame.images]
    if len(views) < _LEAST_VIEWS:
        return None
    theirs = np.array([reconstruction.image(identity).projection_center() for identity in views])
    ours = np.array([np.array(frames[i].camera.camera_to_world).reshape(4, 4)[:3, 3] for i in views.values()])
    fit = fitted_similarity(theirs, ours)
    if fit is None:
        return None
    points = [
        (point.xyz, tuple(sorted({views[e.image_id] for e in point.track.elements if e.image_id in views})))
        for point in reconstruction.points3D.values()
        if point.error <= _MOST_ERROR_PX and len(point.track.elements) >= _LEAST_VIEWS
    ]
    if not points:
        return None
    xyz = np.array([point for point, _ in points])
    return SparsePoints(xyz=xyz @ fit[:3, :3].T + fit[:3, 3], seen_by=tuple(seen for _, seen in points))


def fitted_similarity(
    source: Float64[ndarray, "points 3"], target: Float64[ndarray, "points 3"]
) -> Float64[ndarray, "4 4"] | None:
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


def _has_points(place: Path) -> bool:
    return any(
        (place / f"points3D{suffix}").is_file() and (place / f"images{suffix}").is_file()
        for suffix in (".bin", ".txt")
    )
