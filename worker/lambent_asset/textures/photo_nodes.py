"""A sparse set of surface points on which views are compared, chosen and levelled.

A node is a block of 2 x 2 texels of baked transport: about as far apart as the model resolves. Means over
neighbours follow the surface in space, so that they do not end at the border of a chart.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Float, Float32, Int
from lambent_relight.baked.raster import nearest_texel
from lambent_relight.baked.transport import coarse_blocks
from numpy import ndarray
from scipy.spatial import cKDTree

NUM_NEIGHBOURS = 13
_SHARPNESS = 8.0
"""Exponent of the cosine between normals: neighbours across an edge of 45 degrees count a sixteenth."""


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Surface points in the order of their blocks."""

    texel: Int[ndarray, " nodes"]
    """The covered texel that each node stands for."""
    positions: Float32[ndarray, "nodes 3"]
    normals: Float32[ndarray, "nodes 3"]
    means: scipy.sparse.csr_array
    """Matrix of means over neighbours [node, node]; its rows sum to 1."""
    spacing: float
    """Median distance of neighbours, scene units."""
    owner: Int[ndarray, "rows columns"]
    """The node of every place of the atlas of blocks; outside charts that of the nearest."""

    def blurred(self, values: Float[ndarray, "nodes _"], times: int) -> Float32[ndarray, "nodes _"]:
        """Return `values` after `times` means over neighbours; one spreads a value by about `spacing`."""
        for _ in range(times):
            values = self.means @ values
        return np.asarray(values, np.float32)


def nodes_of(
    size: int,
    texel_index: Int[ndarray, " texels"],
    positions: Float32[ndarray, "texels 3"],
    normals: Float32[ndarray, "texels 3"],
) -> Nodes:
    """Return the nodes of an atlas of `size` texels a side."""
    first, _ = coarse_blocks(size, texel_index)
    row, column = np.divmod(texel_index[first].astype(np.int64), size)
    side = -(-size // 2)
    place = ((row // 2) * side + column // 2).astype(np.int32)
    means, spacing = _neighbour_means(positions[first], normals[first])
    return Nodes(first, positions[first], normals[first], means, spacing, nearest_texel(place, side))


def _neighbour_means(
    positions: Float32[ndarray, "nodes 3"], normals: Float32[ndarray, "nodes 3"]
) -> tuple[scipy.sparse.csr_array, float]:
    count = len(positions)
    neighbours = min(NUM_NEIGHBOURS, count)
    distance, index = cKDTree(positions).query(positions, k=neighbours)
    distance, index = distance.reshape(count, -1), index.reshape(count, -1)
    # The fourth neighbour of a regular grid is one step away.
    spacing = float(np.median(distance[:, min(4, neighbours - 1)]))
    alike = np.maximum(np.einsum("ni,nki->nk", normals, normals[index]), 0.0) ** _SHARPNESS
    weight = np.exp(-0.5 * (distance / max(spacing, 1e-12)) ** 2) * alike
    weight[:, 0] = 1.0
    weight /= weight.sum(axis=1, keepdims=True)
    pointers = np.arange(0, count * neighbours + 1, neighbours)
    matrix = scipy.sparse.csr_array(
        (weight.astype(np.float32).ravel(), index.ravel(), pointers), shape=(count, count)
    )
    return matrix, spacing
