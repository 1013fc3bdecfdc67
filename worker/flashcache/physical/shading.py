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

from flashcache.fields.mlp import scale_gradient
from flashcache.geometry.directions import dot
from flashcache.physical.brdf import Materials, diffuse_albedo, lambert_cos, specular_brdf_cos
from flashcache.physical.incident import Incident, NearField, RayLimits, SecondaryRays
from flashcache.physical.sampling import DirectionSamples, Strategy, draw_directions
from flashcache.rows import Rows, shapes_are_fixed

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
    """Whether the direction is above the surface; only these have rays, in this (row-major) order, or, with
    fixed shapes, only their rays are counted."""
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
        light = torch.arange(self.above.shape[1], device=self.above.device).expand_as(self.above)
        return Rows.where(self.above.reshape(-1)).of(light.reshape(-1)) < self.num_diffuse


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
    num_exact: tuple[int, int]
    """Exact directions of a point in either half; they come first in it."""
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
        which: Bool[Tensor, " points"] | None = None,
        *,
        continued: bool = False,
    ) -> "DrawnDirections":
        """Return fresh directions; each strategy comes with its numbers of exact and fast directions.

        A single number per strategy makes all directions exact. Rays of points outside of `which` are not
        counted, or not traced. `continued`: see `draw_uniforms`.
        """
        with torch.no_grad():
            like = points.positions
            first, second = (
                draw_directions(half, generator, like, stratified=stratified, continued=continued)
                for half in (diffuse, specular)
            )
            halves = (first, second)
            omega_i = torch.cat([half.omega_i for half in halves], dim=1)
            above = dot(points.normal.unsqueeze(1), omega_i).squeeze(-1) > 0.0
            num_exact = (sum(counts[0] for _, counts in diffuse), sum(counts[0] for _, counts in specular))
            position = torch.arange(above.numel(), device=like.device).reshape(above.shape)
            counted = above if which is None else above & which[:, None]
            parts, flags = [], []
            for own in _exact_and_fast(halves[0].omega_i.shape[1], num_exact):
                flag = torch.cat([counted[:, some] for some in own], dim=1).reshape(-1)
                rows = Rows.where(flag)
                parts.append(rows.of(torch.cat([position[:, some] for some in own], dim=1).reshape(-1)))
                flags.append(rows.counted)
            index = torch.cat(parts)
            known = [flag for flag in flags if flag is not None]
            owner = index.div(omega_i.shape[1], rounding_mode="floor")
            origins = points.positions + limits.origin_offset * points.normal
            rays = SecondaryRays(
                origins=origins[owner],
                directions=omega_i.reshape(-1, 3)[index],
                near=limits.near,
                far=limits.far,
                light_index=points.light_index[owner],
                counted=torch.cat(known) if shapes_are_fixed() else None,
                num_points=len(like),
            )
        return DrawnDirections(points, halves, omega_i, above, num_exact, index, len(parts[0]), rays)

    def scatter(self, values: Tensor) -> Tensor:
        """Return [points, lights, 3] of values per ray, zero where no ray was traced."""
        flat = values.new_zeros((self.above.numel(), values.shape[-1]))
        return flat.index_copy(0, self.index, self.rays.masked(values)).reshape(
            *self.above.shape, values.shape[-1]
        )

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

    def integrate_together(self, radiance: Tensor, materials: Materials) -> Estimate:
        """Return the estimate in which every direction counts for both lobes; no gradients.

        All directions are in the diffuse half, and their densities are those of one integral over both lobes:
        where lobes share directions, half as many rays carry the same.
        """
        normal, (drawn, _) = self.points.normal.unsqueeze(1), self.halves
        cosine = lambert_cos(self.omega_i, normal)
        lobe = specular_brdf_cos(
            self.points.omega_o.unsqueeze(1), self.omega_i, normal, materials.per_direction()
        )

        def weighted(reflected: Tensor) -> Tensor:
            terms = torch.nan_to_num(radiance * reflected, nan=0.0)
            return terms.clamp(-CONTRIBUTION_MAXIMUM, CONTRIBUTION_MAXIMUM) * drawn.weight.unsqueeze(-1)

        white = diffuse_albedo(materials)
        irradiance, specular = weighted(cosine), weighted(lobe)
        variance = _variance(white.unsqueeze(1) * irradiance + specular, drawn.groups)
        total, sent = irradiance.sum(dim=1), specular.sum(dim=1)
        return Estimate(white * total + sent, white * total, sent, total, variance, None)

    def exact(self, nerf: NearField, fast: NearField | None, environment: Tensor) -> "ExactDirections":
        """Return what the losses of the fast cache and the light sampler need, given the answers."""
        num_diffuse = self.halves[0].omega_i.shape[1]
        exact, _ = _exact_and_fast(num_diffuse, self.num_exact)
        rays, _ = self.rays.split(self.num_exact_rays)
        index = self.index[: self.num_exact_rays]
        sky = environment[: self.num_exact_rays].detach()
        answer = Incident(nerf.near_radiance, nerf.opacity, nerf.distance, sky)
        known = None if fast is None else Incident(fast.near_radiance, fast.opacity, fast.distance, sky)
        dense = sky.new_zeros((self.above.numel(), 3))
        dense = dense.index_copy(0, index, rays.masked(answer.radiance.detach()))

        def of_exact(values: Tensor) -> Tensor:
            return torch.cat([values[:, some] for some in exact], dim=1)

        return ExactDirections(
            omega_i=of_exact(self.omega_i),
            pdf_solid_angle=of_exact(torch.cat([half.pdf_solid_angle for half in self.halves], dim=1)),
            mis_weight=of_exact(torch.cat([half.mis_weight for half in self.halves], dim=1)),
            above=of_exact(self.above),
            num_diffuse=self.num_exact[0],
            radiance=of_exact(dense.reshape(*self.above.shape, 3)),
            rays=rays,
            point_index=index.div(self.above.shape[1], rounding_mode="floor"),
            nerf=answer,
            fast=known,
        )


def _exact_and_fast(
    num_diffuse: int, num_exact: tuple[int, int]
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the exact and the fast directions of a point, in the diffuse and in the specular half."""
    diffuse, specular = num_exact
    exact = slice(0, diffuse), slice(num_diffuse, num_diffuse + specular)
    return exact, (slice(diffuse, num_diffuse), slice(num_diffuse + specular, None))


def _variance(weighted: Tensor, groups: tuple[int, ...]) -> Tensor:
    """Return the variance of the sum over all directions, from the scatter inside each strategy's group.

    With stratified variates this is an upper estimate. A group of one direction cannot tell and counts its
    square.
    """
    variance = torch.zeros_like(weighted[:, 0])
    if not len(weighted):
        return variance
    for part in weighted.split(groups, dim=1):
        count = part.shape[1]
        spread = part.var(dim=1) if count > 1 else part[:, 0].square()
        variance = variance + count * spread
    return variance
