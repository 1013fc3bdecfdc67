"""Directions of incoming light, drawn by multiple importance sampling.

Each direction comes from one of four strategies: light times the cosine, the cosine alone, the GGX lobe
alone, light times the mirror lobe. It is weighted by one over the density of their mixture: the balance
heuristic. The strategies that ignore the light sample the reflections of other surfaces. Source: Veach,
balance heuristic; supplement 2.7 (diffuse and specular halves).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent_relight.brdf import (
    DIELECTRIC_F0,
    Materials,
    brdf_cos,
    cosine_pdf,
    cosine_sample,
    ggx_pdf,
    ggx_sample,
    half_vector,
)
from lambent_relight.directions import Array, dot
from lambent_relight.environment.light_sampling import COSINE_LOBE, LightSampler, lobe_of_alpha

LIGHT_SHARE = 0.6
"""Share of each lobe's directions that is drawn in proportion to the light as well."""


@dataclass(frozen=True)
class SurfacePoints:
    """Points that reflect light towards `omega_o`."""

    position: Array
    normal: Array
    omega_o: Array
    materials: Materials

    def __getitem__(self, index: object) -> "SurfacePoints":
        """Return some of the points."""
        return SurfacePoints(
            self.position[index], self.normal[index], self.omega_o[index], self.materials[index]
        )

    def repeat(self, count: int) -> "SurfacePoints":
        """Return every point `count` times in a row."""
        return self[np.repeat(np.arange(len(self.position)), count)]

    def mirror(self) -> Array:
        """Return the directions of mirror reflection, [point, 3]."""
        return 2.0 * dot(self.normal, self.omega_o) * self.normal - self.omega_o


@dataclass(frozen=True)
class LightDirections:
    """One direction per point, with the weight of light from there."""

    omega_i: Array
    diffuse: Array
    """Diffuse BRDF times cosine over density, [point, 3]; times radiance it is an unbiased estimate."""
    specular: Array
    pdf_solid_angle: Array
    """Density of the mixture, 1/sr, [point, 1]."""
    active: NDArray[np.intp]
    """Indices of the directions above the surface; all others contribute nothing."""

    @property
    def weight(self) -> Array:
        """Both lobes together, [point, 3]."""
        return self.diffuse + self.specular


def strategy_shares(materials: Materials) -> NDArray[np.float32]:
    """Return the probability of every strategy, [point, 4], rows sum to one.

    The lobes share the directions by their reflectance, with a tenth at least for the specular one.
    """
    albedo = (materials.albedo @ np.full((3, 1), 1 / 3, materials.albedo.dtype))[:, 0]
    metalness = materials.metalness[:, 0]
    specular = metalness * albedo + (1.0 - metalness) * DIELECTRIC_F0
    diffuse = (1.0 - metalness) * albedo
    share = np.clip(specular / np.maximum(specular + diffuse, 1e-6), 0.1, 0.95)
    lit, unlit = np.float32(LIGHT_SHARE), np.float32(1.0 - LIGHT_SHARE)
    return np.stack([lit * (1.0 - share), unlit * (1.0 - share), unlit * share, lit * share], axis=-1)


def whole_shares(shares: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """Return `shares` [point, 4] rounded so that `count` directions of a point divide without rest.

    A fixed number of directions for every strategy has less variance than a random one. Of three or more,
    at least one goes to a strategy that reaches every direction; fewer are left to chance.
    """
    if count < 3:
        return shares
    ends = np.round(np.cumsum(shares, axis=-1) * count)
    return (np.diff(ends, axis=-1, prepend=0.0) / count).astype(np.float32)


def mixture_pdf(
    omega_i: Array, points: SurfacePoints, light: LightSampler, shares: NDArray[np.float32]
) -> Array:
    """Return the density of `draw_directions` at `omega_i`, 1/sr, [point, 1]."""
    half = half_vector(points.omega_o, omega_i, points.normal)
    lobes = [(points.normal, COSINE_LOBE), (points.mirror(), lobe_of_alpha(points.materials.alpha))]
    lit_cosine, lit_mirror = light.pdfs(omega_i, lobes)
    return (
        shares[:, 0:1] * lit_cosine
        + shares[:, 1:2] * cosine_pdf(omega_i, points.normal)
        + shares[:, 2:3] * ggx_pdf(half, points.materials.alpha)
        + shares[:, 3:4] * lit_mirror
    )


def draw_directions(
    points: SurfacePoints, light: LightSampler, u: NDArray[np.floating], shares: NDArray[np.float32]
) -> LightDirections:
    """Return one direction per point from uniforms `u` [point, 3].

    The first uniform chooses the strategy, by `shares` [point, 4] (see `strategy_shares`).
    Directions below the surface are kept, with weight zero.
    """
    ends = np.cumsum(shares, axis=-1)
    strategy = (u[:, :1] >= ends[:, :3]).sum(axis=-1)
    omega_i = np.empty_like(points.normal)
    samplers = (
        lambda p, a, b: light.sample(a, b, p.normal, COSINE_LOBE),
        lambda p, a, b: cosine_sample(a, b, p.normal),
        lambda p, a, b: ggx_sample(a, b, p.omega_o, p.normal, p.materials.alpha),
        lambda p, a, b: light.sample(a, b, p.mirror(), lobe_of_alpha(p.materials.alpha)),
    )
    for index, sampler in enumerate(samplers):
        chosen = np.flatnonzero(strategy == index)
        omega_i[chosen] = sampler(points[chosen], u[chosen, 1], u[chosen, 2])
    pdf = mixture_pdf(omega_i, points, light, shares)
    diffuse_cos, specular_cos = brdf_cos(points.omega_o, omega_i, points.normal, points.materials)
    above = (dot(points.normal, omega_i) > 0.0) & (pdf > 0.0)
    scale = np.where(above, 1.0 / np.maximum(pdf, 1e-20), 0.0).astype(np.float32)
    return LightDirections(
        omega_i, diffuse_cos * scale, specular_cos * scale, pdf, np.flatnonzero(above[:, 0])
    )
