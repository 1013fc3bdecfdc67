"""Compiled loops of refined relighting: directions at points with their weights, and the sums over them."""

import math
from typing import NamedTuple

import numpy as np
from lambent_compute.compiling import compiled, inlined
from numpy.typing import NDArray

from lambent_relight.brdf import FLOOR
from lambent_relight.brdf_kernels import (
    base_reflectance,
    ggx_density,
    half_vector,
    schlick_weight,
    specular_cos,
)
from lambent_relight.environment.light_sampling import COSINE_LOBE
from lambent_relight.environment.light_sampling_kernels import (
    density_in,
    direction_in,
    pixel_at,
    row_of,
)


class Points(NamedTuple):
    """Points that reflect light, float64."""

    normal: NDArray[np.float64]
    omega_o: NDArray[np.float64]
    albedo: NDArray[np.float64]
    alpha: NDArray[np.float64]
    """GGX width, [point]."""
    metalness: NDArray[np.float64]
    lobe: NDArray[np.int64]
    """Number of the light sampler's lobe that fits `alpha`, [point]."""


@inlined(fastmath=False)
def _frame(nx, ny, nz):
    """Return the tangent and the bitangent of `lambent_core.directions.frame_axes`."""
    if abs(nz) >= 0.9:
        tx, ty, tz = nz, 0.0, -nx
    else:
        tx, ty, tz = -ny, nx, 0.0
    length = max(math.sqrt(tx * tx + ty * ty + tz * tz), 1e-10)
    tx, ty, tz = tx / length, ty / length, tz / length
    return tx, ty, tz, ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx


@compiled(fastmath=False)
def draw(points, table, u, shares, omega_i, diffuse, specular, pdf):
    """Write directions [ray, 3], both lobes' weights [ray, 3], and the mixture's densities [ray].

    Rays divide evenly among the points, in their order. `u` [ray, 3] are uniforms, `shares` [point, 4] the
    probabilities of the strategies. Directions below the surface get weight zero and density zero.
    """
    num_points = len(points.normal)
    per_point = len(u) // max(num_points, 1)
    for p in range(num_points):
        nx, ny, nz = points.normal[p, 0], points.normal[p, 1], points.normal[p, 2]
        ox, oy, oz = points.omega_o[p, 0], points.omega_o[p, 1], points.omega_o[p, 2]
        alpha, metalness = points.alpha[p], points.metalness[p]
        n_dot_o = nx * ox + ny * oy + nz * oz
        tx, ty, tz, bx, by, bz = _frame(nx, ny, nz)
        mx, my, mz = 2.0 * n_dot_o * nx - ox, 2.0 * n_dot_o * ny - oy, 2.0 * n_dot_o * nz - oz
        lit_cosine = row_of(table, COSINE_LOBE, nx, ny, nz)
        lit_mirror = row_of(table, points.lobe[p], mx, my, mz)
        first, second, third = shares[p, 0], shares[p, 1], shares[p, 2]
        for r in range(p * per_point, (p + 1) * per_point):
            if u[r, 0] < first:
                x, y, z = direction_in(table, lit_cosine, u[r, 1], u[r, 2])
            elif u[r, 0] < first + second:
                radius, angle = math.sqrt(u[r, 1]), 2.0 * math.pi * u[r, 2]
                a, b, c = radius * math.cos(angle), radius * math.sin(angle), math.sqrt(1.0 - u[r, 1])
                x, y, z = a * tx + b * bx + c * nx, a * ty + b * by + c * ny, a * tz + b * bz + c * nz
            elif u[r, 0] < first + second + third:
                tan_squared = alpha * alpha * u[r, 1] / max(1.0 - u[r, 1], 1e-12)
                c = 1.0 / math.sqrt(1.0 + tan_squared)
                sine, angle = math.sqrt(tan_squared) * c, 2.0 * math.pi * u[r, 2] - math.pi
                a, b = sine * math.cos(angle), sine * math.sin(angle)
                hx, hy, hz = a * tx + b * bx + c * nx, a * ty + b * by + c * ny, a * tz + b * bz + c * nz
                twice = 2.0 * (ox * hx + oy * hy + oz * hz)
                x, y, z = twice * hx - ox, twice * hy - oy, twice * hz - oz
            else:
                x, y, z = direction_in(table, lit_mirror, u[r, 1], u[r, 2])
            omega_i[r, 0], omega_i[r, 1], omega_i[r, 2] = x, y, z
            pdf[r] = 0.0
            for k in range(3):
                diffuse[r, k] = specular[r, k] = np.float32(0.0)
            n_dot_i = nx * x + ny * y + nz * z
            if n_dot_i <= 0.0:
                continue
            n_dot_h, sine_squared, o_dot_h = half_vector(ox, oy, oz, x, y, z, nx, ny, nz)
            density = ggx_density(n_dot_h, sine_squared, alpha)
            pixel = pixel_at(table, x, y, z)
            mixed = (
                first * density_in(table, lit_cosine, pixel)
                + second * n_dot_i / math.pi
                + third * density * n_dot_h / (4.0 * max(o_dot_h, FLOOR))
                + shares[p, 3] * density_in(table, lit_mirror, pixel)
            )
            if mixed <= 0.0:
                continue
            pdf[r] = mixed
            scale = 1.0 / max(mixed, 1e-20)
            lobe = specular_cos(density, max(n_dot_o, 0.0), n_dot_i, alpha)
            grazing = schlick_weight(o_dot_h)
            for k in range(3):
                albedo = points.albedo[p, k]
                f0 = base_reflectance(albedo, metalness)
                diffuse[r, k] = (1.0 - metalness) * albedo * (n_dot_i / math.pi) * scale
                specular[r, k] = (f0 + (1.0 - f0) * grazing) * lobe * scale


@compiled(fastmath=False)
def add_up(active, per_point, known, diffuse, specular, arriving, bouncing, cosine, free, out):
    """Write means over the `per_point` rays of each point to the first five of `out` [6, point, 3].

    Direct radiance, radiance from surfaces, the specular part of both, the free share, and what the diffuse
    lobe reflects of radiance from surfaces where that is `known` [point], which the second then lacks.

    `active` are the rays that were traced. `diffuse` and `specular` are of all rays; light that arrives
    directly and from surfaces, the weight of visibility and the free share are of the active ones.
    """
    for i in range(len(active)):
        r = active[i]
        p = r // per_point
        for k in range(3):
            light = arriving[i, k] + bouncing[i, k]
            weight = diffuse[r, k] + specular[r, k]
            out[0, p, k] += weight * arriving[i, k] / per_point
            out[1, p, k] += (specular[r, k] if known[p] else weight) * bouncing[i, k] / per_point
            if known[p]:
                out[4, p, k] += diffuse[r, k] * bouncing[i, k] / per_point
            out[2, p, k] += specular[r, k] * light / per_point
            out[3, p, k] += cosine[i] * free[i, 0] / per_point
