"""Cameras with square pictures that look at the origin, and meshes of fields."""

import numpy as np
from lambent_asset.mesh.mesh import Mesh
from lambent_core.scene import Camera
from lambent_relight.cameras import look_at
from skimage.measure import marching_cubes


def square_camera(place: tuple[float, float, float], side: int, focal: float) -> Camera:
    """Return a camera at `place` with pictures of `side` pixels squared."""
    return Camera(
        width=side,
        height=side,
        focal_x=focal,
        focal_y=focal,
        centre_x=side / 2,
        centre_y=side / 2,
        camera_to_world=look_at(place, (0.0, 0.0, 0.0)),
    )


def mesh_of(field: np.ndarray) -> Mesh:
    """Return the surface where a field, given at even places from -1 to 1 along each axis, is zero."""
    cell = 2.0 / (len(field) - 1)
    vertices, faces, _, _ = marching_cubes(field, 0.0, gradient_direction="ascent")
    return Mesh((vertices * cell - 1.0).astype(np.float32), faces.astype(np.int32), cell)
