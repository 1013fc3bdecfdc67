"""The second factor of the split sum: how much of uniform light the specular lobe reflects.

Reflected radiance under constant unit light is F0 scale + bias, with the reflection model of
`lambent_relight.brdf`. From half vectors drawn with density D(h) (n.h), the integrand is

    weight = G(n.omega_i) (omega_o.h) / ((n.h) (n.omega_o (1 - k) + k)),    k = alpha / 2,

times (1 - f) for the scale and f for the bias, f = (1 - omega_o.h)^5. tan^2 of h is alpha^2 u / (1 - u) with
u = 1 - (1 - t)^3, which puts samples into the tail that matters at grazing angles; sums are over midpoints of
64 t and 32 azimuths in [0, pi], with du = 3 (1 - t)^2 dt. The table holds cosines (i / 31)^2 and perceptual
roughnesses j / 31; between entries values are linear in the cosine's root and in roughness.
Source: Karis 2013 (environment BRDF); docs/reference/conventions.md (split sum).
"""

import math
from functools import cache

import numpy as np
from lambent_core.directions import Array
from numpy.typing import NDArray

from lambent_relight.brdf import MIN_ALPHA, schlick_weight, shadowing_divisor

TABLE_SIDE = 32
"""Entries along the cosine and along perceptual roughness."""
_POLAR, _AZIMUTH = 64, 32


@cache
def table() -> NDArray[np.float32]:
    """Return (scale, bias) of cosine (i / 31)^2 and perceptual roughness j / 31, [32, 32, 2], read-only."""
    steps = np.arange(TABLE_SIDE) / (TABLE_SIDE - 1)
    values = np.stack([_entries(root * root, steps) for root in steps])
    values.flags.writeable = False
    return values


def _entries(cosine: float, perceptual_roughness: Array) -> NDArray[np.float32]:
    """Return (scale, bias) of one cosine and every roughness, [roughness, 2]."""
    alpha = np.maximum(perceptual_roughness**2, MIN_ALPHA)[:, None, None]
    rest = 1.0 - ((np.arange(_POLAR) + 0.5) / _POLAR)[:, None]
    share = rest**2 / np.sum(rest**2)
    azimuth = math.pi * (np.arange(_AZIMUTH) + 0.5) / _AZIMUTH
    tan_squared = alpha * alpha * (1.0 / rest**3 - 1.0)
    n_dot_h = 1.0 / np.sqrt(1.0 + tan_squared)
    across = np.sqrt(1.0 - cosine * cosine) * np.sqrt(tan_squared) * n_dot_h * np.cos(azimuth)
    o_dot_h = cosine * n_dot_h + across
    n_dot_i = 2.0 * o_dot_h * n_dot_h - cosine
    # Half vectors that face away from the viewer reflect nothing.
    lit = np.where((n_dot_i > 0.0) & (o_dot_h > 0.0), n_dot_i, 0.0)
    weight = lit / shadowing_divisor(lit, alpha) * o_dot_h
    weight /= n_dot_h * shadowing_divisor(cosine, alpha)
    fresnel = schlick_weight(o_dot_h)
    weight *= share / _AZIMUTH
    sums = [(weight * (1.0 - fresnel)).sum(axis=(1, 2)), (weight * fresnel).sum(axis=(1, 2))]
    return np.stack(sums, axis=-1).astype(np.float32)


def split_sum(cosine: Array, perceptual_roughness: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (scale, bias) of `cosine` = n.omega_o and `perceptual_roughness`, of their common shape.

    Both arguments are clipped to [0, 1]. Specular radiance is (F0 scale + bias) times prefiltered radiance.
    """
    last = TABLE_SIDE - 1
    row = np.sqrt(np.clip(np.asarray(cosine, np.float32), 0.0, 1.0)) * np.float32(last)
    column = np.clip(np.asarray(perceptual_roughness, np.float32), 0.0, 1.0) * np.float32(last)
    row, column = np.broadcast_arrays(row, column)
    top, left = np.minimum(row.astype(np.int64), last - 1), np.minimum(column.astype(np.int64), last - 1)
    down, across = (row - top).astype(np.float32)[..., None], (column - left).astype(np.float32)[..., None]
    values = table()
    upper = values[top, left] * (1 - across) + values[top, left + 1] * across
    lower = values[top + 1, left] * (1 - across) + values[top + 1, left + 1] * across
    mixed = upper * (1 - down) + lower * down
    return mixed[..., 0], mixed[..., 1]
