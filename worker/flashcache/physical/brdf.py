"""The reflectance model: a Lambertian lobe and a GGX lobe (paper, supplement Eqs. 3-5).

Directions point away from the surface. `_cos` in a name means that the cosine at the light, n.omega_i, is a
factor.
"""

import math

from jaxtyping import Float
from torch import Tensor

from flashcache.fields.materials import Materials
from flashcache.geometry.directions import dot

DIELECTRIC_F0 = 0.04
"""Reflectance of a dielectric at normal incidence."""


def diffuse_albedo(materials: Materials) -> Float[Tensor, "*batch 3"]:
    """Return the share of irradiance that the diffuse lobe reflects, (1 - metalness) albedo."""
    return (1.0 - materials.metalness) * materials.albedo


def ggx_density(
    normal: Float[Tensor, "*#batch 3"], omega_h: Float[Tensor, "*#batch 3"], alpha: Float[Tensor, "*#batch 1"]
) -> Float[Tensor, "*batch 1"]:
    """Return the Trowbridge-Reitz density D of half vectors, in 1/sr; the integral of D (n.h) is one.

    Even in `omega_h`. Source: supplement 2.6. The sine comes from the component across the normal, because
    1 - (n.h)^2 has no correct digits left in float32 once alpha is below 0.001.
    """
    cosine = dot(normal, omega_h)
    across = omega_h - cosine * normal
    width = alpha * alpha
    # The bound is below every value that two unit vectors give, and keeps opposite directions finite.
    denominator = (dot(across, across) + width * (cosine * cosine)).clamp_min(1e-10)
    return width / (math.pi * denominator * denominator)


def lambert_cos(
    omega_i: Float[Tensor, "*#batch 3"], normal: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*batch 1"]:
    """Return the reflectance of a white diffuse surface times the cosine, in 1/sr; zero below the surface."""
    return dot(normal, omega_i).clamp_min(0.0) / math.pi


def diffuse_brdf_cos(
    omega_i: Float[Tensor, "*#batch 3"], normal: Float[Tensor, "*#batch 3"], materials: Materials
) -> Float[Tensor, "*batch 3"]:
    """Return the diffuse lobe times the cosine, in 1/sr; zero below the surface.

    Source: supplement Eq. 4; (1 - metalness) albedo / pi, not attenuated by Fresnel reflection.
    """
    return diffuse_albedo(materials) * lambert_cos(omega_i, normal)


def specular_brdf_cos(
    omega_o: Float[Tensor, "*#batch 3"],
    omega_i: Float[Tensor, "*#batch 3"],
    normal: Float[Tensor, "*#batch 3"],
    materials: Materials,
) -> Float[Tensor, "*batch 3"]:
    """Return the specular lobe times the cosine, D F G / (4 n.omega_o), in 1/sr.

    Zero when either direction is below the surface. F is Schlick's, G is Smith's product of Schlick-GGX terms
    with k = alpha / 2. The cosine at the viewer cancels against G and never divides.
    Source: supplement Eq. 5.
    """
    total = omega_i + omega_o
    omega_h = total * dot(total, total).clamp_min(1e-20).rsqrt()
    cos_i = dot(normal, omega_i).clamp_min(0.0)
    cos_o = dot(normal, omega_o)
    grazing = (1.0 - dot(omega_i, omega_h)).clamp(0.0, 1.0)
    f0 = DIELECTRIC_F0 + (materials.albedo - DIELECTRIC_F0) * materials.metalness
    squared = grazing * grazing
    fresnel = f0 + (1.0 - f0) * (squared * squared * grazing)
    k = 0.5 * materials.alpha
    towards_light = cos_i / (cos_i * (1.0 - k) + k)
    towards_eye = (cos_o > 0.0) / (4.0 * (cos_o.clamp_min(0.0) * (1.0 - k) + k))
    return fresnel * (ggx_density(normal, omega_h, materials.alpha) * towards_light * towards_eye)


def brdf_cos(
    omega_o: Float[Tensor, "*#batch 3"],
    omega_i: Float[Tensor, "*#batch 3"],
    normal: Float[Tensor, "*#batch 3"],
    materials: Materials,
) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3"]]:
    """Return the two lobes (diffuse, specular) times the cosine at the light, in 1/sr."""
    return (
        diffuse_brdf_cos(omega_i, normal, materials),
        specular_brdf_cos(omega_o, omega_i, normal, materials),
    )
