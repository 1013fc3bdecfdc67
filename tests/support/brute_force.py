"""Relighting by the definition: uniform directions over the sphere, exact hits, no importance sampling.

Written apart from the product, in float64, with formulas of its own.
"""

import numpy as np
from support.analytic_scene import AnalyticScene, trace
from support.onnx_expressions import NumpyOps


def uniform_directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return `count` directions, uniform over the sphere (density 1 / 4 pi)."""
    z = rng.uniform(-1.0, 1.0, count)
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)


def reflect_cos(omega_o, omega_i, normal, albedo, perceptual_roughness, metalness):
    """Return BRDF times cosine [n, 3]: Lambert plus GGX, supplement Eqs. 3-5."""
    alpha = np.maximum(perceptual_roughness**2, 1e-4)
    cos_i = np.sum(normal * omega_i, -1, keepdims=True)
    cos_o = np.sum(normal * omega_o, -1, keepdims=True)
    half = omega_i + omega_o
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    cos_h = np.clip(np.sum(normal * half, -1, keepdims=True), 0.0, 1.0)
    density = alpha**2 / (np.pi * (cos_h**2 * (alpha**2 - 1.0) + 1.0) ** 2)
    f0 = metalness * albedo + (1.0 - metalness) * 0.04
    fresnel = f0 + (1.0 - f0) * (1.0 - np.sum(omega_i * half, -1, keepdims=True)) ** 5
    k = alpha / 2.0
    shadowing = cos_i / (cos_i * (1 - k) + k) * cos_o / (cos_o * (1 - k) + k)
    specular = density * fresnel * shadowing / (4.0 * np.maximum(cos_o, 1e-9))
    diffuse = (1.0 - metalness) * albedo / np.pi * cos_i
    lit = cos_i > 0.0
    return np.where(lit, diffuse + np.where(cos_o > 0.0, specular, 0.0), 0.0)


def reflected_samples(
    scene: AnalyticScene,
    position: np.ndarray,
    omega_o: np.ndarray,
    light,
    *,
    rng: np.random.Generator,
    bounces: int,
) -> np.ndarray:
    """Return one unbiased sample per point [n, 3] of the light reflected towards `omega_o`.

    `light(directions)` is the environment's radiance. `bounces` is 0 for direct light, 1 to add light that
    one other surface has reflected.
    """
    albedo, roughness, metalness, normal = scene.surface_at(NumpyOps, position)
    omega_i = uniform_directions(rng, len(position))
    weight = 4.0 * np.pi * reflect_cos(omega_o, omega_i, normal, albedo, roughness, metalness)
    origin = position + scene.origin_offset * normal
    distance, hits = trace(scene, origin, omega_i)
    incoming = np.where(hits, 0.0, light(omega_i))
    follow = np.flatnonzero(hits[:, 0] & (weight.max(axis=-1) > 0.0))
    if bounces and len(follow):
        there = origin[follow] + distance[follow] * omega_i[follow]
        incoming[follow] = reflected_samples(
            scene, there, -omega_i[follow], light, rng=rng, bounces=bounces - 1
        )
    return weight * incoming
