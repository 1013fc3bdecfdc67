"""Maps between pictures and the support, both ways; lens distortion included."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64
from numpy import ndarray

from lambent_capture.arrays import Colours32
from lambent_capture.masks.support_plane import SupportPlane
from lambent_capture.scenes.picture_camera import PictureCamera

_STEP = 4
NOWHERE = -1.0e4
"""Coordinate of what is not on the orthophoto, or not in the picture; `cv2.remap` returns 0 there."""


@dataclass(frozen=True, kw_only=True, slots=True)
class OrthoGrid:
    """A square of the support plane as a picture; texel centres at whole numbers as in `cv2.remap`."""

    plane: SupportPlane
    half: float
    """Half its side, scene units."""
    cells: int
    """Texels along a side."""

    @property
    def texel(self) -> float:
        """Return the side of a texel, scene units."""
        return 2.0 * self.half / self.cells

    def texels_of(self, local: Float[ndarray, "points 2"]) -> Float[ndarray, "points 2"]:
        """Return the texel coordinates (column, row) of points in coordinates of the plane."""
        return (local + self.half) / self.texel - 0.5


def straight_rays(camera: PictureCamera) -> Colours32:
    """Return directions through the pixel centres, scene coordinates, depth 1; distortion is undone.

    Undone on every fourth pixel and interpolated, which is exact to a hundredth of a pixel.
    """
    columns, rows = _coarse(camera.width), _coarse(camera.height)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1) + 0.5
    seen = straightened(camera, pixels.reshape(-1, 2)).reshape(pixels.shape)
    across, up, back = camera.camera_to_world[:3, :3].T
    rays = seen[..., :1] * across - seen[..., 1:] * up - back
    return _fine(rays.astype(np.float32), (camera.width, camera.height))


def straightened(camera: PictureCamera, pixels: Float64[ndarray, "points 2"]) -> Float64[ndarray, "points 2"]:
    """Return (x, y) at depth 1, y downwards, of the rays through pixels; distortion is undone."""
    focal, centre = np.array(camera.focal), np.array(camera.centre)
    if not any(camera.distortion):
        return (pixels - centre) / focal
    matrix = np.array([[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]])
    lens = np.zeros(8)
    lens[: len(camera.distortion)] = camera.distortion
    return np.asarray(cv2.undistortPoints(pixels[:, None], matrix, lens)[:, 0])


def seen_texels(camera: PictureCamera, grid: OrthoGrid) -> Float32[ndarray, "height width 2"]:
    """Return the texel coordinates that each pixel sees on the support, `NOWHERE` above its horizon."""
    rays = straight_rays(camera)
    plane = grid.plane
    above = float((camera.position - plane.origin) @ plane.normal)
    down = -(rays @ plane.normal.astype(np.float32))
    reach = above / np.maximum(down, 1e-6)
    foot = plane.local(camera.position[None])[0, :2]
    local = foot.astype(np.float32) + reach[..., None] * (rays @ plane.axes[:2].T.astype(np.float32))
    texels = (local + np.float32(grid.half)) / np.float32(grid.texel) - np.float32(0.5)
    hit = (down > 1e-3) & (np.abs(local).max(axis=-1) < grid.half)
    return np.where(hit[..., None], texels, np.float32(NOWHERE)).astype(np.float32)


def seen_pixels(camera: PictureCamera, grid: OrthoGrid) -> Float32[ndarray, "cells cells 2"]:
    """Return for each texel where `camera` sees it, pixel coordinates as in `cv2.remap`, or `NOWHERE`.

    Projected for every fourth texel and interpolated; the perspective bends by hundredths of a pixel between.
    """
    along = (_coarse(grid.cells) + 0.5) * grid.texel - grid.half
    u, v = np.meshgrid(along, along)
    local = np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 3)
    column, row, depth = camera.project(grid.plane.world(local))
    pixels = np.stack([column - 0.5, row - 0.5], axis=-1)
    usable = (depth > 0.0) & (np.abs(pixels).max(axis=-1) < -NOWHERE)
    coarse = np.where(usable[:, None], pixels, 100.0 * NOWHERE).reshape(len(along), len(along), 2)
    fine = _fine(coarse.astype(np.float32), (grid.cells, grid.cells))
    limits = np.array([camera.width, camera.height], dtype=np.float32) - np.float32(0.5)
    shown = ((fine > -0.5) & (fine < limits)).all(axis=-1, keepdims=True)
    return np.where(shown, fine, np.float32(NOWHERE))


def _coarse(size: int) -> Float64[ndarray, " positions"]:
    return np.arange(0.0, size + _STEP, _STEP)


def _fine(coarse: Float32[ndarray, "rows columns channels"], size: tuple[int, int]) -> ndarray:
    """Return what is known at every `_STEP`-th position for all positions of a picture of `size`."""
    rows, columns = coarse.shape[:2]
    # In one dimension after the other: `cv2.remap` would round positions to a thirty-second.
    across = np.arange(size[0], dtype=np.float32) / np.float32(_STEP)
    down = np.arange(size[1], dtype=np.float32) / np.float32(_STEP)
    left, above = across.astype(np.int64), down.astype(np.int64)
    right, below = np.minimum(left + 1, columns - 1), np.minimum(above + 1, rows - 1)
    share = (across - left).astype(np.float32)[None, :, None]
    wide = coarse[:, left] * (1 - share) + coarse[:, right] * share
    share = (down - above).astype(np.float32)[:, None, None]
    return np.asarray(wide[above] * (1 - share) + wide[below] * share)
