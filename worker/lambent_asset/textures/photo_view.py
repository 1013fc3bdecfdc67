"""One photograph of a surface: the points it shows, from where, how large, and in which colours.

Pictures are reduced by whole factors to about the size at which they are looked up, by means over blocks.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32
from lambent_core.directions import dot
from lambent_core.scene import View
from lambent_relight.baked.raster import block_means, rasterise
from lambent_relight.baked.texture_lookup import bilinear, cubic
from numpy import ndarray
from scipy import ndimage

from lambent_asset.mesh.mesh import Mesh
from lambent_asset.mesh.mesh_depth import relight_camera

DEPTH_SIDE = 1024
"""Longer side of the depth picture at most: the mesh's own error is larger than its pixel."""
CELLS = 1.5
"""How far the mesh may be from the photographed surface, in cells of its extraction: tolerance of the depth
test, and distance that points keep from outlines."""
LEAST_COSINE = 0.2
"""Surfaces that are seen under a flatter angle are left out."""
SOLID = 0.98
"""Alpha from which on a photograph's pixel shows nothing but the object."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Surface points as a photograph shows them."""

    visible: Bool[ndarray, " points"]
    places: Float32[ndarray, "points 2"]
    """Column and row, pixels of the photograph."""
    omega_o: Float32[ndarray, "points 3"]
    resolution: Float32[ndarray, " points"]
    """Pixels per scene unit along the surface, in the direction in which it is foreshortened."""


class Photograph:
    """One photograph with its camera, as a `View` has it.

    Its colours are linear Rec. 709 radiance, in the exposure of the capture's first frame, and straight: they
    are not multiplied by alpha, and are used where alpha is above `SOLID`. Places are column and row in
    pixels, (0.5, 0.5) the centre of the first one, lengths are in scene units.
    """

    def __init__(self, view: View, light: str) -> None:
        """Take the picture of `view` under `light`, without a copy; raises KeyError where there is none."""
        self.name, self.camera, self.turn = view.name, view.camera, view.light_turn
        self._image = view.images[light]
        self._clipped = view.clipped.get(light)

    def project(
        self, points: Float[ndarray, "points 3"]
    ) -> tuple[Float32[ndarray, "points 2"], Float32[ndarray, " points"]]:
        """Return column and row of points in pixels, and their distance along the axis (scene units)."""
        camera = self.camera
        pose = np.asarray(camera.camera_to_world, np.float64)
        local = (points - pose[:3, 3].astype(np.float32)) @ pose[:3, :3].astype(np.float32)
        along = np.maximum(-local[:, 2], 1e-9)
        column = camera.focal_x * local[:, 0] / along + camera.centre_x
        row = camera.centre_y - camera.focal_y * local[:, 1] / along
        return np.stack([column, row], axis=-1).astype(np.float32), -local[:, 2]

    def see(
        self, points: Float32[ndarray, "points 3"], normals: Float32[ndarray, "points 3"], mesh: Mesh
    ) -> Seen:
        """Return what is visible of `points` (scene units) with unit `normals`, by the depth of `mesh`.

        A point is visible where the camera sees it under a cosine above `LEAST_COSINE`, nothing else and no
        outline lies within the mesh's error, and the picture is opaque and not clipped.
        """
        camera = self.camera
        places, along = self.project(points)
        towards = camera.position.astype(np.float32) - points
        distance = np.maximum(np.linalg.norm(towards, axis=1), 1e-9)
        omega_o = (towards / distance[:, None]).astype(np.float32)
        cosine = dot(normals, omega_o)[:, 0]
        resolution = camera.focal_x / distance * np.maximum(cosine, 0.0)
        inside = (along > 0.0) & (places >= 1.0).all(axis=1)
        inside &= (places <= [camera.width - 1.0, camera.height - 1.0]).all(axis=1)
        visible = inside & (cosine > LEAST_COSINE)
        visible[visible] = self._unhidden(places[visible], distance[visible], cosine[visible], mesh)
        return Seen(visible, places, omega_o, resolution.astype(np.float32))

    def _unhidden(
        self,
        places: Float32[ndarray, "points 2"],
        distance: Float32[ndarray, " points"],
        cosine: Float32[ndarray, " points"],
        mesh: Mesh,
    ) -> Bool[ndarray, " points"]:
        """Return whether nothing else, and no outline, lies within the mesh's error of the points."""
        if not len(places):
            return np.zeros(0, bool)
        camera = self.camera
        factor = min(1.0, DEPTH_SIDE / max(camera.width, camera.height))
        size = max(1, round(camera.width * factor)), max(1, round(camera.height * factor))
        small = camera.resized(*size)
        depth = rasterise(mesh.vertices, mesh.faces, relight_camera(self.name, small)).depth
        pixel = float(np.median(distance)) / small.focal_x
        margin = CELLS * mesh.cell
        reach = max(1, math.ceil(margin / pixel))
        window = 2 * reach + 1
        nearest = ndimage.minimum_filter(depth, window)
        farthest = ndimage.maximum_filter(depth, window)
        row = np.clip((places[:, 1] * size[1] / camera.height).astype(int), 0, size[1] - 1)
        column = np.clip((places[:, 0] * size[0] / camera.width).astype(int), 0, size[0] - 1)
        # Inside the window the surface itself comes nearer and goes away with its slope.
        slope = np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) / cosine
        allowed = margin + reach * 1.5 * distance / small.focal_x * slope
        clear = (nearest[row, column] > distance - allowed) & (farthest[row, column] < distance + allowed)
        return clear & self._solid(size, reach)[row, column]

    def _solid(self, size: tuple[int, int], reach: int) -> Bool[ndarray, "rows columns"]:
        """Return where the photograph shows the object alone, and no clipped channel, around a pixel."""
        rows = (np.arange(size[1] + 1) * self.camera.height // size[1])[:-1]
        columns = (np.arange(size[0] + 1) * self.camera.width // size[0])[:-1]
        good = self._image[..., 3] > SOLID
        if self._clipped is not None:
            good = good & ~self._clipped.any(axis=-1)
        good = np.logical_and.reduceat(np.logical_and.reduceat(good, rows, axis=0), columns, axis=1)
        return ndimage.minimum_filter(good, 2 * (reach // 2) + 1)

    def reduced(self, pixels: float) -> "Level":
        """Return the picture reduced so that `pixels` of it, rounded down to a whole number, become one.

        Means are of straight linear radiance, without regard to alpha.
        """
        factor = max(1, min(int(pixels), *(side for side in self._image.shape[:2])))
        return Level(block_means(self._image[..., :3], factor).astype(np.float32, copy=False), factor)


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """A picture of linear Rec. 709 radiance, not multiplied by alpha, reduced by a whole factor."""

    image: Float32[ndarray, "rows columns 3"]
    factor: int

    def at(self, places: Float32[ndarray, "points 2"]) -> Float32[ndarray, "points 3"]:
        """Return radiance at places in pixels of the photograph, bilinear."""
        height, width = self.image.shape[:2]
        return bilinear(self.image, places / (self.factor * np.array([width, height], np.float32)))

    def sharp_at(self, places: Float32[ndarray, "points 2"]) -> Float32[ndarray, "points 3"]:
        """Return radiance at places in pixels of the photograph, with its detail (Catmull-Rom)."""
        return np.maximum(cubic(self.image, places / np.float32(self.factor)), 0.0)

    def detail(self) -> Float32[ndarray, "rows columns 1"]:
        """Return by what share of its level luminance changes from pixel to pixel."""
        grey = self.image.mean(axis=-1)
        steps = np.abs(np.diff(grey, axis=1, append=grey[:, -1:])) + np.abs(
            np.diff(grey, axis=0, append=grey[-1:])
        )
        return (steps / np.maximum(grey, 1e-3))[..., None]
