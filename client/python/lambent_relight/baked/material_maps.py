"""The textures of a bundle's mesh as materials at places of its atlas.

Pixels that show many texels look up smaller versions of a texture, made by means over 2 x 2 texels (of the
albedo in linear light): bilinear in each of the two versions nearest in size, linear between them, as
graphics hardware does. None is smaller than the atlas of transport, whose charts lie apart.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from lambent_compute.compiling import compiled
from lambent_compute.threads import available_threads, for_each
from lambent_core.colour import linear_from_srgb, srgb_from_linear
from numpy.typing import NDArray

from lambent_relight.baked.mesh_textures import pixels_of, texture_files

_PLACES_PER_TASK = 1 << 16
_ROWS_AT_ONCE = 256

Levels = tuple[NDArray[np.uint8], ...]


@dataclass(frozen=True, eq=False)
class MaterialMaps:
    """The textures that all renderers read; 8-bit, rows from the top, each half as large as the last."""

    albedo: Levels
    """sRGB-encoded [size, size, 3]."""
    packed: Levels
    """Occlusion, perceptual roughness and metalness [size, size, 3]."""
    normal: Levels
    """Unit normals in the frame of the vertices' tangents, -1..1 as 0..255, [size, size, 3]."""
    texel_size: float
    """Of the largest albedo texture on the surface, scene units."""

    def albedo_at(self, uv: NDArray[np.floating], footprint: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return linear albedo at `uv` [n, 2] as a mean over about `footprint` [n] (scene units), [n, 3]."""
        return self._at(self.albedo, uv, footprint, _linear_levels())

    def roughness_and_metalness_at(
        self, uv: NDArray[np.floating], footprint: NDArray[np.floating]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return perceptual roughness and metalness at `uv` [n, 2], each [n, 1]; see `albedo_at`."""
        channels = self._at(self.packed, uv, footprint, _levels())
        return channels[:, 1:2], channels[:, 2:3]

    def normal_at(self, uv: NDArray[np.floating], footprint: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return normals at `uv` [n, 2] in the frame of the tangents, not quite unit, [n, 3]."""
        return 2.0 * self._at(self.normal, uv, footprint, _levels()) - 1.0

    def _at(
        self,
        levels: Levels,
        uv: NDArray[np.floating],
        footprint: NDArray[np.floating],
        values: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """Return a texture at places, trilinear."""
        texel_size = self.texel_size * len(self.albedo[0]) / len(levels[0])
        texels = np.asarray(footprint, np.float32) / np.float32(max(texel_size, 1e-12))
        level = np.clip(np.log2(np.maximum(texels, 1.0)), 0.0, len(levels) - 1).astype(np.float32)
        lower = level.astype(np.int8)
        places, result = np.asarray(uv, np.float32), np.zeros((len(uv), 3), np.float32)
        for number, picture in enumerate(levels):
            weight = np.maximum(1.0 - np.abs(level - np.float32(number)), 0.0)
            rows = np.flatnonzero((np.abs(lower - number) <= 1) & (weight > 0.0))
            if len(rows):
                result[rows] += weight[rows, None] * lookup(picture, places[rows], values)
        return result


def material_maps(glb: bytes, texel_size: float, least_size: int) -> MaterialMaps:
    """Return the maps of a bundle's mesh, whose albedo has texels of `texel_size` scene units.

    Their smaller versions have at least `least_size` texels a side.
    """
    colour, packed, normal = map(pixels_of, texture_files(glb))
    return MaterialMaps(
        _smaller(colour, least_size, srgb_from_linear, _linear_levels()),
        _smaller(packed, least_size, np.asarray, _levels()),
        _smaller(normal, least_size, np.asarray, _levels()),
        texel_size,
    )


def lookup(
    picture: NDArray[np.uint8], uv: NDArray[np.float32], values: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the decoded `picture` [height, width, n] at `uv` [count, 2], bilinear, as [count, n].

    `values` [256] are what the 8-bit levels stand for. Beyond the outermost centres the outermost pixels are
    repeated.
    """
    picture, uv = np.ascontiguousarray(picture), np.ascontiguousarray(uv)
    out = np.empty((len(uv), picture.shape[2]), np.float32)

    def fill(first: int) -> None:
        part = slice(first, first + _PLACES_PER_TASK)
        _lookup(picture, uv[part], values, out[part])

    for_each(fill, range(0, len(uv), _PLACES_PER_TASK), available_threads())
    return out


@compiled()
def _lookup(picture, uv, values, out):
    height, width, channels = picture.shape
    for k in range(uv.shape[0]):
        x = min(max(uv[k, 0] * width - np.float32(0.5), np.float32(0.0)), np.float32(width - 1))
        y = min(max(uv[k, 1] * height - np.float32(0.5), np.float32(0.0)), np.float32(height - 1))
        left, top = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
        right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
        fx, fy = x - np.float32(left), y - np.float32(top)
        for c in range(channels):
            a, b = values[picture[top, left, c]], values[picture[top, right, c]]
            upper = a + fx * (b - a)
            a, b = values[picture[bottom, left, c]], values[picture[bottom, right, c]]
            lower = a + fx * (b - a)
            out[k, c] = upper + fy * (lower - upper)


@cache
def _linear_levels() -> NDArray[np.float32]:
    return linear_from_srgb(np.arange(256) / 255.0).astype(np.float32)


@cache
def _levels() -> NDArray[np.float32]:
    return np.arange(256, dtype=np.float32) / np.float32(255.0)


def _smaller(
    picture: NDArray[np.uint8],
    least_size: int,
    encode: Callable[[NDArray[np.floating]], NDArray[np.floating]],
    values: NDArray[np.float32],
) -> Levels:
    """Return the picture and its smaller versions: means of the `values` of its levels, encoded again."""
    levels = [picture]
    while min(levels[-1].shape[:2]) >= 2 * least_size and not any(side % 2 for side in levels[-1].shape[:2]):
        levels.append(_halved(levels[-1], encode, values))
    return tuple(levels)


def _halved(
    picture: NDArray[np.uint8],
    encode: Callable[[NDArray[np.floating]], NDArray[np.floating]],
    values: NDArray[np.float32],
) -> NDArray[np.uint8]:
    height, width = picture.shape[0] // 2, picture.shape[1] // 2
    result = np.empty((height, width, picture.shape[2]), np.uint8)
    for first in range(0, height, _ROWS_AT_ONCE):
        rows = values[picture[2 * first : 2 * (first + _ROWS_AT_ONCE)]]
        means = rows.reshape(-1, 2, width, 2, picture.shape[2]).mean(axis=(1, 3))
        result[first : first + len(means)] = np.round(255.0 * encode(means))
    return result
