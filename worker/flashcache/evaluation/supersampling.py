"""Pictures as means over several rays per pixel.

A photograph's pixel is a mean over its area. One ray through its centre sees one surface where the photograph
mixes two, and a point of a texture where it has an average.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32
from lambent_core.scene import Camera
from numpy import ndarray

from flashcache.errors import ConfigError
from flashcache.evaluation.gbuffer import OPACITY_FLOOR, GBuffer

POINTS_PER_PIXEL = 4
"""Points that a picture without supersampling shades per pixel and repeat."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PictureSamples:
    """The samples of which a pixel is the mean."""

    num_directions: int = 64
    """Secondary rays per pixel and repeat, shared by its points; each point has four at least."""
    num_repeats: int = 1
    """Times that points are drawn anew."""
    antialias: int = 1
    """Camera rays along each side of a pixel."""

    @property
    def points_per_ray(self) -> int:
        """Return how many points each camera ray shades per repeat."""
        return points_per_ray(self.antialias)

    @property
    def directions_per_point(self) -> int:
        """Return the number of secondary rays of a point."""
        return max(4, self.num_directions // (self.points_per_ray * self.antialias**2))


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A Monte Carlo picture with its noise."""

    rgb: Float32[ndarray, "height width 3"]
    standard_error: Float32[ndarray, "height width 3"]
    """Of `rgb`, linear radiance, from the spread of the estimates; see `variance_of_mean`."""
    opacity: Float32[ndarray, "height width 1"]


def finer(camera: Camera, antialias: int) -> Camera:
    """Return the camera with `antialias` x `antialias` pixels for every one of `camera`.

    Raises `ConfigError` for less than one ray along a side.
    """
    if antialias < 1:
        raise ConfigError(f"antialias must be at least 1 ray along a pixel's side, got {antialias}")
    return camera.resized(camera.width * antialias, camera.height * antialias)


def points_per_ray(antialias: int) -> int:
    """Return how many points a ray shades: two at least, for their spread tells the noise."""
    return max(2, POINTS_PER_PIXEL // antialias**2)


def block_means(
    values: Float32[ndarray, "rows columns channels"], antialias: int
) -> Float32[ndarray, "height width channels"]:
    """Return the means of blocks of `antialias` x `antialias` values."""
    rows, columns, channels = values.shape
    blocks = values.reshape(rows // antialias, antialias, columns // antialias, antialias, channels)
    return blocks.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)


def mean_picture(picture: Picture, antialias: int) -> Picture:
    """Return the picture of the pixels, from one of their rays.

    Linear, straight radiance is averaged as it is composited, weighted with opacity. The rays' estimates are
    independent, so the variances of their weighted values add up.
    """
    if antialias == 1:
        return picture
    opacity = block_means(picture.opacity, antialias)
    share = np.maximum(opacity, 1e-6)
    variance = block_means((picture.opacity * picture.standard_error) ** 2, antialias)
    return Picture(
        rgb=block_means(picture.opacity * picture.rgb, antialias) / share,
        standard_error=np.sqrt(variance) / antialias / share,
        opacity=opacity,
    )


def mean_gbuffer(buffer: GBuffer, camera: Camera, antialias: int) -> GBuffer:
    """Return the surface as the pixels of `camera` see it, from what their rays see.

    Means are weighted with opacity; normals are scaled to length one again.
    """
    if antialias == 1:
        return buffer
    opacity = block_means(buffer.opacity, antialias)
    empty = opacity < OPACITY_FLOOR

    def mean(values: Float32[ndarray, "rows columns channels"]) -> Float32[ndarray, "height width channels"]:
        return block_means(buffer.opacity * values, antialias) / np.maximum(opacity, 1e-6)

    normal = mean(buffer.normal)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-8)
    return GBuffer(
        camera=camera,
        opacity=opacity,
        distance=np.where(empty, np.float32(0.0), mean(buffer.distance)),
        normal=np.where(empty, np.array([0.0, 0.0, 1.0], np.float32), normal),
        albedo=mean(buffer.albedo),
        perceptual_roughness=mean(buffer.perceptual_roughness),
        metalness=mean(buffer.metalness),
        cache_rgb=block_means(buffer.cache_rgb, antialias),
    )
