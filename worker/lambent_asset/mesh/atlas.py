"""A mesh cut into charts on a square atlas, with the tangents that normal maps refer to.

One layout serves pictures of several sizes: textures as sharp as the photographs, and baked transport.

u points right and v down from the atlas's top row, as in glTF. Tangent frames are those of MikkTSpace for
the same mesh with v up, which is what glTF viewers expect: the bitangent points to falling v.
"""

from dataclasses import dataclass

import numpy as np
import xatlas
from lambent_core.errors import WorkerError
from numpy.typing import NDArray

from lambent_asset.mesh.mesh import Mesh

PADDING = 2
"""Texels between charts in the smallest picture of the layout: there the nearest texel is the chart's own."""
COVERED_SHARE = 0.515
"""Covered texels of baked transport, as a share of the square of `export.transport_size`. A covered texel
takes 112 bytes, and how densely charts pack is chance: the bound keeps a full bundle at 512 below 25 MB."""
SIZE_STEP = 16
"""A quarter of such a size, which the second level of detail has, is still cut into blocks of 4 x 4."""


@dataclass(frozen=True, slots=True, eq=False)
class Unwrapped:
    """A mesh whose vertices are split along the seams of its charts."""

    source: NDArray[np.int64]
    """The vertex of the mesh that each vertex is a copy of."""
    faces: NDArray[np.int32]
    uv: NDArray[np.float32]


def unwrap(
    mesh: Mesh, size: int, *, advice: str = "raise export.transport_size or lower export.max_faces"
) -> Unwrapped:
    """Return charts of `mesh` that fill a square, `PADDING` texels apart where it has `size` texels a side.

    Raises WorkerError where that fails, with `advice` on what to do.
    """
    atlas = xatlas.Atlas()
    atlas.add_mesh(
        np.ascontiguousarray(mesh.vertices, np.float32), np.ascontiguousarray(mesh.faces, np.uint32)
    )
    options = xatlas.PackOptions()
    options.resolution, options.padding, options.bruteForce = size, PADDING, True
    atlas.generate(pack_options=options)
    if atlas.atlas_count != 1 or not atlas.chart_count:
        raise WorkerError(
            "export.atlas",
            f"the surface was cut into {atlas.chart_count} charts on {atlas.atlas_count} atlases, "
            f"expected one atlas; {advice}",
        )
    source, faces, uv = atlas[0]
    # Coordinates come as shares of each side, of an atlas that need not be square.
    sides = np.array([atlas.width, atlas.height], np.float64)
    uv = (uv.astype(np.float64) * sides / sides.max()).clip(0.0, 1.0)
    return Unwrapped(source.astype(np.int64), faces.astype(np.int32), uv.astype(np.float32))


def size_within(charts: Unwrapped, size: int, share: float = COVERED_SHARE) -> int:
    """Return the largest size, up to `size`, at which charts cover at most `share` of `size`^2 texels.

    A smaller one is a multiple of `SIZE_STEP` where it is not less than that.
    """
    fits = int(size * (share / max(covered_share(charts.uv, charts.faces), 1e-12)) ** 0.5)
    if fits >= size:
        return size
    return max(1, fits - fits % SIZE_STEP if fits >= SIZE_STEP else fits)


def covered_share(uv: NDArray[np.floating], faces: NDArray[np.integer]) -> float:
    """Return the area of all triangles in the atlas, whose own is one."""
    a, b, c = (np.asarray(uv, np.float64)[faces[:, k]] for k in range(3))
    p, q = (b - a).T, (c - a).T
    return float(0.5 * np.abs(p[0] * q[1] - p[1] * q[0]).sum())


def angle_weighted_normals(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> NDArray[np.float32]:
    """Return unit normals of the vertices: means over their triangles, weighted by the angle there."""
    corners = np.asarray(vertices, np.float64)[faces]
    normal = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    total = np.zeros((len(vertices), 3))
    for k in range(3):
        angle = _angle(corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k])
        np.add.at(total, faces[:, k], angle[:, None] * normal)
    return unit(total).astype(np.float32)


def tangents(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    uv: NDArray[np.floating],
    normals: NDArray[np.floating],
) -> NDArray[np.float32]:
    """Return tangent and handedness [vertex, 4]: bitangent = w cross(normal, tangent), towards falling v.

    Per triangle the direction of growing u, projected onto the plane of the vertex's normal, unit, and
    weighted by the triangle's angle in that plane. Triangles of a vertex that are mirrored otherwise than
    most of them do not take part; charts have none, but for degenerate ones.
    Source: Mikkelsen, Simulation of Wrinkled Surfaces Revisited (2008); mikktspace.c.
    """
    corners = np.asarray(vertices, np.float64)[faces]
    places = np.asarray(uv, np.float64)[faces] * [1.0, -1.0]
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    du1, dv1 = (places[:, 1] - places[:, 0]).T
    du2, dv2 = (places[:, 2] - places[:, 0]).T
    area = du1 * dv2 - du2 * dv1
    side = np.where(area >= 0.0, 1.0, -1.0)
    along = side[:, None] * (dv2[:, None] * edge1 - dv1[:, None] * edge2)
    votes = np.zeros(len(vertices))
    for k in range(3):
        np.add.at(votes, faces[:, k], area)
    handed = np.where(votes >= 0.0, 1.0, -1.0)
    total = np.zeros((len(vertices), 3))
    for k in range(3):
        vertex = faces[:, k]
        normal = np.asarray(normals, np.float64)[vertex]
        arms = [_flattened(corners[:, (k + step) % 3] - corners[:, k], normal) for step in (1, 2)]
        angle = _angle(*arms)
        counts = (side == handed[vertex]) & (area != 0.0)
        np.add.at(total, vertex, (angle * counts)[:, None] * unit(_flattened(along, normal)))
    empty = np.linalg.norm(total, axis=1) < 1e-9
    total[empty] = any_perpendicular(np.asarray(normals, np.float64)[empty])
    return np.concatenate([unit(total), handed[:, None]], axis=1).astype(np.float32)


def unit(vectors: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return unit vectors [..., 3]; zero ones stay zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


def _flattened(vectors: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors - (vectors * normals).sum(-1, keepdims=True) * normals


def _angle(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.arccos((unit(first) * unit(second)).sum(-1).clip(-1.0, 1.0))


def any_perpendicular(normals: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return a vector perpendicular to each of the unit `normals`, not unit."""
    axis = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    return np.cross(normals, axis)
