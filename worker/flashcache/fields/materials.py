"""The material field: albedo, GGX width and metalness at every point."""

from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor, nn

from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.fields.mlp import linear
from flashcache.geometry.contraction import contract
from flashcache.gradients import scale_gradient

ALPHA_MINIMUM = 1e-4


@dataclass(frozen=True)
class Materials:
    """Reflectance of points: linear albedo, GGX width (above 0) and metalness, all in 0..1."""

    albedo: Float[Tensor, "*batch 3"]
    alpha: Float[Tensor, "*batch 1"]
    metalness: Float[Tensor, "*batch 1"]

    def per_direction(self) -> "Materials":
        """Return the same with an axis of length one for the directions at a point."""
        return Materials(self.albedo.unsqueeze(-2), self.alpha.unsqueeze(-2), self.metalness.unsqueeze(-2))


@dataclass(frozen=True, kw_only=True, slots=True)
class MaterialConfig:
    """Sizes and starting values of the material network (supplement 2.6)."""

    grid: HashGridConfig = field(default_factory=HashGridConfig)
    width: int = 128
    num_raw: int = 10
    """Raw outputs; albedo, GGX width and metalness use five of them."""
    albedo_bias: float = -1.0
    alpha_bias: float = -1.0
    metalness_bias: float = 0.0
    alpha_gradient: float = 0.25
    """Factor on the gradient that reaches the GGX width."""


class MaterialField(nn.Module):
    """Maps world positions to `Materials`; light-independent."""

    def __init__(self, config: MaterialConfig, contraction_radius: float) -> None:
        super().__init__()
        self.config = config
        self.contraction_radius = contraction_radius
        self.grid = HashGrid(config.grid)
        self.bottleneck = linear(self.grid.out_features, config.width)
        self.head = linear(config.width, config.num_raw)

    def forward(self, positions: Float[Tensor, "*batch 3"]) -> Materials:
        """Return albedo (linear Rec. 709), GGX width alpha and metalness, each in [0, 1]."""
        contracted = contract(positions, self.contraction_radius)
        raw = self.head(self.bottleneck(self.grid(contracted)))
        config = self.config
        alpha = torch.sigmoid(raw[..., 6:7] + config.alpha_bias) * (1.0 - ALPHA_MINIMUM) + ALPHA_MINIMUM
        return Materials(
            albedo=torch.sigmoid(raw[..., 0:3] + config.albedo_bias),
            alpha=scale_gradient(alpha, config.alpha_gradient),
            metalness=torch.sigmoid(raw[..., 8:9] + config.metalness_bias),
        )
