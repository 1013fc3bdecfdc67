"""The reflection model: Lambert plus GGX with Schlick's Fresnel and shadowing terms.

    f = (1 - m) albedo / pi + F D G(n.i) G(n.o) / (4 (n.i) (n.o))
    F = F0 + (1 - F0) (1 - o.h)^5                         F0 = m albedo + (1 - m) 0.04
    D = alpha^2 / (pi (cos^2 alpha^2 + sin^2)^2)          G(c) = c / (c (1 - k) + k),  k = alpha / 2

with metalness m, and cos and sin of the angle between normal and half vector h. All vectors are unit and
point away from the surface; `alpha` is the GGX width (perceptual roughness squared). Values with `_cos`
include the cosine at the light's side. `brdf_kernels` says the same for compiled loops, and
`flashcache.physical.brdf` in torch. Source: supplement Eqs. 3-5.
"""

from dataclasses import dataclass

import numpy as np
from lambent_core.directions import Array, dot, frame_axes, normalise
from numpy.typing import NDArray

DIELECTRIC_F0 = 0.04
"""Reflectance of a non-metal at normal incidence."""
MIN_ALPHA = 1e-4
"""Narrowest lobe; smaller widths are raised to it."""
FLOOR = 1.2e-7
RowIndex = slice | NDArray[np.integer] | NDArray[np.bool_]
"""Picks some rows of arrays that belong together."""


@dataclass(frozen=True)
class Materials:
    """Surface properties of a batch of points."""

    albedo: Array
    """Linear base colour in [0, 1], [*batch, 3]."""
    alpha: Array
    """GGX width in [MIN_ALPHA, 1], [*batch, 1]."""
    metalness: Array
    """0 dielectric to 1 metal, [*batch, 1]."""

    def __getitem__(self, index: RowIndex) -> "Materials":
        """Return the same properties of some of the points."""
        return Materials(self.albedo[index], self.alpha[index], self.metalness[index])


def materials_from_roughness(albedo: Array, perceptual_roughness: Array, metalness: Array) -> Materials:
    """Return materials from the values that files carry; the one place where roughness becomes `alpha`."""
    alpha = np.clip(perceptual_roughness, 0.0, 1.0) ** 2
    return Materials(albedo, np.maximum(alpha, MIN_ALPHA).astype(albedo.dtype), metalness)


def base_reflectance(albedo: Array, metalness: Array) -> Array:
    """Return the Fresnel reflectance at normal incidence, F0 [*batch, channel]."""
    return metalness * albedo + (1.0 - metalness) * DIELECTRIC_F0


def schlick_weight(cosine: Array) -> Array:
    """Return Schlick's (1 - cos)^5 of a cosine, which is clipped to [0, 1]."""
    return (1.0 - np.clip(cosine, 0.0, 1.0)) ** 5


def ggx_density(cosine_squared: Array, sine_squared: Array, alpha: Array) -> Array:
    """Return the Trowbridge-Reitz density D(h), 1/sr, from cos^2 and sin^2 of the angle to the normal.

    Both are taken because 1 - cos^2 loses every digit of a narrow lobe in single precision.
    """
    width = alpha * alpha
    return width / (np.pi * np.maximum(cosine_squared * width + sine_squared, FLOOR * width) ** 2)


def shadowing_divisor(cosine: Array | float, alpha: Array) -> Array:
    """Return what a cosine is divided by to give its shadowing term: G(c) = c / (c (1 - k) + k)."""
    k = 0.5 * alpha
    return np.maximum(cosine * (1.0 - k) + k, FLOOR)


@dataclass(frozen=True)
class HalfVector:
    """Half vector between viewer and light, and what the lobe needs of it."""

    n_dot_h: Array
    sine_squared: Array
    o_dot_h: Array


def half_vector(omega_o: Array, omega_i: Array, normal: Array) -> HalfVector:
    """Return the half vector's angles to the normal and the viewer, each [*batch, 1], clamped to >= 0."""
    half = normalise(omega_o + omega_i)
    across = np.cross(normal, half)
    return HalfVector(
        n_dot_h=np.maximum(dot(normal, half), 0.0),
        sine_squared=dot(across, across),
        o_dot_h=np.clip(dot(omega_o, half), 0.0, 1.0),
    )


def brdf_cos(omega_o: Array, omega_i: Array, normal: Array, materials: Materials) -> tuple[Array, Array]:
    """Return BRDF times cosine of the diffuse and of the specular lobe, each [*batch, 3], 1/sr.

    The diffuse lobe is (1 - m) albedo / pi, not attenuated by Fresnel. Both are zero where `omega_i` is
    below the surface; the specular lobe also where `omega_o` is.
    """
    half = half_vector(omega_o, omega_i, normal)
    n_dot_i = np.maximum(dot(normal, omega_i), 0.0)
    n_dot_o = np.maximum(dot(normal, omega_o), 0.0)
    diffuse_cos = (1.0 - materials.metalness) * materials.albedo * (n_dot_i / np.pi)
    f0 = base_reflectance(materials.albedo, materials.metalness)
    fresnel = f0 + (1.0 - f0) * schlick_weight(half.o_dot_h)
    density = ggx_density(half.n_dot_h**2, half.sine_squared, materials.alpha)
    shadowing = n_dot_i / shadowing_divisor(n_dot_i, materials.alpha)
    shadowing = shadowing * (n_dot_o / shadowing_divisor(n_dot_o, materials.alpha))
    specular_cos = fresnel * (density * shadowing / (4.0 * np.maximum(n_dot_o, FLOOR)))
    return diffuse_cos, specular_cos


def cosine_sample(u1: Array, u2: Array, normal: Array) -> Array:
    """Return directions [*batch, 3] with density cos / pi about `normal`, from uniforms [*batch]."""
    tangent, bitangent = frame_axes(normal)
    radius, angle = np.sqrt(u1)[..., None], (2.0 * np.pi * u2)[..., None]
    height = np.sqrt(np.maximum(1.0 - u1, 0.0))[..., None]
    return (radius * np.cos(angle)) * tangent + (radius * np.sin(angle)) * bitangent + height * normal


def cosine_pdf(omega_i: Array, normal: Array) -> Array:
    """Return the density of `cosine_sample`, 1/sr, [*batch, 1]."""
    return np.maximum(dot(normal, omega_i), 0.0) / np.pi


def ggx_sample(u1: Array, u2: Array, omega_o: Array, normal: Array, alpha: Array) -> Array:
    """Return `omega_o` mirrored at half vectors drawn from D(h) cos, [*batch, 3].

    tan^2(theta_h) = alpha^2 u1 / (1 - u1). Some of the directions lie below the surface.
    """
    tangent, bitangent = frame_axes(normal)
    tan_squared = alpha * alpha * (u1 / np.maximum(1.0 - u1, 1e-12))[..., None]
    cosine = 1.0 / np.sqrt(1.0 + tan_squared)
    sine = np.sqrt(tan_squared) * cosine
    angle = (2.0 * np.pi * u2 - np.pi)[..., None]
    half = (sine * np.cos(angle)) * tangent + (sine * np.sin(angle)) * bitangent + cosine * normal
    return 2.0 * dot(omega_o, half) * half - omega_o


def ggx_pdf(half: HalfVector, alpha: Array) -> Array:
    """Return the density of `ggx_sample`, 1/sr, [*batch, 1]: D(h) (n.h) / (4 omega_o.h)."""
    density = ggx_density(half.n_dot_h**2, half.sine_squared, alpha)
    return density * half.n_dot_h / (4.0 * np.maximum(half.o_dot_h, FLOOR))
