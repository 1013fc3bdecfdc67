"""Directions of incoming light, drawn by multiple importance sampling.

Each direction comes from one of four strategies: light times the cosine, the cosine alone, the GGX lobe
alone, light times the mirror lobe. It is weighted by one over the density of their mixture: the balance
heuristic. The strategies that ignore the light sample the reflections of other surfaces. Source: Veach,
balance heuristic; supplement 2.7 (diffuse and specular halves).
"""

from dataclasses import dataclass

import numpy as np
from lambent_core.directions import Array, dot
from numpy.typing import NDArray

from lambent_relight.brdf import Materials, RowIndex, base_reflectance, schlick_weight
from lambent_relight.environment.light_sampling import COSINE_LOBE, LightSampler, lobe_of_alpha

DIFFUSE_LIGHT_SHARE = 0.9
"""Share of the diffuse lobe's directions that is drawn in proportion to the light as well."""
SPECULAR_LIGHT_SHARE = 0.4
"""The same of the specular lobe, whose own density is the better guide the narrower it is."""
WIDE_LOBES_GRAZE_LESS = 3.0
"""Found by experiment, as both shares are: docs/benchmarks/asset.md."""


@dataclass(frozen=True)
class SurfacePoints:
    """Points that reflect light towards `omega_o`."""

    position: Array
    normal: Array
    omega_o: Array
    materials: Materials

    def __getitem__(self, index: RowIndex) -> "SurfacePoints":
        """Return some of the points."""
        return SurfacePoints(
            self.position[index], self.normal[index], self.omega_o[index], self.materials[index]
        )


@dataclass(frozen=True)
class LightDirections:
    """One direction per point, with the weight of light from there."""

    omega_i: Array
    diffuse: Array
    """Diffuse BRDF times cosine over density, [point, 3]; times radiance it is an unbiased estimate."""
    specular: Array
    pdf_solid_angle: Array
    """Density of the mixture, 1/sr, [point, 1]; zero below the surface."""
    active: NDArray[np.intp]
    """Indices of the directions above the surface; all others contribute nothing."""

    @property
    def weight(self) -> Array:
        """Both lobes together, [point, 3]."""
        return self.diffuse + self.specular


def strategy_shares(points: SurfacePoints, light: LightSampler) -> NDArray[np.float32]:
    """Return the probability of every strategy, [point, 4], rows sum to one.

    The lobes share the directions by what they reflect of `light` if nothing is in its way: reflectance times
    the light's mean under the lobe. The specular one has a tenth at least, and 0.95 at most.
    """
    materials, normal = points.materials, points.normal
    cosine = dot(normal, points.omega_o)
    albedo = materials.albedo.mean(axis=-1, keepdims=True)
    f0 = base_reflectance(albedo, materials.metalness)
    # Schlick's term at the mirror direction, less for wide lobes, which have few microfacets at that angle.
    grazing = schlick_weight(cosine) / (1.0 + WIDE_LOBES_GRAZE_LESS * materials.alpha)
    reflected = (cosine > 0.0) * (f0 + (1.0 - f0) * grazing)
    specular = reflected[:, 0] * light.mean(
        2.0 * cosine * normal - points.omega_o, lobe_of_alpha(materials.alpha)
    )
    diffuse = ((1.0 - materials.metalness) * albedo)[:, 0] * light.mean(normal, COSINE_LOBE)
    share = np.clip(specular / np.maximum(specular + diffuse, 1e-9), 0.1, 0.95)
    diffuse_lit, specular_lit = DIFFUSE_LIGHT_SHARE, SPECULAR_LIGHT_SHARE
    return np.stack(
        [
            diffuse_lit * (1.0 - share),
            (1.0 - diffuse_lit) * (1.0 - share),
            (1.0 - specular_lit) * share,
            specular_lit * share,
        ],
        axis=-1,
    ).astype(np.float32)


def draw_directions(
    points: SurfacePoints, light: LightSampler, u: NDArray[np.floating], shares: NDArray[np.float32]
) -> LightDirections:
    """Return directions from uniforms `u` [ray, 3]; rays divide evenly among the points, in their order.

    The first uniform chooses the strategy, by `shares` [point, 4] (see `strategy_shares`).
    Directions below the surface are kept, with weight zero.
    """
    # Compiled code takes a second to import, which programs that only look at bundles do not pay.
    from lambent_relight.refined import scattering_kernels as kernels

    materials = points.materials
    surface = kernels.Points(
        normal=np.ascontiguousarray(points.normal, np.float64),
        omega_o=np.ascontiguousarray(points.omega_o, np.float64),
        albedo=np.ascontiguousarray(materials.albedo, np.float64),
        alpha=np.ascontiguousarray(materials.alpha[:, 0], np.float64),
        metalness=np.ascontiguousarray(materials.metalness[:, 0], np.float64),
        lobe=lobe_of_alpha(materials.alpha),
    )
    omega_i, diffuse, specular = np.empty((3, len(u), 3), np.float32)
    pdf = np.empty(len(u))
    uniforms = np.ascontiguousarray(u, np.float64)
    chances = np.ascontiguousarray(shares, np.float64)
    kernels.draw(surface, light.table, uniforms, chances, omega_i, diffuse, specular, pdf)
    return LightDirections(omega_i, diffuse, specular, pdf[:, None], np.flatnonzero(pdf > 0.0))
