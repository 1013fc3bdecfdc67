"""A preference for few materials: each point is pulled towards points with similar materials.

Materials are compared as vectors of albedo, GGX width and metalness. Albedo is relative to the batch's
mean: a photograph does not distinguish dark surfaces in bright light from bright ones in dim light, and all
materials would be equal if they were black.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.color import perceptual_roughness_from_alpha
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
    """Factor on GGX width where materials are compared; 0 draws only albedo and metalness together."""
    gloss_weight: float = 0.0
    """Weight of the differences of gloss between neighbours of similar albedo; 0 disables it."""
    gloss_distance: float = 0.3
    """Distance beyond which two points hardly count as neighbours, scene units."""

    def __post_init__(self) -> None:
        if self.width <= 0.0:
            raise ConfigError(f"stage_two.clusters.width must be above 0, got {self.width}")
        if self.gloss < 0.0:
            raise ConfigError(f"stage_two.clusters.gloss must not be negative, got {self.gloss}")
        if self.gloss_distance <= 0.0:
            raise ConfigError(f"stage_two.clusters.gloss_distance must be above 0, got {self.gloss_distance}")


def material_entropy(
    materials: Materials, point_weight: Float[Tensor, " points"], width: float, gloss: float = 1.0
) -> Float[Tensor, ""]:
    """Return the quadratic entropy of the batch's materials, in nats: low where they form few clusters.

    `-log mean_ij exp(-|m_i - m_j|^2 / (4 width^2))`, from 0 (all alike) to the logarithm of the number of
    points; `point_weight` says how much each point counts, `gloss` how much GGX width does.
    Points further apart than a few widths do not interact, so that clusters sharpen without moving together.
    Source: the parsimony prior of Barron and Malik (SIRFS), on materials instead of colours.
    """
    total = point_weight.sum().clamp_min(1e-6)
    albedo = _relative_albedo(materials, point_weight)
    vectors = torch.cat([albedo, gloss * materials.alpha, materials.metalness], dim=-1)
    squared = _squared_distances(vectors)
    pairs = (point_weight[:, None] * point_weight[None]).clamp_min(1e-12).log()
    return 2.0 * total.log() - torch.logsumexp((pairs - squared / (4.0 * width**2)).reshape(-1), dim=0)


def gloss_differences(
    materials: Materials,
    positions: Float[Tensor, "points 3"],
    point_weight: Float[Tensor, " points"],
    config: ClusterConfig,
) -> Float[Tensor, ""]:
    """Return the mean squared difference of perceptual roughness and metalness between alike neighbours.

    How much two points are alike, `exp(-|a_i - a_j|^2 / (4 width^2) - |x_i - x_j|^2 / (4 gloss_distance^2))`,
    is a constant: albedo, which photographs show at every pixel, says what belongs together, and gloss, which
    few pixels show, is shared there. Surfaces of unlike albedo do not touch each other.
    """
    with torch.no_grad():
        unlike = _squared_distances(_relative_albedo(materials, point_weight)) / (4.0 * config.width**2)
        apart = _squared_distances(positions) / (4.0 * config.gloss_distance**2)
        alike = point_weight[:, None] * point_weight[None] * torch.exp(-unlike - apart)
    gloss = perceptual_roughness_from_alpha(materials.alpha)
    return (alike * _squared_distances(gloss)).sum() / alike.sum().clamp_min(1e-6)


def _relative_albedo(
    materials: Materials, point_weight: Float[Tensor, " points"]
) -> Float[Tensor, "points 3"]:
    """Return albedo scaled to a mean of `TYPICAL_ALBEDO`."""
    total = point_weight.sum().clamp_min(1e-6)
    mean = (point_weight[:, None] * materials.albedo).sum() / (3.0 * total)
    return TYPICAL_ALBEDO * materials.albedo / mean.clamp_min(1e-3)


def _squared_distances(vectors: Float[Tensor, "points size"]) -> Float[Tensor, "points points"]:
    """Return the squared distances of all pairs."""
    # As a matrix product: differences of all pairs would take five times the memory.
    length = vectors.square().sum(dim=-1)
    return (length[:, None] + length[None] - 2.0 * vectors @ vectors.T).clamp_min(0.0)
