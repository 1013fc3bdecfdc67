"""Smoothing baked values along the surface: every texel's value from a plane fitted to its neighbours.

A least-squares plane keeps linear changes as they are, which a plain mean over neighbours at the border of
a chart would bend. Neighbours count less with distance and with the angle between normals.
"""

import numpy as np
import scipy.sparse
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import cKDTree

NUM_NEIGHBOURS = 9
_SHARPNESS = 32.0
"""Exponent of the cosine between normals: 0.5 at 12 degrees."""
_RIDGE = 0.05
"""Pulls the plane's slope towards zero where neighbours do not determine it."""


def smoothing(
    positions: Float[ndarray, "points 3"], normals: Float[ndarray, "points 3"]
) -> scipy.sparse.csr_array:
    """Return the matrix that turns values at the points [point, n] into smoothed ones; its rows sum to 1."""
    count = len(positions)
    neighbours = min(NUM_NEIGHBOURS, count)
    if neighbours < 4:
        return scipy.sparse.csr_array(scipy.sparse.eye_array(count, dtype=np.float32))
    distance, index = cKDTree(positions).query(positions, k=neighbours, workers=-1)
    # The fourth neighbour is one texel away on a regular atlas.
    width = np.maximum(distance[:, 4 if neighbours > 4 else -1], 1e-9)[:, None]
    alike = np.maximum(np.einsum("ni,nki->nk", normals, normals[index]), 0.0) ** _SHARPNESS
    weight = np.exp(-0.5 * (distance / width) ** 2) * alike
    weight[:, 0] = 1.0
    steep = np.abs(normals[:, 2:]) > 0.9
    tangent = np.cross(np.where(steep, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]]), normals)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    frame = np.stack([tangent, np.cross(normals, tangent)], axis=1)
    local = np.einsum("nai,nki->nka", frame, positions[index] - positions[:, None]) / width[..., None]
    design = np.concatenate([np.ones((count, neighbours, 1)), local], axis=-1)
    weighted = weight[..., None] * design
    normal_matrix = np.einsum("nka,nkb->nab", weighted, design)
    normal_matrix += np.diag([0.0, _RIDGE, _RIDGE]) * weight.sum(axis=1)[:, None, None]
    # The fitted plane at the point itself: the first row of the inverse times the weighted design.
    first = np.linalg.solve(normal_matrix, np.broadcast_to([[1.0], [0.0], [0.0]], (count, 3, 1)))[..., 0]
    rows = np.einsum("na,nka->nk", first, weighted).astype(np.float32)
    pointers = np.arange(0, count * neighbours + 1, neighbours)
    return scipy.sparse.csr_array((rows.ravel(), index.ravel(), pointers), shape=(count, count))
