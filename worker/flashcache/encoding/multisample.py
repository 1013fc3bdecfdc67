"""Grid features of blobs instead of points: levels that are finer than the blob fade out (Zip-NeRF)."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.encoding.hash_grid import HashGrid
from flashcache.geometry.cones import ConePoints
from flashcache.geometry.contraction import contract


def contracted_width(
    positions: Float[Tensor, "*batch 3"], width: Float[Tensor, "*batch"], radius: float
) -> Float[Tensor, "*batch"]:
    """Return a blob's width in contracted coordinates: times the cube root of the map's volume factor."""
    norm = (positions / radius).norm(dim=-1).clamp_min(1.0)
    tangential, radial = (2.0 - 1.0 / norm) / norm, 1.0 / norm.square()
    return width * (tangential.square() * radial).pow(1.0 / 3.0) / radius


def level_weights(grid: HashGrid, width: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch outputs"]:
    """Return the factor of each feature for blobs of a contracted width: erf(1 / sqrt(8 width^2 n^2)).

    n is the number of voxels per unit of length. Source: Zip-NeRF, downweighting.
    """
    layout = grid.layout
    voxels = width.new_tensor([level.resolution / (2.0 * layout.half_extent) for level in layout.levels])
    ratio = 1.0 / (math.sqrt(8.0) * (width[..., None] * voxels).clamp_min(1e-9))
    return torch.erf(ratio).repeat_interleave(layout.num_features, dim=-1)


def encode_cones(grid: HashGrid, points: ConePoints, radius: float) -> Float[Tensor, "points outputs"]:
    """Return the mean over the six points of their features, each level weighed by the blob's width."""
    width = contracted_width(points.positions, points.width, radius)
    return (grid(contract(points.positions, radius)) * level_weights(grid, width)).mean(dim=1)


def encode_cones_with_jacobian(
    grid: HashGrid, points: ConePoints, radius: float
) -> tuple[Float[Tensor, "points outputs"], Float[Tensor, "points 6 outputs 3"]]:
    """Return the features of `encode_cones`, and each point's share of their derivative.

    The derivative is by the contracted positions; weights count as constants.
    """
    width = contracted_width(points.positions, points.width, radius)
    weights = level_weights(grid, width) / points.width.shape[1]
    features, jacobian = grid.encode_with_jacobian(contract(points.positions, radius))
    return (features * weights).sum(dim=1), jacobian * weights[..., None]
