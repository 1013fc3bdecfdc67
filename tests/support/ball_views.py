"""Views of a ball: silhouettes whose hull, agreement and brightness are known."""

import numpy as np
from lambent_capture.checks.sphere import fibonacci_sphere
from lambent_capture.scenes.picture_camera import PictureCamera
from lambent_capture.scenes.silhouettes import Silhouette
from numpy import ndarray
from support.captures import look_at

SIDE = 64
DISTANCE = 4.0
RADIUS = 0.6


def ball_camera(direction: ndarray) -> PictureCamera:
    """Return a camera at `DISTANCE` in this direction that looks at the origin."""
    return PictureCamera(
        width=SIDE,
        height=SIDE,
        focal=(140.0, 140.0),
        centre=(SIDE / 2, SIDE / 2),
        camera_to_world=look_at(DISTANCE * direction / np.linalg.norm(direction)),
    )


def rays(camera: PictureCamera) -> ndarray:
    """Return the unit directions [height, width, 3] through the middles of the pixels."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    x, y = (columns - camera.centre[0]) / camera.focal[0], -(rows - camera.centre[1]) / camera.focal[1]
    directions = np.stack([x, y, -np.ones_like(x)], axis=-1) @ camera.camera_to_world[:3, :3].T
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def ball_hits(camera: PictureCamera, centre: ndarray, radius: float) -> tuple[ndarray, ndarray]:
    """Return which pixels see a ball [height, width], and where [height, width, 3]."""
    directions = rays(camera)
    towards = centre - camera.position
    along = directions @ towards
    reach = radius**2 - (towards @ towards - along**2)
    points = camera.position + (along - np.sqrt(np.maximum(reach, 0.0)))[..., None] * directions
    return reach > 0.0, points


def ball_views(count: int, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[Silhouette]:
    """Return silhouettes of a ball at `centre` from all around."""
    cameras = [ball_camera(direction) for direction in fibonacci_sphere(count)]
    return [Silhouette(camera, ball_hits(camera, np.array(centre), RADIUS)[0]) for camera in cameras]
