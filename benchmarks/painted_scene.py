"""Captures with known masks before a background, as photographs without alpha: plain, far, or on a table.

A picture is its object's light times coverage plus the background's times the rest, with noise on the encoded
values. Backgrounds are functions of the camera, so that they fit together between views.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.masks.consensus import MaskView
from lambent_capture.pictures.coverage import frame_mask
from lambent_capture.pictures.pictures import read_picture
from lambent_capture.scenes.picture_camera import PictureCamera
from lambent_core.colour import srgb_from_linear
from lambent_proto.v1 import scene_pb2
from lambent_relight.environment.maps import load_environment
from numpy import ndarray
from scipy import ndimage

NOISE = 0.008
"""Standard deviation of what is added to encoded values."""

Background = Callable[[PictureCamera], Float[ndarray, "height width 3"]]


@dataclass(frozen=True, slots=True)
class Painted:
    """A capture before a background."""

    views: list[MaskView]
    coverages: list[Float[ndarray, "height width"]]
    """What is true, 0..1."""


def plain(*colour: float) -> Background:
    """Return a background of one colour, linear."""
    return lambda camera: np.broadcast_to(np.array(colour), (camera.height, camera.width, 3))


def surroundings(file: Path) -> Background:
    """Return an environment map (linear, z up) as it is seen from each camera, far away."""
    radiance = load_environment(file).radiance
    height, width, _ = radiance.shape

    def seen(camera: PictureCamera) -> ndarray:
        directions = ray_directions(camera)
        column = (np.pi - np.arctan2(directions[..., 1], directions[..., 0])) / (2.0 * np.pi) * width - 0.5
        row = (0.5 * np.pi - np.arcsin(directions[..., 2])) / np.pi * height - 0.5
        place = [row.clip(0, height - 1), column % width]
        return np.stack(
            [ndimage.map_coordinates(radiance[..., i], place, order=1, mode="grid-wrap") for i in range(3)],
            axis=-1,
        )

    return seen


def table(height: float, grain: float, beyond: Background, seed: int = 0) -> Background:
    """Return a plane of brown spots at z = `height`, endless, with `beyond` above its horizon.

    `grain` is the size of the smallest spots in scene units; there are three octaves.
    """
    cells = np.random.default_rng(seed).uniform(size=(3, 64, 64))

    def seen(camera: PictureCamera) -> ndarray:
        directions = ray_directions(camera)
        steep = np.minimum(directions[..., 2], -1e-3)
        reach = (height - camera.position[2]) / steep
        points = camera.position[:2] + reach[..., None] * directions[..., :2]
        tone = sum(
            0.5**octave
            * ndimage.map_coordinates(
                cells[octave], (points / (grain * 2**octave)).transpose(2, 0, 1), order=1, mode="grid-wrap"
            )
            for octave in range(3)
        )
        wood = (0.15 + 0.35 * tone[..., None] / 1.75) * np.array([1.0, 0.62, 0.38])
        below = (directions[..., 2] < -1e-3) & (reach > 0.0)
        return np.where(below[..., None], wood, beyond(camera))

    return seen


def ray_directions(camera: PictureCamera) -> Float[ndarray, "height width 3"]:
    """Return unit world directions through all pixel centres; lens distortion is left out."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    x = (columns - camera.centre[0]) / camera.focal[0]
    y = -(rows - camera.centre[1]) / camera.focal[1]
    directions = np.stack([x, y, -np.ones_like(x)], axis=-1) @ camera.camera_to_world[:3, :3].T
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def paint(folder: Path, background: Background, every: int = 1) -> Painted:
    """Return every `every`-th frame of the capture in `folder`, in its first light, before a background."""
    manifest = describe_scene(folder)
    views, coverages = [], []
    for number, frame in enumerate(list(manifest.frames)[::every]):
        camera = PictureCamera.of_frame(frame)
        light, coverage = _object(folder, frame)
        mixed = light * coverage[..., None] + background(camera) * (1.0 - coverage[..., None])
        noise = NOISE * np.random.default_rng(number).normal(size=mixed.shape)
        views.append(MaskView(frame.name, _encoded(mixed, noise), camera))
        coverages.append(coverage)
    return Painted(views, coverages)


def _object(folder: Path, frame: scene_pb2.Frame) -> tuple[ndarray, ndarray]:
    """Return the light [height, width, 3] of a frame's picture, and how much the object covers."""
    picture = read_picture(folder / frame.images[0].path)
    coverage, mask = picture.coverage(), frame_mask(folder, frame)
    if mask is not None:
        coverage = np.minimum(coverage, mask.coverage)
    return picture.linear().astype(np.float64), coverage.astype(np.float64)


def _encoded(light: ndarray, noise: ndarray) -> UInt8[ndarray, "height width 3"]:
    encoded = np.clip(srgb_from_linear(np.clip(light, 0.0, None)) + noise, 0.0, 1.0)
    return np.round(255.0 * encoded).astype(np.uint8)


def overlap(first: Float[ndarray, "height width"], second: Float[ndarray, "height width"]) -> float:
    """Return the intersection over union of two coverages, cut at one half."""
    one, other = first >= 0.5, second >= 0.5
    return float((one & other).sum() / max((one | other).sum(), 1))
