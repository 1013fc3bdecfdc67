"""The surface of a trained model as triangles, and the box it lies in."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from flashcache.export.reference import surface
from flashcache.physical.model import InverseModel
from numpy.typing import NDArray
from scipy import ndimage, sparse
from skimage.measure import marching_cubes

from lambent_worker.errors import WorkerError

Corner = tuple[float, float, float]

SURVEY_CELLS = 64
"""Cells along the longest side of the scene's box in the first look."""
SURVEY_MARGIN = 2
"""Cells of the first look that are kept around what was found."""
SURFACE_DEPTH = math.log(2.0)
"""Matter begins where one cell's width of it hides half of what is behind it (optical depth)."""
DEPTH_RANGE = 50.0
"""Optical depths are limited to this factor around `SURFACE_DEPTH` before a surface is laid through them."""
FAINTEST = 0.05
"""Where nothing reaches that, a surface is laid at half the largest depth, if it is above this."""
FLOATER_AREA = 0.01
"""Pieces with less than this share of the largest piece's surface are removed."""
FLOATER_VOLUME = FLOATER_AREA**1.5
"""The same, as a share of the largest piece's volume."""
CHUNK_POINTS = 65536


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles in world coordinates (z up), counter-clockwise seen from outside."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]
    normals: NDArray[np.float32]
    albedo: NDArray[np.float32]
    """Linear Rec. 709, per vertex."""
    perceptual_roughness: NDArray[np.float32]
    """Per vertex."""
    metalness: NDArray[np.float32]
    """Per vertex."""


def occupied_box(model: InverseModel) -> tuple[Corner, Corner]:
    """Return the smallest box, with a margin, around all matter but floaters, inside the scene's box.

    Raises WorkerError when there is no matter.
    """
    low, high = np.array(model.domain.bounds_min), np.array(model.domain.bounds_max)
    depth, cell = _depth_grid(model, low, high, SURVEY_CELLS)
    # Matter thinner than a cell of this coarse look must not be missed.
    labels, _ = ndimage.label(depth > 0.5 * _level(depth))
    sizes = np.bincount(labels.ravel())[1:]
    kept = np.flatnonzero(sizes >= FLOATER_VOLUME * sizes.max()) + 1
    places = np.argwhere(np.isin(labels, kept))
    first = low + cell * (places.min(axis=0) - SURVEY_MARGIN)
    last = low + cell * (places.max(axis=0) + 1 + SURVEY_MARGIN)
    return _corner(np.maximum(first, low)), _corner(np.minimum(last, high))


def extract_mesh(model: InverseModel, box_min: Corner, box_max: Corner, resolution: int) -> Mesh:
    """Return the surface inside a box, with `resolution` cells along its longest side.

    Raises WorkerError when there is none.
    """
    low, high = np.array(box_min), np.array(box_max)
    depth, cell = _depth_grid(model, low, high, resolution)
    level = _level(depth)
    # The logarithm of density is what the network gives, and nearly linear across a surface; opacity jumps.
    field = np.log((depth / level).clip(1.0 / DEPTH_RANGE, DEPTH_RANGE))
    # Empty space around the grid closes the surface where matter touches the box.
    field = np.pad(field, 1, constant_values=-math.log(DEPTH_RANGE))
    vertices, faces, _, _ = marching_cubes(field, 0.0, gradient_direction="ascent")
    vertices, faces = _without_floaters(vertices, faces)
    vertices = (low + (vertices - 0.5) * cell).astype(np.float32)
    found = _surface(model, vertices)
    return Mesh(
        vertices=vertices,
        faces=faces.astype(np.uint32),
        normals=found["normal"],
        albedo=found["albedo"],
        perceptual_roughness=found["perceptual_roughness"],
        metalness=found["metalness"],
    )


def _level(depth: NDArray[np.float32]) -> float:
    """Return the optical depth at which matter begins; raises WorkerError when there is none."""
    level = min(SURFACE_DEPTH, 0.5 * float(depth.max()))
    if not level > 0.5 * FAINTEST:
        raise WorkerError(
            "export.no_surface",
            "the trained density holds no surface; look at the previews, check the scene with lambent check, "
            "or train with more steps",
        )
    return level


@torch.no_grad()
def _depth_grid(
    model: InverseModel, low: NDArray[np.float64], high: NDArray[np.float64], resolution: int
) -> tuple[NDArray[np.float32], float]:
    """Return the optical depth of one cell's width at the centres of cubic cells, and that width."""
    cell = float((high - low).max()) / resolution
    counts = np.maximum(1, np.ceil((high - low) / cell - 1e-6).astype(int))
    axes = [low[k] + (np.arange(counts[k]) + 0.5) * cell for k in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)
    device = next(model.parameters()).device
    parts = [
        cell * model.nerf.density.density(torch.from_numpy(chunk).to(device)).cpu()
        for chunk in _chunks(points)
    ]
    return torch.cat(parts).numpy().reshape(counts), cell


def _without_floaters(
    vertices: NDArray[np.float32], faces: NDArray[np.integer]
) -> tuple[NDArray[np.float32], NDArray[np.integer]]:
    """Return the triangles of the large connected pieces, and the vertices they use."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    joined = sparse.coo_array(
        (np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(len(vertices), len(vertices))
    )
    _, piece = sparse.csgraph.connected_components(joined, directed=False)
    piece_of_face = piece[faces[:, 0]]
    sizes = np.bincount(piece_of_face)
    faces = faces[sizes[piece_of_face] >= FLOATER_AREA * sizes.max()]
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


@torch.no_grad()
def _surface(model: InverseModel, points: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
    device = next(model.parameters()).device
    parts = [surface(model, torch.from_numpy(chunk).to(device)) for chunk in _chunks(points)]
    return {name: torch.cat([part[name] for part in parts]).cpu().numpy() for name in parts[0]}


def _chunks(points: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    return [points[start : start + CHUNK_POINTS] for start in range(0, len(points), CHUNK_POINTS)]


def _corner(values: NDArray[np.float64]) -> Corner:
    x, y, z = (float(value) for value in values)
    return x, y, z
