"""The surface of a trained model as triangles, and the box it lies in."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from flashcache.evaluation.threads import on_all_cores
from flashcache.physical.model import InverseModel
from lambent_core.errors import WorkerError
from lambent_relight.baked.raster import rasterise
from lambent_relight.cameras import Camera, look_at
from numpy.typing import NDArray
from scipy import ndimage, sparse
from skimage.measure import marching_cubes

Corner = tuple[float, float, float]

SURVEY_CELLS = 64
"""Cells along the longest side of the scene's box in the first search."""
SURVEY_MARGIN = 2
"""Margin around the occupied cells of the first search."""
SURVEY_DEPTH = 0.5 * math.log(2.0)
"""Optical depth of such a cell that counts as matter, of which thinner parts must not be missed."""
SURFACE_DEPTH = 0.25 * math.log(2.0)
"""Matter begins where four cells' width of it hide half of what is behind them (optical depth of one cell).

At the object's outline a ray runs along the surface, through several cells: of the levels tried this one
gives the outlines that are closest to the volume's (docs/benchmarks/bundle.md). Where a ray meets the surface
head on, texels do not depend on it: they are moved to where the density is.
"""
DEPTH_RANGE = 50.0
"""Optical depths are limited to this factor around `SURFACE_DEPTH` before a surface is laid through them."""
FAINTEST = 0.05
"""If nothing reaches that depth, the surface is placed at half the largest depth, if that is above this."""
FLOATER_AREA = 0.01
"""Pieces with less than this share of the largest piece's surface are removed."""
FLOATER_VOLUME = FLOATER_AREA**1.5
"""The same, as a share of the largest piece's volume."""
CHUNK_POINTS = 65536
SURVEY_STRIDE = 4
"""Cells of the mesh across a cell of the search for the surface, around which density is evaluated."""
SLAB = 16
"""Layers of cells at which density is evaluated at a time."""
MOST_CELLS = 2**27
"""Most cells of the grid around the surface; half a gigabyte of numbers."""

SEEN_FROM = 14
"""Viewpoints around the object; a piece visible from none of them is inside."""
SEEN_SIDE = 128
"""Pixels of those pictures."""
CELLS_PER_PIXEL = 2.0
"""Cells across the footprint of a photograph's pixel at the object; finer detail would be guesswork."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles in world coordinates (z up), counter-clockwise seen from outside."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    cell: float
    """Width of the cells it was found with, scene units."""


def occupied_box(model: InverseModel) -> tuple[Corner, Corner]:
    """Return the smallest box, with a margin, around all matter except floaters, inside the scene's box.

    Raises WorkerError when there is no matter.
    """
    low, high = np.array(model.domain.bounds_min), np.array(model.domain.bounds_max)
    depth, cell = _depth_grid(model, low, high, SURVEY_CELLS)
    labels, _ = ndimage.label(depth > 0.5 * _level(depth, 2.0 * SURVEY_DEPTH))
    sizes = np.bincount(labels.ravel())[1:]
    kept = np.flatnonzero(sizes >= FLOATER_VOLUME * sizes.max()) + 1
    places = np.argwhere(np.isin(labels, kept))
    first = low + cell * (places.min(axis=0) - SURVEY_MARGIN)
    last = low + cell * (places.max(axis=0) + 1 + SURVEY_MARGIN)
    return _corner(np.maximum(first, low)), _corner(np.minimum(last, high))


def data_resolution(
    model: InverseModel, box_min: Corner, box_max: Corner, *, pixel_size: float, limit: int
) -> int:
    """Return the number of cells along the longest side of a box for which the trained density has detail.

    Between the centres of its finest voxels density is interpolated, and half a pixel of the photographs
    (`pixel_size`, scene units at the object; 0: unknown) is the least they can tell apart. At most `limit`.
    """
    grid = model.config.nerf.density.grid
    voxel = 2.0 * grid.half_extent * model.domain.contraction_radius / grid.finest_resolution
    cell = max(voxel, pixel_size / CELLS_PER_PIXEL)
    side = max(high - low for low, high in zip(box_min, box_max, strict=True))
    return max(8, min(limit, math.ceil(side / cell)))


def extract_mesh(model: InverseModel, box_min: Corner, box_max: Corner, resolution: int) -> Mesh:
    """Return the surface inside a box, with `resolution` cells along its longest side.

    Floaters, and pieces that are not visible from outside, are left out. Raises WorkerError when there is no
    surface.
    """
    low = np.array(box_min)
    field, near, cell = field_near_surface(model, low, np.array(box_max), resolution)
    vertices, faces, _, _ = marching_cubes(field, 0.0, gradient_direction="ascent", mask=near)
    del field, near
    vertices, faces = without_hidden(*_without_floaters(vertices, faces))
    vertices = (low + (vertices - 0.5) * cell).astype(np.float32)
    return Mesh(vertices, faces.astype(np.int32), cell)


def field_near_surface(
    model: InverseModel, low: NDArray[np.float64], high: NDArray[np.float64], resolution: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_], float]:
    """Return the field whose zero is the surface, where it is known, and the width of its cells.

    The field [x, y, z] is the logarithm of optical depth over that of the surface, within that of
    `DEPTH_RANGE`, at the centres of cubic cells with one layer of empty ones around them. Density is
    evaluated near the surface only, of which a search with cells `SURVEY_STRIDE` times as wide finds the
    surroundings; elsewhere the field has the search's sign. The grid is coarser than asked where it would
    have more than `MOST_CELLS`. Raises WorkerError where there is no matter.
    """
    sides = high - low
    finest = float((np.prod(sides) / MOST_CELLS) ** (1.0 / 3.0) / sides.max())
    resolution = min(resolution, int(1.0 / finest))
    cell = float(sides.max()) / resolution
    counts = np.maximum(1, np.ceil(sides / cell - 1e-6).astype(int))
    stride = SURVEY_STRIDE if resolution >= SURVEY_STRIDE * SURVEY_CELLS // 2 else 1
    coarse = _depth_at_centres(model, low, cell * stride, -(-counts // stride)) / stride
    level = _level(coarse, SURFACE_DEPTH)
    cube = np.ones((3, 3, 3))
    deep = ndimage.binary_erosion(coarse > level, cube, iterations=2)
    around = ndimage.binary_dilation(coarse > level / DEPTH_RANGE, cube) & ~deep
    wider = ndimage.binary_dilation(around, cube)
    most = np.float32(math.log(DEPTH_RANGE))
    # Empty space around the grid closes the surface where matter touches the box.
    field, near, drawn = (np.zeros(counts + 2, kind) for kind in (np.float32, bool, bool))
    field -= most
    inside = np.s_[1:-1, 1:-1, 1:-1]
    for target, values in ((field, deep), (near, around), (drawn, wider)):
        for row in range(counts[0]):
            plane = values[row // stride].repeat(stride, 0).repeat(stride, 1)[: counts[1], : counts[2]]
            target[inside][row][plane] = most if target is field else True
    for slab in range(0, counts[0] + 2, SLAB):
        places = np.argwhere(near[slab : slab + SLAB]) + np.array([slab - 1, -1, -1])
        if len(places):
            depth = _depth_at(model, ((places + 0.5) * cell + low).astype(np.float32), cell)
            field[slab : slab + SLAB][near[slab : slab + SLAB]] = depth
    level = _level(field[near], SURFACE_DEPTH)
    # The logarithm of density is what the network gives, and nearly linear across a surface; opacity jumps.
    field[near] = np.log((field[near] / level).clip(1.0 / DEPTH_RANGE, DEPTH_RANGE))
    return field, np.pad(drawn[inside], 1, mode="edge"), cell


def _level(depth: NDArray[np.floating], wanted: float) -> float:
    """Return the optical depth at which matter begins: `wanted`, or less where nothing reaches twice that.

    Raises WorkerError when there is no matter.
    """
    level = min(wanted, 0.5 * float(depth.max()))
    if not level > 0.5 * FAINTEST:
        raise WorkerError(
            "export.no_surface",
            "the trained density holds no surface; look at the previews, check the scene with lambent check, "
            "or train with more steps",
        )
    return level


def _depth_grid(
    model: InverseModel, low: NDArray[np.float64], high: NDArray[np.float64], resolution: int
) -> tuple[NDArray[np.float32], float]:
    """Return the optical depth of one cell's width at the centres of cubic cells, and that width."""
    cell = float((high - low).max()) / resolution
    counts = np.maximum(1, np.ceil((high - low) / cell - 1e-6).astype(int))
    return _depth_at_centres(model, low, cell, counts), cell


def _depth_at_centres(
    model: InverseModel, low: NDArray[np.float64], cell: float, counts: NDArray[np.integer]
) -> NDArray[np.float32]:
    axes = [low[k] + (np.arange(counts[k]) + 0.5) * cell for k in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)
    return _depth_at(model, points, cell).reshape(counts)


def _depth_at(model: InverseModel, points: NDArray[np.float32], width: float) -> NDArray[np.float32]:
    """Return the optical depth of `width` scene units of the matter at each point."""
    device = next(model.parameters()).device

    def depth(chunk: NDArray[np.float32]) -> torch.Tensor:
        return width * model.nerf.density.density(torch.from_numpy(chunk).to(device)).cpu()

    return torch.cat(on_all_cores(depth, _chunks(points), device)).numpy()


def _without_floaters(
    vertices: NDArray[np.float32], faces: NDArray[np.integer]
) -> tuple[NDArray[np.float32], NDArray[np.integer]]:
    """Return the triangles of the large connected pieces, and the vertices they use."""
    piece = piece_of_face(len(vertices), faces)
    sizes = np.bincount(piece)
    return compact(vertices, faces[sizes[piece] >= FLOATER_AREA * sizes.max()])


def without_hidden(
    vertices: NDArray[np.float32], faces: NDArray[np.integer]
) -> tuple[NDArray[np.float32], NDArray[np.integer]]:
    """Return the triangles of the connected pieces that are visible from outside."""
    piece = piece_of_face(len(vertices), faces)
    seen = np.zeros(piece.max() + 1, bool)
    for camera in _around(vertices):
        if seen[piece].all():
            break
        fragments = rasterise(vertices, faces, camera)
        seen[piece[fragments.face[fragments.covered]]] = True
    return compact(vertices, faces[seen[piece]])


def _around(points: NDArray[np.floating]) -> list[Camera]:
    """Return cameras evenly around `points` (a Fibonacci spiral) that see all of them."""
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    away = 5.0 * radius
    focal = 0.5 * SEEN_SIDE * math.sqrt(away**2 - radius**2) / radius
    cameras = []
    for k in range(SEEN_FROM):
        z, azimuth = 1.0 - (2.0 * k + 1.0) / SEEN_FROM, k * math.pi * (3.0 - math.sqrt(5.0))
        ring = math.sqrt(1.0 - z * z)
        place = middle + away * np.array([ring * math.cos(azimuth), ring * math.sin(azimuth), z])
        pose = look_at(place.tolist(), middle.tolist())
        cameras.append(Camera.centred(f"around_{k:03d}", SEEN_SIDE, SEEN_SIDE, focal, pose))
    return cameras


def piece_of_face(num_vertices: int, faces: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the connected piece each triangle belongs to."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    joined = sparse.coo_array(
        (np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(num_vertices, num_vertices)
    )
    _, piece = sparse.csgraph.connected_components(joined, directed=False)
    return piece[faces[:, 0]]


def crosses_of(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return the normals of triangles [face, 3], as long as twice their area."""
    a, b, c = (np.asarray(vertices, np.float64)[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def edges_of(faces: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the edges of triangles [edge, 2], each once, its smaller vertex first."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.unique(np.sort(edges, axis=1), axis=0)


def joined(edges: NDArray[np.integer], num_vertices: int) -> sparse.csr_array:
    """Return the matrix that is one for every two neighbours."""
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    return sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(num_vertices, num_vertices))


def compact(
    vertices: NDArray[np.floating], faces: NDArray[np.integer]
) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    """Return the triangles with the vertices they use and no others."""
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def _chunks(points: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    return [points[start : start + CHUNK_POINTS] for start in range(0, len(points), CHUNK_POINTS)]


def _corner(values: NDArray[np.float64]) -> Corner:
    x, y, z = (float(value) for value in values)
    return x, y, z
