"""Cameras around the object of a bundle, placed like those it was photographed from."""

import statistics

import numpy as np

from lambent_relight.bundle.bundle import Bundle
from lambent_relight.cameras import Camera, turntable


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
    cameras (the medians; the first one's field of view) where they are not given. `size` is the side of the
    square pictures in pixels; 0 takes the longer side of the first camera. Raises CameraError as `turntable`
    does.
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
    own_view_deg = float(np.degrees(2.0 * np.arctan(0.5 * known[0].width / known[0].focal_x)))
    return turntable(
        num_views,
        radius=statistics.median(radii) if radius is None else radius,
        elevation_deg=statistics.median(elevations) if elevation_deg is None else elevation_deg,
        target=target.tolist(),
        width=side,
        height=side,
        field_of_view_deg=own_view_deg if field_of_view_deg is None else field_of_view_deg,
        start_deg=start_deg,
    )
