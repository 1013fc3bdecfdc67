"""Photographs of a checkered ball on a spotted table: a standing shadow, exposures that differ, a few lamps.

Beside the ball a block may stand, as clutter or as what a person must take away.
"""

from dataclasses import dataclass

import numpy as np
from lambent_capture.masks.consensus import MaskView
from lambent_capture.masks.photograph import Photograph, SparsePoints
from lambent_capture.scenes.picture_camera import PictureCamera
from numpy import ndarray
from scipy import ndimage
from support.ball_views import ball_hits, rays
from support.captures import look_at

WIDTH, HEIGHT, FOCAL = 200, 150, 210.0
DISTANCE = 4.0
RADIUS = 0.6
CENTRE = np.array([0.0, 0.0, RADIUS])
SHADOW = np.array([0.55, 0.25])
"""Middle of the ball's shadow on the table, z = 0."""
DISTORTION = (-0.04, 0.01)
_SPOTS = np.random.default_rng(3).uniform(size=(128, 128))


@dataclass(frozen=True, slots=True)
class BallOnTable:
    """A capture with its truth."""

    photographs: list[Photograph]
    pictures: list[MaskView]
    masks: list[ndarray]
    """Whether a pixel shows the ball."""
    blocks: list[ndarray]
    """Whether it shows the block."""
    points: SparsePoints
    """On the table and the ball, with an error of a thousandth of the distance."""


def of_pictures(views: list[MaskView]) -> list[Photograph]:
    """Return pictures that are decoded already as photographs."""
    return [Photograph(view.name, view.camera, lambda side, view=view: view.image_srgb) for view in views]


def table_cameras(count: int, distortion: tuple[float, ...] = DISTORTION) -> list[PictureCamera]:
    """Return cameras around the ball at two heights."""
    cameras = []
    for number in range(count):
        azimuth, elevation = 2.0 * np.pi * number / count, np.radians((28.0, 50.0)[number % 2])
        spot = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        cameras.append(
            PictureCamera(
                width=WIDTH,
                height=HEIGHT,
                focal=(FOCAL, FOCAL),
                centre=(0.5 * WIDTH, 0.5 * HEIGHT),
                camera_to_world=look_at(CENTRE + DISTANCE * np.array(spot), CENTRE),
                distortion=distortion,
            )
        )
    return cameras


def ball_on_table(
    count: int = 16,
    *,
    ball: tuple[tuple[int, int, int], tuple[int, int, int]] = ((200, 60, 40), (240, 220, 180)),
    block: ndarray | None = None,
    distortion: tuple[float, ...] = (),
    spots: float = 0.4,
) -> BallOnTable:
    """Return a capture; `block` is the middle of a second ball on the table, painted like the first.

    `spots` is the contrast of the table's pattern, linear light.
    """
    generator = np.random.default_rng(0)
    pictures, masks, blocks = [], [], []
    for number, camera in enumerate(table_cameras(count, distortion)):
        light, hit, second = _seen(camera, ball, block, spots)
        exposed = np.clip(light * (0.8 + 0.4 * (number % 3) / 2.0), 0.0, 1.0)
        encoded = 255.0 * exposed ** (1.0 / 2.2) + 1.5 * generator.normal(size=exposed.shape)
        pictures.append(MaskView(f"v{number:02d}", np.clip(encoded, 0, 255).astype(np.uint8), camera))
        masks.append(hit)
        blocks.append(second)
    on_table = np.column_stack([generator.uniform(-1.6, 1.6, (400, 2)), np.zeros(400)])
    on_table = on_table[np.hypot(on_table[:, 0], on_table[:, 1]) > 0.5]
    directions = generator.normal(size=(200, 3))
    on_ball = CENTRE + RADIUS * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    xyz = np.concatenate([on_table, on_ball[on_ball[:, 2] > 0.1]])
    xyz += 1e-3 * DISTANCE * generator.normal(size=xyz.shape)
    return BallOnTable(of_pictures(pictures), pictures, masks, blocks, SparsePoints(xyz=xyz))


def _seen(
    camera: PictureCamera, ball: tuple, block: ndarray | None, spots: float
) -> tuple[ndarray, ndarray, ndarray]:
    """Return linear light, and which pixels show the ball and the block, by one ray through each pixel."""
    if camera.distortion:
        from lambent_capture.masks.plane_maps import straight_rays

        directions = straight_rays(camera).astype(np.float64)
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    else:
        directions = rays(camera)
    reach = -camera.position[2] / np.minimum(directions[..., 2], -1e-3)
    ground = camera.position[:2] + reach[..., None] * directions[..., :2]
    tone = ndimage.map_coordinates(_SPOTS, (ground * 12.0).transpose(2, 0, 1), order=1, mode="grid-wrap")
    table = (0.35 + spots * (tone[..., None] - 0.5)) * np.array([0.9, 0.75, 0.55])
    shade = np.exp(-(((ground - SHADOW) ** 2).sum(axis=-1) / 0.45**2))
    light = table * (1.0 - 0.6 * shade[..., None])
    hit, points = _hits(camera, directions, CENTRE, RADIUS)
    second = np.zeros_like(hit)
    if block is not None:
        second, near = _hits(camera, directions, block, float(block[2]))
        light = np.where(second[..., None], _checks(near - block, ball), light)
        second &= ~hit
    return np.where(hit[..., None], _checks(points - CENTRE, ball), light), hit, second


def _hits(
    camera: PictureCamera, directions: ndarray, centre: ndarray, radius: float
) -> tuple[ndarray, ndarray]:
    if not camera.distortion:
        return ball_hits(camera, centre, radius)
    towards = centre - camera.position
    along = directions @ towards
    room = radius**2 - (towards @ towards - along**2)
    return room > 0.0, camera.position + (along - np.sqrt(np.maximum(room, 0.0)))[..., None] * directions


def _checks(points: ndarray, colours: tuple) -> ndarray:
    odd = np.sign(np.sin(9.0 * points)).prod(axis=-1)[..., None] > 0.0
    lit = 0.75 + 0.25 * points[..., 2:] / RADIUS
    return lit * np.where(odd, *((np.array(colour) / 255.0) ** 2.2 for colour in colours))
