"""A prior on metalness from how much the cache's radiance varies with direction."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.errors import ConfigError


@dataclass(frozen=True, kw_only=True, slots=True)
class MetalnessPriorConfig:
    """The prior on metalness beyond the paper; off by default (decision 0015)."""

    warmup_weight: float = 0.0
    """Weight while the fast cache warms up and nothing else moves the materials."""
    weight: float = 0.0
    """Weight afterwards."""
    num_directions: int = 16
    """Directions per point in which the cache's radiance is compared."""
    variation: tuple[float, float] = (0.02, 0.06)
    """Relative variation of radiance of a surface without and of one with metal."""
    range: tuple[float, float] = (0.12, 0.95)
    """Metalness at the two ends."""

    def __post_init__(self) -> None:
        if self.num_directions < 2:
            raise ConfigError(f"num_directions must be at least 2, got {self.num_directions}")
        if not self.variation[0] < self.variation[1]:
            raise ConfigError(f"variation must rise, got {self.variation}")


def directional_variation(
    diffuse: Float[Tensor, "points directions 3"],
    specular: Float[Tensor, "points directions 3"],
    weight: Float[Tensor, " points"],
) -> Float[Tensor, " points"]:
    """Return the spread of specular radiance over directions, relative to what bright points send.

    A dielectric reflects a few hundredths of what meets it, a metal most of it. What meets a point is not
    known yet; a white surface would send about as much. So the measure is the larger of the point's own mean
    radiance and that of the brightest tenth of the points that have a `weight`: a dark dielectric reflects no
    more than a white one, however large its highlights are beside its own colour. Under a uniform
    environment nothing varies.
    """
    shine = specular.sum(dim=-1)
    mean = shine.mean(dim=-1) + diffuse.sum(dim=-1).mean(dim=-1)
    seen = mean[weight > 0.0]
    bright = torch.quantile(seen, 0.9) if len(seen) else mean.new_zeros(())
    return shine.std(dim=-1) / (torch.maximum(mean, bright) + 1e-4)


def metalness_prior(
    metalness: Float[Tensor, "points 1"],
    variation: Float[Tensor, " points"],
    weight: Float[Tensor, " points"],
    config: MetalnessPriorConfig,
) -> Float[Tensor, ""]:
    """Return the weighted mean squared distance of metalness from what `variation` suggests."""
    low, high = config.variation
    share = ((variation.detach() - low) / (high - low)).clamp(0.0, 1.0)
    rise = share * share * (3.0 - 2.0 * share)
    least, most = config.range
    wanted = least + (most - least) * rise
    return ((metalness[:, 0] - wanted).square() * weight).mean()


def directions_around(
    normal: Float[Tensor, "points 3"], num_directions: int, generator: torch.Generator
) -> Float[Tensor, "points directions 3"]:
    """Return unit directions above the surface, about as dense as the cosine to its normal."""
    shape = (len(normal), num_directions, 3)
    free = torch.randn(shape, generator=generator, device=normal.device, dtype=normal.dtype)
    free = torch.nn.functional.normalize(free, dim=-1)
    # Slightly more than the unit sphere that rests on the surface, so that none lies in it.
    return torch.nn.functional.normalize(free + 1.05 * normal.detach()[:, None], dim=-1)
