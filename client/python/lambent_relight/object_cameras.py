"""Cameras around the object of a bundle, placed like those it was photographed from."""

import math
import statistics
from collections.abc import Sequence

import numpy as np

from lambent_relight.baked.mesh import MESH_PATH, read_mesh
from lambent_relight.bundle.bundle import Bundle
from lambent_relight.cameras import Camera, turntable

_MARGIN = 1.05
"""Room around the object, as a factor on its size in the picture."""
_WIDEST_DEG = 120.0
"""Field of view up to which a camera is widened; closer to the object, parts of it stay outside."""


def around_object(
    bundle: Bundle,
    num_views: int,
    *,
    size: int = 0,
    start_deg: float = 0.0,
    elevation_deg: float | None = None,
    radius: float | None = None,
    field_of_view_deg: float | None = None,
) -> list[Camera]:
    """Return a turntable around the middle of the bundle's box.

    Distance [scene units], height and horizontal field of view [degrees] are those of the bundle's own
    cameras (the medians; the first one's field of view) where they are not given. The field of view is
    widened where the object does not fit into it, as after photographs that were cut to the object. `size` is
    the side of the square pictures in pixels; 0 takes the longer side of the first camera. Raises CameraError
    as `turntable` does.
    """
    known = bundle.cameras()
    target = (np.array(bundle.manifest.bounds.minimum) + np.array(bundle.manifest.bounds.maximum)) / 2.0
    offsets = [camera.camera_to_world[:3, 3] - target for camera in known]
    radii = [float(np.linalg.norm(offset)) for offset in offsets]
    elevations = [
        float(np.degrees(np.arcsin(np.clip(offset[2] / distance, -1.0, 1.0))))
        for offset, distance in zip(offsets, radii, strict=True)
    ]
    side = size or max(known[0].width, known[0].height)

    def placed(field_of_view_deg: float) -> list[Camera]:
        return turntable(
            num_views,
            radius=statistics.median(radii) if radius is None else radius,
            elevation_deg=statistics.median(elevations) if elevation_deg is None else elevation_deg,
            target=target.tolist(),
            width=side,
            height=side,
            field_of_view_deg=field_of_view_deg,
            start_deg=start_deg,
        )

    if field_of_view_deg is not None:
        return placed(field_of_view_deg)
    own_view_deg = float(np.degrees(2.0 * np.arctan(0.5 * known[0].width / known[0].focal_x)))
    return placed(max(own_view_deg, _least_view_deg(bundle, placed(own_view_deg))))


def _least_view_deg(bundle: Bundle, cameras: Sequence[Camera]) -> float:
    """Return the field of view [degrees] in which the mesh fits for all cameras; 0 where there is no mesh."""
    if not any(file.path == MESH_PATH for file in bundle.manifest.files):
        return 0.0
    vertices = read_mesh(bundle).vertices
    largest = 0.0
    for camera in cameras:
        pose = camera.camera_to_world
        local = (vertices - pose[:3, 3]) @ pose[:3, :3]
        depth = np.maximum(-local[:, 2], 1e-9)
        largest = max(largest, float((np.abs(local[:, :2]) / depth[:, None]).max()))
    return min(math.degrees(2.0 * math.atan(_MARGIN * largest)), _WIDEST_DEG)
