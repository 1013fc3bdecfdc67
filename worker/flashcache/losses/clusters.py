"""A preference for few materials: each point is pulled towards points with similar materials.

Materials are compared as vectors of albedo, GGX width and metalness. Albedo is relative to the batch's
mean: a photograph does not distinguish dark surfaces in bright light from bright ones in dim light, and all
materials would be equal if they were black.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.errors import ConfigError
from flashcache.physical.brdf import Materials

TYPICAL_ALBEDO = 0.3
"""Mean albedo to which a batch is scaled before its materials are compared."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ClusterConfig:
    """A prior on the distribution of materials, beyond the paper."""

    weight: float = 0.0
    """Weight of the loss; 0 disables it."""
    width: float = 0.1
    """Distance beyond which two materials hardly count as one cluster, above 0."""
    gloss: float = 1.0
    """Factor on GGX width and metalness where materials are compared; 0 draws only albedo together."""

    def __post_init__(self) -> None:
        if self.width <= 0.0:
            raise ConfigError(f"stage_two.clusters.width must be above 0, got {self.width}")
        if self.gloss < 0.0:
            raise ConfigError(f"stage_two.clusters.gloss must not be negative, got {self.gloss}")


def material_entropy(
    materials: Materials, point_weight: Float[Tensor, " points"], width: float, gloss: float = 1.0
) -> Float[Tensor, ""]:
    """Return the quadratic entropy of the batch's materials, in nats: low where they form few clusters.

    `-log mean_ij exp(-|m_i - m_j|^2 / (4 width^2))`, from 0 (all alike) to the logarithm of the number of
    points; `point_weight` says how much each point counts, `gloss` how much GGX width and metalness do.
    Points further apart than a few widths do not interact, so that clusters sharpen without moving together.
    Source: the parsimony prior of Barron and Malik (SIRFS), on materials instead of colours.
    """
    total = point_weight.sum().clamp_min(1e-6)
    mean = (point_weight[:, None] * materials.albedo).sum() / (3.0 * total)
    albedo = TYPICAL_ALBEDO * materials.albedo / mean.clamp_min(1e-3)
    vectors = torch.cat([albedo, gloss * materials.alpha, gloss * materials.metalness], dim=-1)
    # As a matrix product: differences of all pairs would take five times the memory.
    length = vectors.square().sum(dim=-1)
    squared = (length[:, None] + length[None] - 2.0 * vectors @ vectors.T).clamp_min(0.0)
    pairs = (point_weight[:, None] * point_weight[None]).clamp_min(1e-12).log()
    return 2.0 * total.log() - torch.logsumexp((pairs - squared / (4.0 * width**2)).reshape(-1), dim=0)
