"""Directions of incoming light, drawn by multiple importance sampling.

Each direction comes from the mixture of three strategies (environment, cosine, GGX) and is weighted by
one over the mixture's density: the balance heuristic. Half of the directions go to the environment, the
rest is shared between the lobes by their reflectance. Source: Veach, balance heuristic; supplement 2.7.
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
from lambent_relight.light_sampling import LightSampler

LIGHT_SHARE = 0.5
"""Share of the directions drawn from the environment."""


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


@dataclass(frozen=True)
class LightDirections:
    """One direction per point, with what light from there contributes."""

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
    """Return the probability of the environment, cosine and GGX strategies, [point, 3], rows sum to one."""
    albedo = (materials.albedo @ np.full((3, 1), 1 / 3, materials.albedo.dtype))[:, 0]
    metalness = materials.metalness[:, 0]
    specular = metalness * albedo + (1.0 - metalness) * DIELECTRIC_F0
    diffuse = (1.0 - metalness) * albedo
    share = np.clip(specular / np.maximum(specular + diffuse, 1e-6), 0.1, 0.95)
    rest = np.float32(1.0 - LIGHT_SHARE)
    light = np.full_like(share, LIGHT_SHARE)
    return np.stack([light, rest * (1.0 - share), rest * share], axis=-1)


def mixture_pdf(omega_i: Array, points: SurfacePoints, light: LightSampler) -> Array:
    """Return the density of `draw_directions` at `omega_i`, 1/sr, [point, 1]."""
    half = half_vector(points.omega_o, omega_i, points.normal)
    shares = strategy_shares(points.materials)
    return (
        shares[:, 0:1] * light.pdf(omega_i)
        + shares[:, 1:2] * cosine_pdf(omega_i, points.normal)
        + shares[:, 2:3] * ggx_pdf(half, points.materials.alpha)
    )


def draw_directions(points: SurfacePoints, light: LightSampler, u: NDArray[np.floating]) -> LightDirections:
    """Return one direction per point from uniforms `u` [point, 3]; the first chooses the strategy.

    Directions below the surface are kept, with weight zero.
    """
    shares = strategy_shares(points.materials)
    ends = np.cumsum(shares, axis=-1)
    from_light = u[:, 0] < ends[:, 0]
    from_ggx = u[:, 0] >= ends[:, 1]
    from_cosine = ~(from_light | from_ggx)
    omega_i = np.empty_like(points.normal)
    omega_i[from_light] = light.sample(u[from_light, 1], u[from_light, 2])
    chosen = np.flatnonzero(from_cosine)
    omega_i[chosen] = cosine_sample(u[chosen, 1], u[chosen, 2], points.normal[chosen])
    chosen = np.flatnonzero(from_ggx)
    omega_i[chosen] = ggx_sample(
        u[chosen, 1],
        u[chosen, 2],
        points.omega_o[chosen],
        points.normal[chosen],
        points.materials.alpha[chosen],
    )
    pdf = mixture_pdf(omega_i, points, light)
    diffuse_cos, specular_cos = brdf_cos(points.omega_o, omega_i, points.normal, points.materials)
    above = (dot(points.normal, omega_i) > 0.0) & (pdf > 0.0)
    scale = np.where(above, 1.0 / np.maximum(pdf, 1e-20), 0.0).astype(np.float32)
    return LightDirections(
        omega_i, diffuse_cos * scale, specular_cos * scale, pdf, np.flatnonzero(above[:, 0])
    )
