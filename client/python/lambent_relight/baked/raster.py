"""Rasteriser: the triangle at each pixel of a picture, or at each texel of an atlas.

Pixels are sampled at their centres; for smoother edges draw a camera `resized` to a multiple and take
`block_means`. An atlas has u to the right and v down, both 0..1, texel (row, column) centred at
((column + 0.5) / size, (row + 0.5) / size).
"""

from dataclasses import dataclass

import numpy as np
from lambent_compute.threads import available_threads, for_each
from numpy.typing import NDArray

from lambent_relight.baked import raster_kernels as kernels
from lambent_relight.cameras import Camera

_ROWS_PER_TASK = 64


@dataclass(frozen=True, slots=True, eq=False)
class Fragments:
    """The visible triangle at every cell of a grid."""

    face: NDArray[np.int32]
    """[height, width], -1 where nothing is."""
    barycentric: NDArray[np.float32]
    """[height, width, 2]: weights of the triangle's second and third corner, perspective-correct."""
    depth: NDArray[np.float32]
    """[height, width], along the ray from the camera, scene units; inf where nothing is, 0 in an atlas."""

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Whether a triangle is visible."""
        return self.face >= 0


def rasterise(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    camera: Camera,
    *,
    num_threads: int | None = None,
) -> Fragments:
    """Return the nearest triangle at each pixel centre of `camera`.

    Both sides of triangles are visible, and the camera may be inside the object. `vertices` [vertex, 3] are
    world coordinates.
    """
    pose = camera.camera_to_world
    points = (np.asarray(vertices, np.float64) - pose[:3, 3]) @ pose[:3, :3]
    faces = np.ascontiguousarray(faces, np.int32)
    shape = (camera.height, camera.width)
    face_of, weights = np.full(shape, -1, np.int32), np.zeros((*shape, 2), np.float32)
    depth = np.full(shape, np.inf, np.float32)
    lens = np.array([camera.focal_x, camera.focal_y, camera.centre_x, camera.centre_y], np.float64)

    def draw(first: int) -> None:
        rows = np.array([first, min(first + _ROWS_PER_TASK, camera.height)])
        kernels.draw_faces(points, faces, lens, rows, face_of, weights, depth)

    for_each(draw, range(0, camera.height, _ROWS_PER_TASK), num_threads or available_threads())
    return Fragments(face_of, weights, depth)


def rasterise_uv(uv: NDArray[np.floating], faces: NDArray[np.integer], size: int) -> Fragments:
    """Return the triangle at each texel centre of a square atlas; the first where charts overlap."""
    places = np.asarray(uv, np.float64) * size
    face_of, weights = np.full((size, size), -1, np.int32), np.zeros((size, size, 2), np.float32)
    kernels.draw_charts(places, np.ascontiguousarray(faces, np.int32), size, face_of, weights)
    return Fragments(face_of, weights, np.zeros((size, size), np.float32))


def interpolate(
    fragments: Fragments, faces: NDArray[np.integer], values: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Return `values` [vertex, n] at the covered places, [count, n] in row-major order."""
    corners = faces[fragments.face[fragments.covered]]
    second, third = fragments.barycentric[fragments.covered].T[:, :, None]
    a, b, c = (values[corners[:, k]] for k in range(3))
    return (a + second * (b - a) + third * (c - a)).astype(np.float32)


def nearest_texel(texel_index: NDArray[np.integer], size: int) -> NDArray[np.int32]:
    """Return for each texel [size, size] the position in `texel_index` of the nearest covered one.

    `values[nearest_texel(...)]` is then the whole plane of values per covered texel, its gutters filled, so
    that filtering across the border of a chart finds the chart's own values. There must be a covered texel.
    """
    owner = np.full(size * size, -1, np.int32)
    owner[texel_index] = np.arange(len(texel_index), dtype=np.int32)
    queue = np.empty(size * size, np.int32)
    queue[: len(texel_index)] = texel_index
    plane = owner.reshape(size, size)
    kernels.spread(plane, queue, len(texel_index))
    return plane


def block_means(image: NDArray[np.floating], factor: int) -> NDArray[np.floating]:
    """Return the means of `factor` x `factor` blocks of `image` [height, width, ...]."""
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    cut = image[: rows * factor, : columns * factor]
    return cut.reshape(rows, factor, columns, factor, *image.shape[2:]).mean(axis=(1, 3))
