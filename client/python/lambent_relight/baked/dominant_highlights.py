"""Dominant lights in the specular lobe of baked pictures: each with its own shadow and its exact reflection.

Harmonics of the visibility are too smooth to resolve the shadow of a single bright light. The contribution of
a dominant light is therefore removed from the prefiltered map,

    K(mirror . l) E_l,   K(c) = w(c) / (2 pi integral of w over the cosines 0..1),

with the weight w of `environment.prefilter` and E_l the light's radiance times solid angle, and
replaced by the GGX reflection of E_l from l, times the share of it that passes the shadow
bits. A lobe much narrower than a light resolves its extent: there the map is not changed.
"""

import numpy as np
from lambent_compute.compiling import compiled
from numpy.typing import NDArray

from lambent_relight.brdf_kernels import ggx_density, half_vector, schlick_weight, specular_cos

Rows = NDArray[np.float32]

NARROW_ALPHA, WIDE_ALPHA = 0.05, 0.15
"""GGX widths over which dominant lights are faded in; the radius of a light is 0.14 (8 degrees)."""
_EVEN = 1e-3


def lobe_scale(alpha: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return one over the integral of the prefilter's weight over the sphere, 1/sr, per GGX width [n]."""
    square = np.asarray(alpha, np.float64) ** 2
    base, slope = 0.5 * (1.0 + square), 0.5 * (square - 1.0)
    even = np.abs(slope) < _EVEN
    integral = (np.log(square / base) + base / square - 1.0) / np.where(even, 1.0, slope) ** 2
    return (1.0 / (2.0 * np.pi * np.where(even, 0.5, integral))).astype(np.float32)


def glints(
    geometry: tuple[Rows, Rows, Rows],
    lobes: tuple[Rows, Rows, Rows],
    lights: tuple[Rows, Rows, Rows],
    prefiltered: Rows,
) -> tuple[Rows, Rows]:
    """Return prefiltered radiance without dominant lights, and those lights' reflection, [pixel, 3] each.

    `geometry`: normals, directions to the viewer and mirror directions, [pixel, 3]. `lobes`: GGX width
    [pixel], `lobe_scale` [pixel] and reflectance at normal incidence [pixel, 3]. `lights`: directions
    [light, 3], radiance times solid angle [light, 3], and the share of each that reaches a pixel
    [light, pixel].
    """
    rest, added = np.empty_like(prefiltered), np.zeros_like(prefiltered)
    arrays = (np.ascontiguousarray(part, np.float32) for part in (*geometry, *lobes, *lights, prefiltered))
    _glints(*arrays, rest, added)
    return rest, added


@compiled()
def _glints(normal, omega_o, mirror, alpha, scale, f0, direction, radiance, share, prefiltered, rest, added):
    one, zero, half = np.float32(1.0), np.float32(0.0), np.float32(0.5)
    for p in range(len(normal)):
        width = alpha[p]
        trust = min(
            max((width - np.float32(NARROW_ALPHA)) / np.float32(WIDE_ALPHA - NARROW_ALPHA), zero), one
        )
        for channel in range(3):
            rest[p, channel] = prefiltered[p, channel]
        if trust <= zero:
            continue
        square = width * width
        ox, oy, oz = omega_o[p, 0], omega_o[p, 1], omega_o[p, 2]
        nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
        n_dot_o = max(nx * ox + ny * oy + nz * oz, np.float32(1e-6))
        taken_r, taken_g, taken_b = zero, zero, zero
        for light in range(len(direction)):
            lx, ly, lz = direction[light, 0], direction[light, 1], direction[light, 2]
            c = mirror[p, 0] * lx + mirror[p, 1] * ly + mirror[p, 2] * lz
            if c > zero:
                spread = half * (one + c) * square + half * (one - c)
                weight = scale[p] * c / (spread * spread)
                taken_r += weight * radiance[light, 0]
                taken_g += weight * radiance[light, 1]
                taken_b += weight * radiance[light, 2]
            n_dot_i = nx * lx + ny * ly + nz * lz
            if n_dot_i <= zero or share[light, p] <= zero:
                continue
            n_dot_h, sine_squared, o_dot_h = half_vector(ox, oy, oz, lx, ly, lz, nx, ny, nz)
            density = ggx_density(n_dot_h, sine_squared, width)
            factor = trust * share[light, p] * specular_cos(density, n_dot_o, n_dot_i, width)
            grazing = schlick_weight(o_dot_h)
            for channel in range(3):
                fresnel = f0[p, channel] + (one - f0[p, channel]) * grazing
                added[p, channel] += factor * fresnel * radiance[light, channel]
        rest[p, 0] -= trust * min(taken_r, prefiltered[p, 0])
        rest[p, 1] -= trust * min(taken_g, prefiltered[p, 1])
        rest[p, 2] -= trust * min(taken_b, prefiltered[p, 2])
