"""The material field: albedo, GGX width and metalness at every point."""

from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor, nn

from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.errors import ConfigError
from flashcache.fields.mlp import linear, scale_gradient
from flashcache.geometry.contraction import contract

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


def scaled(materials: Materials, ratio: Float[Tensor, "3"]) -> Materials:
    """Return the materials with their albedo multiplied by `ratio` per channel and kept in [0, 1]."""
    return Materials((materials.albedo * ratio).clamp(0.0, 1.0), materials.alpha, materials.metalness)


@dataclass(frozen=True, kw_only=True, slots=True)
class MaterialConfig:
    """Sizes and starting values of the material network (supplement 2.6)."""

    grid: HashGridConfig = field(default_factory=HashGridConfig)
    gloss_grid: HashGridConfig | None = None
    """A grid of their own for GGX width and metalness, beyond the paper; None: they share that of albedo.
    It has the features, extent and scale of `grid`, so that a bundle stores both as levels of one."""
    width: int = 128
    num_raw: int = 10
    """Raw outputs; albedo, GGX width and metalness use five of them."""
    albedo_bias: float = -1.0
    alpha_bias: float = -1.0
    metalness_bias: float = 0.0
    alpha_gradient: float = 0.25
    """Factor on the gradient that reaches the GGX width."""

    def __post_init__(self) -> None:
        own = self.gloss_grid
        alike = ("num_features", "half_extent", "output_scale")
        if own is not None and any(getattr(own, name) != getattr(self.grid, name) for name in alike):
            raise ConfigError(f"materials.gloss_grid must have the {', '.join(alike)} of materials.grid")


class GlossField(nn.Module):
    """Raw GGX width and metalness, from a grid that albedo has no part in.

    Where they share features, steps go where the gradient of albedo points, which is many times larger. They
    are kept apart from each other too: half of each level's features belong to the width, half to metalness,
    and either begins as the sum of its own. A single feature per level serves both.
    """

    own: Tensor
    """Which weights of the head are learned."""

    def __init__(self, config: HashGridConfig) -> None:
        super().__init__()
        self.grid = HashGrid(config)
        self.head = linear(self.grid.out_features, 2)
        half = config.num_features // 2
        if not half:
            self.register_buffer(
                "own", torch.ones(2, self.grid.out_features, dtype=torch.bool), persistent=False
            )
            return
        feature = torch.arange(self.grid.out_features) % config.num_features
        self.register_buffer("own", torch.stack([feature < half, feature >= half]), persistent=False)
        with torch.no_grad():
            self.head.weight.copy_(self.own)

    def forward(self, contracted: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2"]:
        """Return both numbers before their sigmoids, at contracted positions."""
        weight = self.head.weight
        weight = torch.where(self.own, weight, weight.detach())
        return torch.nn.functional.linear(self.grid(contracted), weight, self.head.bias)


class MaterialField(nn.Module):
    """Maps world positions to `Materials`; light-independent."""

    def __init__(self, config: MaterialConfig, contraction_radius: float) -> None:
        super().__init__()
        self.config = config
        self.contraction_radius = contraction_radius
        self.grid = HashGrid(config.grid)
        self.bottleneck = linear(self.grid.out_features, config.width)
        self.head = linear(config.width, config.num_raw)
        self.gloss = None if config.gloss_grid is None else GlossField(config.gloss_grid)

    @property
    def shared(self) -> nn.ModuleList:
        """Return all parts but `gloss`."""
        return nn.ModuleList([self.grid, self.bottleneck, self.head])

    def forward(self, positions: Float[Tensor, "*batch 3"]) -> Materials:
        """Return albedo (linear Rec. 709), GGX width alpha and metalness, each in [0, 1]."""
        contracted = contract(positions, self.contraction_radius)
        raw = self.head(self.bottleneck(self.grid(contracted)))
        config, raw_alpha, raw_metalness = self.config, raw[..., 6:7], raw[..., 8:9]
        if self.gloss is not None:
            raw_alpha, raw_metalness = self.gloss(contracted).split(1, dim=-1)
        alpha = torch.sigmoid(raw_alpha + config.alpha_bias) * (1.0 - ALPHA_MINIMUM) + ALPHA_MINIMUM
        return Materials(
            albedo=torch.sigmoid(raw[..., 0:3] + config.albedo_bias),
            alpha=scale_gradient(alpha, config.alpha_gradient),
            metalness=torch.sigmoid(raw_metalness + config.metalness_bias),
        )
