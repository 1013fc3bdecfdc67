"""Incoming light at surface points: secondary rays, and the answers of radiance caches to them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from flashcache.errors import ConfigError


@dataclass(frozen=True, kw_only=True, slots=True)
class RayLimits:
    """The limits of secondary rays, in scene units; a property of the scene."""

    near: float
    """Distance from the origin at which a ray begins to see."""
    far: float
    """Distance beyond which there is only the environment."""
    origin_offset: float = 0.01
    """Distance of origins from the surface, along the normal (authors' code: 0.01)."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.near < self.far:
            raise ConfigError(f"secondary rays need 0 <= near < far, got near {self.near} and far {self.far}")


@dataclass(frozen=True)
class SecondaryRays:
    """Rays that gather incoming light, from just above surface points; distances in scene units."""

    origins: Float[Tensor, "rays 3"]
    directions: Float[Tensor, "rays 3"]
    """Unit, away from the surface."""
    near: float
    far: float
    light_index: Int[Tensor, " rays"]
    counted: Bool[Tensor, " rays"] | None = None
    """Which rays count, where shapes are fixed (`flashcache.rows`); None: all."""
    num_points: int = 0
    """Points from which they leave, with fixed shapes equally many from each, one after the other; 0: any."""

    def __len__(self) -> int:
        """Return the number of rays."""
        return self.origins.shape[0]

    def split(self, first: int) -> tuple["SecondaryRays", "SecondaryRays"]:
        """Return the first `first` rays and the others."""
        head, tail = slice(None, first), slice(first, None)
        return self._part(head), self._part(tail)

    def masked(self, values: Float[Tensor, "rays channels"]) -> Float[Tensor, "rays channels"]:
        """Return `values` per ray, zero for rays that do not count."""
        if self.counted is None:
            return values
        return torch.where(self.counted[:, None], values, torch.zeros_like(values))

    def _part(self, part: slice) -> "SecondaryRays":
        return replace(
            self,
            origins=self.origins[part],
            directions=self.directions[part],
            light_index=self.light_index[part],
            counted=None if self.counted is None else self.counted[part],
        )


@runtime_checkable
class NearField(Protocol):
    """A cache's answers for secondary rays; see `Incident` for the meaning."""

    @property
    def near_radiance(self) -> Tensor: ...
    @property
    def opacity(self) -> Tensor: ...
    @property
    def distance(self) -> Tensor: ...


@dataclass(frozen=True)
class Incident:
    """Light along secondary rays: a cache's answer, and the environment behind it."""

    near_radiance: Float[Tensor, "rays 3"]
    """Linear radiance between the ends of the ray, premultiplied by `opacity`."""
    opacity: Float[Tensor, " rays"]
    """Share of the environment that is hidden, 0..1; it is geometry and does not depend on the light."""
    distance: Float[Tensor, " rays"]
    """Mean distance of what hides it, from the ray's origin."""
    environment: Float[Tensor, "rays 3"] | None = None
    """Radiance of the far field; sources omit it, and the estimator evaluates it once."""

    @property
    def radiance(self) -> Float[Tensor, "rays 3"]:
        """Return near radiance plus what the environment sends past it (paper Eq. 3)."""
        assert self.environment is not None, "the estimator fills in the environment"
        return self.near_radiance + (1.0 - self.opacity).unsqueeze(-1) * self.environment


RadianceSource = Callable[[SecondaryRays], NearField]
"""A cache, as the estimators see it: near radiance [rays, 3], opacity and distance [rays]."""

EnvironmentSource = Callable[[Tensor, Tensor], Tensor]
"""Far-field radiance [rays, 3] of unit directions [rays, 3] under the lights [rays]."""


@dataclass(frozen=True)
class LightSources:
    """What sends light to surface points, and the limits of the rays that gather it."""

    near: RadianceSource
    """The near field: a cache, or what a new light makes of one."""
    environment: EnvironmentSource
    limits: RayLimits
    fast: RadianceSource | None = None
    """A cheaper cache of the same near field, for estimates with a control variate."""


def visibility_only(source: RadianceSource) -> RadianceSource:
    """Return a source with the occlusion of `source` and no radiance: direct light with shadows."""

    def shadows(rays: SecondaryRays) -> Incident:
        answer = source(rays)
        return Incident(torch.zeros_like(answer.near_radiance), answer.opacity, answer.distance)

    return shadows
