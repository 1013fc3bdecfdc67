"""A prior on metalness from how much the cache's radiance varies with direction."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from flashcache.errors import ConfigError
from flashcache.parallel.ranks import rows_of_all_ranks
from flashcache.randomness import normal as draw_normal
from flashcache.rows import shapes_are_fixed

BRIGHT = 0.9
"""Share of the points that are darker than bright ones."""


@dataclass(frozen=True, kw_only=True, slots=True)
class MetalnessPriorConfig:
    """The prior on metalness beyond the paper; off by default (decision 0015)."""

    warmup_weight: float = 0.0
    """Weight during the warm-up of the fast cache, when nothing else changes the materials."""
    weight: float = 0.0
    """Weight afterwards."""
    num_directions: int = 16
    """Directions per point at which the cache's radiance is compared."""
    variation: tuple[float, float] = (0.1, 0.35)
    """Variation of radiance, relative to the point's own, of a dielectric and of a metal."""
    bright_variation: tuple[float, float] | None = None
    """The same relative to bright points; if set, a metal must pass both tests."""
    range: tuple[float, float] = (0.12, 0.95)
    """Metalness at the two ends."""
    perceptual_roughness: tuple[float, float] | None = None
    """The same for perceptual roughness, during the warm-up alone: where radiance varies much with direction,
    a surface is smooth (decision 0025). None leaves it at its initial value."""

    def __post_init__(self) -> None:
        if self.num_directions < 2:
            raise ConfigError(f"num_directions must be at least 2, got {self.num_directions}")
        for name, ends in (("variation", self.variation), ("bright_variation", self.bright_variation)):
            if ends is not None and not ends[0] < ends[1]:
                raise ConfigError(f"{name} must rise, got {ends}")


class Variation(NamedTuple):
    """Spread of specular radiance over directions (standard deviation), relative to two levels."""

    own: Float[Tensor, " points"]
    """Relative to the point's own mean radiance."""
    bright: Float[Tensor, " points"]
    """Relative to that of bright points."""


def directional_variation(
    diffuse: Float[Tensor, "points directions 3"],
    specular: Float[Tensor, "points directions 3"],
    weight: Float[Tensor, " points"],
) -> Variation:
    """Return how much the radiance of points varies with direction; see decision 0015.

    A dielectric reflects a few hundredths of the incoming light and adds diffuse light, which does not
    vary; all light from a metal is specular. Relative to a dark surface every highlight is large, so the
    second level is the larger of the point's own and that of the brightest tenth of the points that have a
    `weight`: about what a white surface would send. Under a uniform environment nothing varies.
    """
    shine = specular.sum(dim=-1)
    mean = shine.mean(dim=-1) + diffuse.sum(dim=-1).mean(dim=-1)
    bright = _quantile_where(rows_of_all_ranks(mean), rows_of_all_ranks(weight) > 0.0, BRIGHT)
    spread = shine.std(dim=-1)
    return Variation(spread / (mean + 1e-4), spread / (torch.maximum(mean, bright) + 1e-4))


def _quantile_where(
    values: Float[Tensor, " points"], counted: Bool[Tensor, " points"], share: float
) -> Float[Tensor, ""]:
    """Return the value below which `share` of the counted values lie; 0 without any."""
    if not shapes_are_fixed():
        seen = values[counted]
        return torch.quantile(seen, share) if len(seen) else values.new_zeros(())
    ordered = torch.where(counted, values, torch.full_like(values, torch.inf)).sort().values
    place = share * (counted.sum() - 1).clamp_min(0)
    low, high = ordered[torch.stack([place.floor(), place.ceil()]).long()]
    return torch.where(counted.any(), torch.lerp(low, high, place - place.floor()), torch.zeros_like(low))


def variation_prior(
    values: Float[Tensor, "points 1"],
    ends: tuple[float, float],
    variation: Variation,
    weight: Float[Tensor, " points"],
    config: MetalnessPriorConfig,
) -> Float[Tensor, ""]:
    """Return the weighted mean squared distance of values from those that `variation` suggests.

    `ends` are the values of a dielectric and of a metal: `config.range` for metalness.
    """
    rise = _smooth_step(variation.own.detach(), config.variation)
    if config.bright_variation is not None:
        rise = torch.minimum(rise, _smooth_step(variation.bright.detach(), config.bright_variation))
    wanted = ends[0] + (ends[1] - ends[0]) * rise
    return ((values[:, 0] - wanted).square() * weight).mean()


def _smooth_step(values: Float[Tensor, " points"], ends: tuple[float, float]) -> Float[Tensor, " points"]:
    share = ((values - ends[0]) / (ends[1] - ends[0])).clamp(0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def directions_around(
    normal: Float[Tensor, "points 3"], num_directions: int, generator: torch.Generator
) -> Float[Tensor, "points directions 3"]:
    """Return unit directions above the surface, about as dense as the cosine to its normal."""
    shape = (len(normal), num_directions, 3)
    free = draw_normal(shape, generator, normal.device, normal.dtype)
    free = torch.nn.functional.normalize(free, dim=-1)
    # Slightly more than the unit sphere that rests on the surface, so that none lies in it.
    return torch.nn.functional.normalize(free + 1.05 * normal.detach()[:, None], dim=-1)
