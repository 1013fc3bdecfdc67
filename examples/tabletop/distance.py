"""Shapes as signed distances (negative inside), and their surfaces as triangles.

A distance takes points [n, 3] and returns [n]; it may underestimate, which costs time only.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from skimage.measure import marching_cubes

Distance = Callable[[np.ndarray], np.ndarray]

BLOCK = 8


@dataclass(frozen=True, kw_only=True, slots=True)
class Surface:
    """Triangles of a shape, with the outward unit normals of its distance."""

    positions: np.ndarray
    normals: np.ndarray
    faces: np.ndarray


def ball(p: np.ndarray, centre: Sequence[float], radii: float | Sequence[float]) -> np.ndarray:
    """Return the distance to a sphere, or about the distance to an ellipsoid with axis-parallel `radii`."""
    q = p - np.float32(centre)
    if np.isscalar(radii):
        return np.linalg.norm(q, axis=-1) - radii
    size = np.float32(radii)
    far = np.linalg.norm(q / size, axis=-1)
    steep = np.linalg.norm(q / size**2, axis=-1)
    return far * (far - 1.0) / np.maximum(steep, 1e-6)


def rod(
    p: np.ndarray,
    start: Sequence[float],
    end: Sequence[float],
    radius: float,
    radius_end: float | None = None,
) -> np.ndarray:
    """Return the distance to a rod with round ends, from `radius` to `radius_end`."""
    a, axis = np.float32(start), np.float32(end) - np.float32(start)
    along = np.clip((p - a) @ axis / (axis @ axis), 0.0, 1.0)
    wide = radius + along * ((radius if radius_end is None else radius_end) - radius)
    return np.linalg.norm(p - a - along[:, None] * axis, axis=-1) - wide


def chain(p: np.ndarray, knots: Sequence[Sequence[float]], radius: float, radius_end: float) -> np.ndarray:
    """Return the distance to rods along `knots`, tapering from `radius` to `radius_end`."""
    wide = np.linspace(radius, radius_end, len(knots))
    parts = [rod(p, knots[k], knots[k + 1], wide[k], wide[k + 1]) for k in range(len(knots) - 1)]
    return np.minimum.reduce(parts)


def box(p: np.ndarray, centre: Sequence[float], half: Sequence[float], rounding: float = 0.0) -> np.ndarray:
    """Return the distance to an axis-parallel box whose edges are rounded inwards."""
    q = np.abs(p - np.float32(centre)) - (np.float32(half) - rounding)
    outside = np.linalg.norm(np.maximum(q, 0.0), axis=-1)
    return outside + np.minimum(q.max(axis=-1), 0.0) - rounding


def drum(
    p: np.ndarray, centre: Sequence[float], radius: float, half: float, axis: int, rounding: float = 0.0
) -> np.ndarray:
    """Return the distance to a cylinder along a coordinate axis, edges rounded inwards."""
    q = p - np.float32(centre)
    across = np.linalg.norm(np.delete(q, axis, axis=1), axis=-1) - (radius - rounding)
    along = np.abs(q[:, axis]) - (half - rounding)
    outside = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
    return outside + np.minimum(np.maximum(across, along), 0.0) - rounding


def hoop(
    p: np.ndarray, centre: Sequence[float], major: float, minor: float, axis: int, squash: float = 1.0
) -> np.ndarray:
    """Return about the distance to a torus about a coordinate axis, flattened along it by `squash` < 1."""
    q = p - np.float32(centre)
    ring = np.linalg.norm(np.delete(q, axis, axis=1), axis=-1) - major
    return np.hypot(ring, q[:, axis] / squash) * min(squash, 1.0) - minor * min(squash, 1.0)


def turned(p: np.ndarray, profile: np.ndarray) -> np.ndarray:
    """Return about the distance to a solid of revolution about z; `profile` is (z, radius), z ascending."""
    radius = np.hypot(p[:, 0], p[:, 1])
    z, wide = profile[:, 0], profile[:, 1]
    slope = np.interp(p[:, 2], z, np.gradient(wide, z))
    side = (radius - np.interp(p[:, 2], z, wide)) / np.sqrt(1.0 + slope**2)
    return np.maximum(side, np.maximum(z[0] - p[:, 2], p[:, 2] - z[-1]))


def blend(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Return the union with a fillet of `width`."""
    share = np.maximum(width - np.abs(a - b), 0.0) / width
    return np.minimum(a, b) - share**2 * width * 0.25


def carve(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Return `a` without `b`, with an edge rounded by `width`."""
    return -blend(-a, b, width)


def rotated(p: np.ndarray, centre: Sequence[float], axis: int, angle_deg: float) -> np.ndarray:
    """Return points turned back about a coordinate axis through `centre`: what they measure turns forward."""
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    first, second = [(1, 2), (2, 0), (0, 1)][axis]
    q = (p - np.float32(centre)).copy()
    u, v = q[:, first].copy(), q[:, second].copy()
    q[:, first], q[:, second] = cos * u + sin * v, -sin * u + cos * v
    return q + np.float32(centre)


def surface(distance: Distance, low: Sequence[float], high: Sequence[float], cells: int) -> Surface:
    """Return the surface between `low` and `high`, with `cells` cells along the longest side.

    The grid is filled in blocks of 8 near the surface only. Vertices are then moved onto the zero of the
    distance, and their normals are its gradient over half a cell.
    """
    first, extent = np.float32(low), np.float32(high) - np.float32(low)
    step = float(extent.max()) / cells
    blocks = np.ceil((extent / step + 1) / BLOCK).astype(int)
    corner = np.stack(np.meshgrid(*map(np.arange, blocks), indexing="ij"), axis=-1).reshape(-1, 3) * BLOCK
    middle = distance((first + step * (corner + 0.5 * (BLOCK - 1))).astype(np.float32))
    grid = np.empty((*blocks, BLOCK, BLOCK, BLOCK), np.float32)
    grid[:] = middle.reshape(*blocks, 1, 1, 1)
    inside = np.stack(np.meshgrid(*[np.arange(BLOCK)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    near = np.flatnonzero(np.abs(middle) < 1.3 * BLOCK * step)
    flat = grid.reshape(-1, BLOCK**3)
    for some in np.array_split(near, max(1, len(near) // 256)):
        points = first + step * (corner[some, None] + inside[None])
        flat[some] = distance(points.reshape(-1, 3).astype(np.float32)).reshape(len(some), -1)
    whole = grid.transpose(0, 3, 1, 4, 2, 5).reshape(blocks * BLOCK)
    vertices, faces, _, _ = marching_cubes(whole, 0.0, allow_degenerate=False)
    positions = (first + step * vertices).astype(np.float32)
    for _ in range(2):
        normals, value = _gradient(distance, positions, 0.5 * step)
        positions -= np.clip(value, -step, step)[:, None] * normals
    normals, _ = _gradient(distance, positions, 0.5 * step)
    cross = np.cross(
        positions[faces[:, 1]] - positions[faces[:, 0]], positions[faces[:, 2]] - positions[faces[:, 0]]
    )
    if (cross * normals[faces[:, 0]]).sum() < 0.0:
        faces = faces[:, ::-1]
    return Surface(positions=positions, normals=normals, faces=np.ascontiguousarray(faces, np.uint32))


def _gradient(distance: Distance, points: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit gradient and the distance at `points`."""
    normals = np.empty_like(points)
    for axis in range(3):
        offset = np.zeros(3, np.float32)
        offset[axis] = step
        normals[:, axis] = distance(points + offset) - distance(points - offset)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    return normals, distance(points).astype(np.float32)
