"""`lambent_relight.brdf` for one pair of directions at a time, in compiled loops and double precision.

The equations are stated there; functions of the same name are the same ones. The browser's, in TypeScript and
GLSL, are translated from these (`scripts/shared_reflectance.py`).
"""

import math

from lambent_compute.compiling import inlined

from lambent_relight.brdf import DIELECTRIC_F0, FLOOR


@inlined(fastmath=False)
def base_reflectance(albedo, metalness):
    """Return F0 of one channel."""
    return metalness * albedo + (1.0 - metalness) * DIELECTRIC_F0


@inlined(fastmath=False)
def schlick_weight(o_dot_h):
    """Return Schlick's (1 - cos)^5 of a cosine in [0, 1]."""
    return (1.0 - o_dot_h) ** 5


@inlined(fastmath=False)
def ggx_density(n_dot_h, sine_squared, alpha):
    """Return D(h), 1/sr."""
    width = alpha * alpha
    return width / (math.pi * max(n_dot_h * n_dot_h * width + sine_squared, FLOOR * width) ** 2)


@inlined(fastmath=False)
def shadowing(cosine, alpha):
    """Return Smith's term of one direction, in Schlick's form."""
    k = 0.5 * alpha
    return cosine / max(cosine * (1.0 - k) + k, FLOOR)


@inlined(fastmath=False)
def specular_cos(density, n_dot_o, n_dot_i, alpha):
    """Return the specular lobe times cosine without Fresnel, from `ggx_density` and cosines >= 0."""
    return density * shadowing(n_dot_i, alpha) * shadowing(n_dot_o, alpha) / (4.0 * max(n_dot_o, FLOOR))


@inlined(fastmath=False)
def half_vector(ox, oy, oz, x, y, z, nx, ny, nz):
    """Return (n.h, sine squared to the normal, o.h) of a viewer, a light and a normal."""
    hx, hy, hz = ox + x, oy + y, oz + z
    length = max(math.sqrt(hx * hx + hy * hy + hz * hz), 1e-10)
    hx, hy, hz = hx / length, hy / length, hz / length
    ax, ay, az = ny * hz - nz * hy, nz * hx - nx * hz, nx * hy - ny * hx
    n_dot_h = max(nx * hx + ny * hy + nz * hz, 0.0)
    return n_dot_h, ax * ax + ay * ay + az * az, min(max(ox * hx + oy * hy + oz * hz, 0.0), 1.0)
