"""Density of the volume, the feature behind it, and its two normals.

Positions are world coordinates; density is in 1/scene unit.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.encoding.occupancy import Occupancy
from flashcache.fields.mlp import Hidden, linear
from flashcache.fields.packing import NO_GRID, Layers, arrays_of, packed_grid, packed_occupancy
from flashcache.geometry.contraction import contract, contract_vjp
from flashcache.kernels import density_query, dispatch, surface_query
from flashcache.kernels.cpu import over_rows


@dataclass(frozen=True, kw_only=True, slots=True)
class DensityConfig:
    """Sizes of a density network (supplement 2.2)."""

    grid: HashGridConfig = field(default_factory=HashGridConfig)
    width: int = 64
    num_layers: int = 2
    bias: float = -1.0
    """Added to the raw output before the exponential."""
    softplus_beta: float | None = 10.0
    """Sharpness of the softplus activation; None is ReLU, as in the paper. Differs from the
    paper by default: ReLU has no curvature, so normals from one derivative could not be trained."""


class DensitySample(NamedTuple):
    """The output of a density network for a batch of points."""

    density: Float[Tensor, " points"]
    hidden: Float[Tensor, "points width"]


class DensityField(nn.Module):
    """`sigma(x) = exp(min(raw(x) + bias, 70))`, with raw from a feature grid and a small network.

    It is 0 where `occupancy` says that nothing can be.
    """

    def __init__(
        self, config: DensityConfig, contraction_radius: float, occupancy: Occupancy | None = None
    ) -> None:
        super().__init__()
        # In a tuple: it belongs to the model, once, and not to each of its densities.
        self._occupancy = (occupancy,)
        self.config = config
        self.contraction_radius = contraction_radius
        self.grid = HashGrid(config.grid)
        self.network = Hidden(
            self.grid.out_features, config.width, config.num_layers, softplus_beta=config.softplus_beta
        )
        self.head = linear(self.network.num_outputs, 1)

    @property
    def occupancy(self) -> Occupancy | None:
        """Return the cells outside of which the density is zero, if there are any."""
        return self._occupancy[0]

    def _density(self, raw: Float[Tensor, " points"], positions: Float[Tensor, "points 3"]) -> Tensor:
        density = torch.exp((raw + self.config.bias).clamp_max(70.0))
        occupancy = self.occupancy
        return density if occupancy is None else density * occupancy.share(positions)

    def forward(self, positions: Float[Tensor, "points 3"]) -> DensitySample:
        """Return density and hidden feature at world positions.

        Without gradients one compiled function answers, where there is one (`dispatch.answers_compiled`).
        """
        if dispatch.answers_compiled(positions, self.grid.table):
            return self._answer_compiled(positions)
        hidden = self.network(self.grid(contract(positions, self.contraction_radius)))
        return DensitySample(self._density(self.head(hidden)[:, 0], positions), hidden)

    def packed(self, layers: Layers) -> density_query.Density:
        """Add the networks to `layers` and return what else compiled queries read of the field."""
        begin = len(layers.rows)
        layers.add_hidden(self.network, self.head)
        return density_query.Density(
            begin=begin,
            end=len(layers.rows),
            sharpness=np.float32(self.network.softplus_beta or 1.0),
            bias=np.float32(self.config.bias),
            inverse_radius=np.float32(1.0 / self.contraction_radius),
        )

    def _answer_compiled(self, positions: Float[Tensor, "points 3"]) -> DensitySample:
        """Return what `forward` does in torch, up to rounding."""
        layers, count = Layers(), len(positions)
        query = self.packed(layers)
        sample = DensitySample(torch.empty(count), torch.empty(count, self.network.num_outputs))
        over_rows(
            density_query.samples,
            count,
            density_query.POINTS,
            *arrays_of(positions),
            packed_grid(self.grid),
            layers.packed(),
            query,
            *packed_occupancy(self.occupancy),
            layers.widest,
            *arrays_of(*sample),
        )
        return sample

    def density(self, positions: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
        """Return the density alone, for any batch shape."""
        return self(positions.reshape(-1, 3)).density.reshape(positions.shape[:-1])

    def with_gradient(
        self, positions: Float[Tensor, "points 3"]
    ) -> tuple[DensitySample, Float[Tensor, "points 3"]]:
        """Return the sample and the gradient of the raw log density with respect to position.

        The gradient is differentiable with respect to every parameter at first-order cost:
        the grid returns its Jacobian, and only the small network is differentiated twice.
        """
        contracted = contract(positions, self.contraction_radius)
        features, jacobian = self.grid.encode_with_jacobian(contracted)
        if not features.requires_grad:
            features = features.detach().requires_grad_()
        with torch.enable_grad():
            hidden = self.network(features)
            raw = self.head(hidden)[:, 0]
            (by_feature,) = torch.autograd.grad(
                raw.sum(), features, create_graph=torch.is_grad_enabled(), retain_graph=True
            )
        by_contracted = (by_feature[:, :, None] * jacobian).sum(dim=1)
        gradient = contract_vjp(positions, self.contraction_radius, by_contracted)
        return DensitySample(self._density(raw, positions), hidden), gradient


def derived_normal(gradient: Float[Tensor, "points 3"], floor: float) -> Float[Tensor, "points 3"]:
    """Return the normal against the gradient of log density, shorter than one where that is small.

    `floor` [1/scene unit] keeps the direction of a vanishing gradient from jumping:
    `-g / sqrt(|g|^2 + floor^2)`. Source: supplement Eq. 7, with the floor as our guard.
    """
    return -gradient * torch.rsqrt(gradient.square().sum(dim=-1, keepdim=True) + floor * floor)


@dataclass(frozen=True, kw_only=True, slots=True)
class NormalConfig:
    """Sizes of the network that predicts normals."""

    own_grid: HashGridConfig | None = None
    """Grid of its own; None predicts linearly from the density feature, as the paper does."""
    width: int = 64


class NormalField(nn.Module):
    """The predicted normal, which all shading uses."""

    def __init__(self, config: NormalConfig, num_features: int, contraction_radius: float) -> None:
        super().__init__()
        self.contraction_radius = contraction_radius
        if config.own_grid is None:
            self.grid = None
            self.network = None
            self.head = linear(num_features, 3)
        else:
            self.grid = HashGrid(config.own_grid)
            self.network = Hidden(self.grid.out_features + num_features, config.width, 1)
            self.head = linear(config.width, 3)

    def forward(
        self, positions: Float[Tensor, "points 3"], hidden: Float[Tensor, "points width"]
    ) -> Float[Tensor, "points 3"]:
        """Return unit normals that face outwards, at world positions with their density features.

        Without gradients one compiled function answers, where there is one (`dispatch.answers_compiled`).
        """
        if dispatch.answers_compiled(positions, hidden, self.head.weight):
            return self._answer_compiled(positions, hidden)
        if self.grid is None or self.network is None:
            raw = self.head(hidden)
        else:
            features = self.grid(contract(positions, self.contraction_radius))
            raw = self.head(self.network(torch.cat([features, hidden.detach()], dim=-1)))
        return -torch.nn.functional.normalize(raw, dim=-1, eps=1e-8)

    def _answer_compiled(
        self, positions: Float[Tensor, "points 3"], hidden: Float[Tensor, "points width"]
    ) -> Float[Tensor, "points 3"]:
        """Return what `forward` does in torch, up to rounding."""
        normals = torch.empty_like(positions, memory_format=torch.contiguous_format)
        grid, layers = NO_GRID, Layers()
        if self.grid is None or self.network is None:
            layers.add(self.head)
        else:
            grid = packed_grid(self.grid)
            layers.add_hidden(self.network, self.head)
        over_rows(
            surface_query.normals,
            len(positions),
            surface_query.POINTS,
            *arrays_of(positions, hidden),
            self.grid is not None,
            grid,
            layers.packed(),
            np.float32(1.0 / self.contraction_radius),
            layers.widest,
            *arrays_of(normals),
        )
        return normals
