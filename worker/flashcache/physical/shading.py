"""Points to be shaded, the directions drawn at them, and the sum over directions that shades them.

`lights` counts the directions of one point: the diffuse half, then the specular half; within each first the
exact directions (that the NeRF cache answers), then the fast ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from flashcache.geometry.directions import dot
from flashcache.gradients import scale_gradient
from flashcache.physical.brdf import Materials, diffuse_albedo, lambert_cos, specular_brdf_cos
from flashcache.physical.incident import Incident, NearField, RayLimits, SecondaryRays
from flashcache.physical.sampling import DirectionSamples, Strategy, draw_directions

CONTRIBUTION_MAXIMUM = 1e4
"""Bound on radiance times reflectance times cosine of one direction."""


class ShadingPoints(NamedTuple):
    """Surface points to be shaded; world space, scene units."""

    positions: Float[Tensor, "points 3"]
    normal: Float[Tensor, "points 3"]
    omega_o: Float[Tensor, "points 3"]
    """Unit, towards the viewer."""
    light_index: Int[Tensor, " points"]


@dataclass(frozen=True)
class ExactDirections:
    """The directions that the NeRF cache answered: what trains the fast cache and the light sampler.

    `lights` are all exact directions of a point, the diffuse half first; `rays` are those of them above the
    surface.
    """

    omega_i: Float[Tensor, "points lights 3"]
    pdf_solid_angle: Float[Tensor, "points lights"]
    mis_weight: Float[Tensor, "points lights"]
    above: Bool[Tensor, "points lights"]
    """Whether the direction is above the surface; rays exist only for these, in this (row-major) order."""
    num_diffuse: int
    radiance: Float[Tensor, "points lights 3"]
    """What the NeRF cache and the environment send, detached; zero below the surface."""
    rays: SecondaryRays
    point_index: Int[Tensor, " rays"]
    nerf: Incident
    fast: Incident | None
    """The fast cache's answer with gradients for its own loss; None without control variate."""

    @property
    def from_diffuse(self) -> Bool[Tensor, " rays"]:
        """Return whether each of `rays` belongs to the diffuse half."""
        return self.above.nonzero()[:, 1] < self.num_diffuse


class Estimate(NamedTuple):
    """Reflected radiance at each point, linear, split as the caches' heads are."""

    rgb: Float[Tensor, "points 3"]
    diffuse: Float[Tensor, "points 3"]
    specular: Float[Tensor, "points 3"]
    irradiance: Float[Tensor, "points 3"]
    """Irradiance / pi: what a white diffuse surface would reflect."""
    variance: Float[Tensor, "points 3"] | None
    """Estimated variance of `rgb` (of its mean, not of one direction); None unless asked for."""
    exact: ExactDirections | None

    @property
    def standard_error(self) -> Float[Tensor, "points 3"]:
        """Return the standard error of `rgb`."""
        assert self.variance is not None, "estimate with with_variance=True"
        return self.variance.sqrt()


@dataclass(frozen=True)
class DrawnDirections:
    """The directions of a batch of points, and the rays along those that are above the surface."""

    points: ShadingPoints
    halves: tuple[DirectionSamples, DirectionSamples]
    omega_i: Tensor
    above: Tensor
    """Whether a direction is above the surface: only these are traced."""
    is_exact: Tensor
    index: Tensor
    """Flat positions (point * lights + light) of the directions that are traced, exact ones first."""
    num_exact_rays: int
    rays: SecondaryRays

    @staticmethod
    def draw(
        points: ShadingPoints,
        diffuse: Sequence[tuple[Strategy, Sequence[int]]],
        specular: Sequence[tuple[Strategy, Sequence[int]]],
        stratified: bool,
        limits: RayLimits,
        generator: torch.Generator,
    ) -> "DrawnDirections":
        """Return fresh directions; each strategy comes with its numbers of exact and fast directions.

        A single number per strategy makes all directions exact.
        """
        with torch.no_grad():
            like = points.positions
            halves = tuple(
                draw_directions(half, generator, like, stratified=stratified) for half in (diffuse, specular)
            )
            omega_i = torch.cat([half.omega_i for half in halves], dim=1)
            above = dot(points.normal.unsqueeze(1), omega_i).squeeze(-1) > 0.0
            flags = []
            for half in (diffuse, specular):
                exact = sum(counts[0] for _, counts in half)
                everything = sum(sum(counts) for _, counts in half)
                flags += [True] * exact + [False] * (everything - exact)
            is_exact = torch.tensor(flags, dtype=torch.bool, device=like.device)
            first = (above & is_exact).reshape(-1).nonzero().squeeze(-1)
            second = (above & ~is_exact).reshape(-1).nonzero().squeeze(-1)
            index = torch.cat([first, second])
            owner = index.div(omega_i.shape[1], rounding_mode="floor")
            origins = points.positions + limits.origin_offset * points.normal
            rays = SecondaryRays(
                origins=origins[owner],
                directions=omega_i.reshape(-1, 3)[index],
                near=limits.near,
                far=limits.far,
                light_index=points.light_index[owner],
            )
        return DrawnDirections(points, halves, omega_i, above, is_exact, index, len(first), rays)

    def scatter(self, values: Tensor) -> Tensor:
        """Return [points, lights, 3] of values per ray, zero where no ray was traced."""
        flat = values.new_zeros((self.above.numel(), values.shape[-1]))
        return flat.index_copy(0, self.index, values).reshape(*self.above.shape, values.shape[-1])

    def integrate(
        self, radiance: Tensor, materials: Materials, normal_gradient: float, with_variance: bool
    ) -> Estimate:
        """Return the estimate, given the [points, lights, 3] radiance with which each direction counts."""
        num_diffuse = self.halves[0].omega_i.shape[1]
        normal = scale_gradient(self.points.normal, normal_gradient).unsqueeze(1)
        omega_d, omega_s = self.omega_i.split([num_diffuse, self.omega_i.shape[1] - num_diffuse], dim=1)
        cosine = lambert_cos(omega_d, normal)
        specular_cos = specular_brdf_cos(
            self.points.omega_o.unsqueeze(1), omega_s, normal, materials.per_direction()
        )
        terms = torch.cat([radiance[:, :num_diffuse] * cosine, radiance[:, num_diffuse:] * specular_cos], 1)
        clean = torch.nan_to_num(terms, nan=0.0).clamp(-CONTRIBUTION_MAXIMUM, CONTRIBUTION_MAXIMUM)
        weight = torch.cat([half.weight for half in self.halves], dim=1).unsqueeze(-1)
        weighted = clean * weight
        irradiance = weighted[:, :num_diffuse].sum(dim=1)
        specular = weighted[:, num_diffuse:].sum(dim=1)
        white = diffuse_albedo(materials)
        diffuse = white * irradiance
        variance = None
        if with_variance:
            with torch.no_grad():
                variance = white.square() * _variance(weighted[:, :num_diffuse], self.halves[0].groups)
                variance = variance + _variance(weighted[:, num_diffuse:], self.halves[1].groups)
        return Estimate(diffuse + specular, diffuse, specular, irradiance, variance, None)

    def exact(self, nerf: NearField, fast: NearField | None, environment: Tensor) -> "ExactDirections":
        """Return what the losses of the fast cache and the light sampler need, given the answers."""
        num_diffuse = self.halves[0].omega_i.shape[1]
        columns = self.is_exact.nonzero().squeeze(-1)
        rays, _ = self.rays.split(self.num_exact_rays)
        index = self.index[: self.num_exact_rays]
        sky = environment[: self.num_exact_rays].detach()
        answer = Incident(nerf.near_radiance, nerf.opacity, nerf.distance, sky)
        known = None if fast is None else Incident(fast.near_radiance, fast.opacity, fast.distance, sky)
        dense = sky.new_zeros((self.above.numel(), 3)).index_copy(0, index, answer.radiance.detach())
        return ExactDirections(
            omega_i=self.omega_i[:, columns],
            pdf_solid_angle=torch.cat([half.pdf_solid_angle for half in self.halves], dim=1)[:, columns],
            mis_weight=torch.cat([half.mis_weight for half in self.halves], dim=1)[:, columns],
            above=self.above[:, columns],
            num_diffuse=int(self.is_exact[:num_diffuse].sum()),
            radiance=dense.reshape(*self.above.shape, 3)[:, columns],
            rays=rays,
            point_index=index.div(self.above.shape[1], rounding_mode="floor"),
            nerf=answer,
            fast=known,
        )


def _variance(weighted: Tensor, groups: tuple[int, ...]) -> Tensor:
    """Return the variance of the sum over all directions, from the scatter inside each strategy's group.

    With stratified variates this is an upper estimate. A group of one direction cannot tell and counts its
    square.
    """
    variance = torch.zeros_like(weighted[:, 0])
    for part in weighted.split(groups, dim=1):
        count = part.shape[1]
        spread = part.var(dim=1) if count > 1 else part[:, 0].square()
        variance = variance + count * spread
    return variance
