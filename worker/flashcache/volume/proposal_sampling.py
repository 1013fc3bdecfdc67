"""Sampling along rays: two proposal rounds and a final one.

Normalised distance s in [0, 1] maps to the distance t along the ray by a `DistanceCurve`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.errors import ConfigError
from flashcache.geometry.rays import Rays
from flashcache.randomness import uniform
from flashcache.volume.quadrature import render_weights
from flashcache.volume.step_function import edges_from_centres, sample_centres

DensityFunction = Callable[[Float[Tensor, "rays samples 3"]], Float[Tensor, "rays samples"]]


@dataclass(frozen=True, kw_only=True, slots=True)
class SampleCounts:
    """Samples along a ray in the three rounds (supplement 2.2)."""

    first: int = 64
    second: int = 64
    final: int = 32

    def __post_init__(self) -> None:
        if min(self.first, self.second, self.final) < 2:
            raise ConfigError(f"sample counts must be at least 2 in every round, got {self}")


@dataclass(frozen=True, kw_only=True, slots=True)
class DistanceCurve:
    """The mapping between normalised distance and distance along a ray.

    With `power` 1 linearly, else by the power ladder, which puts more samples near the start
    (Zip-NeRF's curve as the paper uses it for secondary rays).
    """

    power: float = 1.0
    premultiplier: float = 2.0

    def ladder(self, t: Tensor) -> Tensor:
        """Return the ladder coordinate of the distance `t`, an increasing function."""
        if self.power == 1.0:
            return t
        a = abs(self.power - 1.0)
        return (a / self.power) * ((self.premultiplier * t / a + 1.0) ** self.power - 1.0)

    def inverse_ladder(self, y: Tensor) -> Tensor:
        """Return the distance whose ladder coordinate is `y`."""
        if self.power == 1.0:
            return y
        a = abs(self.power - 1.0)
        return (a / self.premultiplier) * ((self.power * y / a + 1.0) ** (1.0 / self.power) - 1.0)

    @property
    def inverse_constants(self) -> tuple[np.float32, np.float32, np.float32]:
        """Return c, b and e of `inverse_ladder` = c ((b y + 1)^e - 1), for compiled code; `power` not 1."""
        a = abs(self.power - 1.0)
        return np.float32(a / self.premultiplier), np.float32(self.power / a), np.float32(1.0 / self.power)

    def distance(self, s: Tensor, near: Tensor, far: Tensor) -> Tensor:
        """Return distances in scene units for normalised ones; `near`, `far` broadcast against `s`."""
        start, end = self.ladder(near), self.ladder(far)
        return self.inverse_ladder(start + s * (end - start))

    def normalised(self, t: Tensor, near: Tensor, far: Tensor) -> Tensor:
        """Return the normalised distance in [0, 1] of `t`, the inverse of `distance`."""
        start, end = self.ladder(near), self.ladder(far)
        return (self.ladder(t) - start) / (end - start).clamp_min(1e-9)


PRIMARY_CURVE = DistanceCurve()
SECONDARY_CURVE = DistanceCurve(power=-1.5, premultiplier=2.0)


class Round(NamedTuple):
    """One round of sampling: edges in normalised distance and the weights between them."""

    edges: Float[Tensor, "rays edges"]
    weights: Float[Tensor, "rays samples"]


class RaySamples(NamedTuple):
    """The final intervals of a batch of rays, with the proposal rounds that led to them."""

    edges: Float[Tensor, "rays edges"]
    """Normalised distance, detached."""
    distances: Float[Tensor, "rays edges"]
    """Interval edges in scene units."""
    positions: Float[Tensor, "rays samples 3"]
    """Midpoints of the final intervals, world coordinates."""
    proposals: tuple[Round, ...]


def midpoints(distances: Float[Tensor, "rays edges"]) -> Float[Tensor, "rays samples"]:
    """Return the middle of every interval."""
    return 0.5 * (distances[:, 1:] + distances[:, :-1])


def sample_rays(
    rays: Rays,
    proposals: tuple[DensityFunction, DensityFunction],
    counts: SampleCounts,
    curve: DistanceCurve,
    *,
    exponent: float | Float[Tensor, ""],
    generator: torch.Generator | None,
) -> RaySamples:
    """Return the intervals at which the final fields are to be queried.

    `exponent` in [0, 1] flattens the proposal weights before they are sampled (annealing).
    Without a `generator` the samples are deterministic, as in evaluation and for most secondary rays.
    Gradients never cross rounds. Source: supplement 2.2.
    """
    num_rays, device, dtype = len(rays), rays.origins.device, rays.origins.dtype
    near, far = rays.near[:, None], rays.far[:, None]
    # Before anything is known, all of the ray is one interval.
    edges = torch.linspace(0.0, 1.0, 2, device=device, dtype=dtype).expand(num_rays, 2)
    weights = torch.ones(num_rays, 1, device=device, dtype=dtype)
    rounds = []
    for level, num_samples in enumerate((counts.first, counts.second, counts.final)):
        # Draw the centres of the next intervals in proportion to the weights of the last ones. One jitter
        # shifts all strata of a ray, so that they stay evenly spaced.
        jitter = None
        if generator is not None:
            jitter = uniform((num_rays, 1), generator, device, dtype)
        centres = sample_centres(edges, weights.detach(), num_samples, jitter, exponent)
        # Intervals reach halfway to their neighbours; the density is looked up in their middles.
        edges = edges_from_centres(centres)
        distances = curve.distance(edges, near, far)
        positions = rays.at(midpoints(distances))
        if level == 2:  # The final fields answer for these.
            break
        weights = render_weights(proposals[level](positions), distances)
        rounds.append(Round(edges, weights))
    return RaySamples(edges, distances, positions, tuple(rounds))
