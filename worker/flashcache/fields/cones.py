"""Density of blobs: a density field asked through the multisampled features of cones."""

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.encoding.multisample import encode_cones, encode_cones_with_jacobian
from flashcache.fields.density import DensityField, DensitySample
from flashcache.geometry.cones import ConePoints
from flashcache.geometry.contraction import contract_vjp


def cone_density(field: DensityField, points: ConePoints) -> DensitySample:
    """Return density and hidden feature of intervals of cones."""
    return field.of_features(encode_cones(field.grid, points, field.contraction_radius))


def cone_density_with_gradient(
    field: DensityField, points: ConePoints
) -> tuple[DensitySample, Float[Tensor, "points 3"]]:
    """Return the sample and the gradient of raw log density when all six points move together."""
    radius = field.contraction_radius
    features, jacobian = encode_cones_with_jacobian(field.grid, points, radius)
    sample, by_feature = field.by_feature(features)
    by_contracted = torch.einsum("pf,pjfk->pjk", by_feature, jacobian)
    gradient = contract_vjp(points.positions.reshape(-1, 3), radius, by_contracted.reshape(-1, 3))
    return sample, gradient.reshape(by_contracted.shape).sum(dim=1)
