"""Contraction of unbounded space into a ball of radius two (method: spatial domain)."""

import torch
from jaxtyping import Float
from torch import Tensor


def contract(positions: Float[Tensor, "*batch 3"], radius: float) -> Float[Tensor, "*batch 3"]:
    """Return `positions` in contracted coordinates, where `radius` becomes 1 and infinity 2.

    `positions` and `radius` are in scene units, the result has none. Points inside `radius` are
    only scaled; the map is continuous with a continuous derivative.
    Source: Mip-NeRF 360 Eq. 10, used by the paper for its grids.
    """
    scaled = positions / radius
    norm = scaled.norm(dim=-1, keepdim=True).clamp_min(1.0)
    return scaled * ((2.0 - 1.0 / norm) / norm)


def contract_vjp(
    positions: Float[Tensor, "*batch 3"], radius: float, gradient: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch 3"]:
    """Return the gradient with respect to `positions`, given the one with respect to `contract(positions)`.

    The Jacobian is symmetric: 1/radius inside, and outside (per unit of `radius`)
    a I + (1/n^2 - a) e e^T, with n the norm, e the unit direction and a = (2 - 1/n)/n the tangential scale;
    1/n^2 is the radial scale.
    """
    scaled = positions / radius
    norm = scaled.norm(dim=-1, keepdim=True).clamp_min(1.0)
    tangential = (2.0 - 1.0 / norm) / norm
    radial = 1.0 / norm.square()
    unit = torch.nn.functional.normalize(scaled, dim=-1)
    along = (gradient * unit).sum(dim=-1, keepdim=True)
    outside = tangential * gradient + (radial - tangential) * along * unit
    return torch.where(norm > 1.0, outside, gradient) / radius
