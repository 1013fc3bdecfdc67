"""Photographs of a box on a plate, both full of texture, taken by cameras that are known.

The table around the plate slips from picture to picture, as if box and plate were turned before a camera that
stands still: only what the masks show fits together.
"""

from functools import cache
from pathlib import Path

import numpy as np
from lambent_capture.scenes.picture_camera import PictureCamera
from numpy import ndarray
from scipy import ndimage
from support.ball_views import rays
from support.captures import look_at, save

SIDE = 320
FOCAL = 400.0
DISTANCE = 4.0
HALF = np.array([0.7, 0.55, 0.6])
"""Half the sides of the box around the origin; plate and table are its lower side's plane."""
PLATE = 1.4
"""Radius."""
TINTS = np.random.default_rng(7).uniform(0.6, 1.0, (7, 3))
"""Colour of each face of the box, and of the table."""
_TEXELS = 512
_PER_UNIT = 50.0
"""Texels per unit; the table repeats after ten units, out of sight."""


def box_cameras(count: int, arc_deg: float = 360.0, elevations: tuple[float, ...] = (25.0, 45.0)) -> list:
    """Return cameras on an arc around the box, by turns at each of the elevations."""
    cameras = []
    for number in range(count):
        azimuth = np.radians(arc_deg * number / count)
        elevation = np.radians(elevations[number % len(elevations)])
        spot = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        cameras.append(
            PictureCamera(
                width=SIDE,
                height=SIDE,
                focal=(FOCAL, FOCAL),
                centre=(SIDE / 2, SIDE / 2),
                camera_to_world=look_at(DISTANCE * np.array(spot)),
            )
        )
    return cameras


def box_picture(camera: PictureCamera, slip: float = 0.0) -> tuple[ndarray, ndarray]:
    """Return an 8-bit picture [height, width, 3] and which pixels show box or plate; four rays per pixel.

    `slip` is how far the table has moved, scene units.
    """
    fine = camera.resized(2 * camera.width, 2 * camera.height)
    colours, box = _traced(fine, slip)
    shape = (camera.height, 2, camera.width, 2)
    mean = colours.reshape(*shape, 3).mean(axis=(1, 3))
    return np.round(255.0 * mean).astype(np.uint8), box.reshape(shape).mean(axis=(1, 3)) >= 0.5


def write_photographs(
    folder: Path, cameras: list, *, masks: Path | None = None, cut_out: bool = False
) -> dict[str, ndarray]:
    """Write `photo_00.png` and so on, with masks or alpha if asked for; return the true poses by name.

    Poses are camera-to-world with axes x right, y up, looking along -z.
    """
    poses = {}
    for number, camera in enumerate(cameras):
        picture, box = box_picture(camera, slip=0.37 * number)
        alpha = np.where(box, 255, 0).astype(np.uint8)
        name = f"photo_{number:02d}.png"
        save(folder / name, np.dstack([picture, alpha]) if cut_out else picture)
        if masks is not None:
            save(masks / name, alpha)
        poses[name] = camera.camera_to_world
    return poses


def _traced(camera: PictureCamera, slip: float) -> tuple[ndarray, ndarray]:
    directions = rays(camera)
    origin = camera.position
    with np.errstate(divide="ignore"):
        ends = np.stack([(side * HALF - origin) / directions for side in (-1.0, 1.0)])
    near, far = ends.min(axis=0), ends.max(axis=0)
    enters, axis = near.max(axis=-1), near.argmax(axis=-1)
    box = (enters <= far.min(axis=-1)) & (enters > 0.0)
    table = np.where(directions[..., 2] < 0.0, (-HALF[2] - origin[2]) / directions[..., 2], np.inf)
    colours = np.full((*box.shape, 3), 0.6)
    kept = box.copy()
    textures = _textures()
    for face in range(7):
        shown = box & (2 * axis + _side(directions, axis) == face)
        if face == 6:
            shown = ~box & (table < 12.0)
        reach = np.where(box, enters, table)[shown]
        points = origin + reach[:, None] * directions[shown]
        plane = [i for i in range(3) if i != (2 if face == 6 else face // 2)]
        if face == 6:
            inside = np.hypot(points[:, 0], points[:, 1]) < PLATE
            kept[shown] = inside
            points[~inside] += slip
        place = (points[:, plane].T * _PER_UNIT) % _TEXELS
        tone = ndimage.map_coordinates(textures[face], place, order=1, mode="grid-wrap")
        colours[shown] = tone[:, None] * TINTS[face]
    return colours, kept


def _side(directions: ndarray, axis: ndarray) -> ndarray:
    """Return 0 where the lower side along `axis` is met, 1 where the upper one is."""
    along = np.take_along_axis(directions, axis[..., None], axis=-1)[..., 0]
    return (along < 0.0).astype(int)


@cache
def _textures() -> ndarray:
    """Return seven grey textures [7, texels, texels] of spots in three sizes."""
    noise = np.random.default_rng(0).normal(size=(7, _TEXELS, _TEXELS))
    spots = sum(
        ndimage.gaussian_filter(noise, (0, size, size), mode="wrap") * size for size in (1.0, 2.0, 5.0)
    )
    return np.clip(0.5 + 0.35 * spots, 0.02, 0.98)
