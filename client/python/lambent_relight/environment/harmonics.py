"""Real spherical harmonics: basis, projection of environments, rotation about z.

Orthonormal over the sphere, no Condon-Shortley sign: Y_1,-1 ~ y, Y_1,0 ~ z, Y_1,1 ~ x. Coefficient (l, m)
has the index l (l + 1) + m; "SH-n" has the n bands l = 0 .. n - 1, which are n^2 coefficients. A function's
coefficients are [bands^2, channels]. Source: docs/reference/conventions.md (spherical harmonics).
"""

import math

import numpy as np
from lambent_core.directions import Array
from lambent_core.errors import SettingError
from numpy.typing import NDArray

from lambent_relight.environment.maps import Environment

MAX_BANDS = 16
"""Largest number of bands; quadrature is tested up to here."""
_NODES_PER_HALF_ROW = 8


def _checked(bands: int) -> int:
    if not 1 <= bands <= MAX_BANDS:
        raise SettingError("relight.sh_bands", f"{bands} bands", f"use 1 to {MAX_BANDS}")
    return bands


def legendre(cosine: Array, bands: int) -> NDArray[np.float64]:
    """Return Q_lm(z) of z = `cosine` [n], as [n, bands, bands] (l, m >= 0; zero where m > l).

    Q_lm is the orthonormal associated Legendre function over sin^m, so that with x + iy = sin e^(i azimuth)

        Y_l,0 = Q_l0,   Y_l,m = sqrt(2) Q_lm Re (x + iy)^m,   Y_l,-m = sqrt(2) Q_lm Im (x + iy)^m.
    """
    z = np.asarray(cosine, np.float64)
    q = np.zeros((len(z), _checked(bands), bands))
    diagonal = math.sqrt(0.25 / math.pi)
    for m in range(bands):
        if m > 0:
            diagonal *= math.sqrt((2 * m + 1) / (2 * m))
        q[:, m, m] = diagonal
        if m + 1 < bands:
            q[:, m + 1, m] = math.sqrt(2 * m + 3) * z * diagonal
        for degree in range(m + 2, bands):
            scale = math.sqrt((4 * degree**2 - 1) / (degree**2 - m**2))
            before = math.sqrt(((degree - 1) ** 2 - m**2) / (4 * (degree - 1) ** 2 - 1))
            q[:, degree, m] = scale * (z * q[:, degree - 1, m] - before * q[:, degree - 2, m])
    return q


def basis(directions: Array, bands: int) -> NDArray[np.float64]:
    """Return the values of the basis at unit `directions` [n, 3], as [n, bands^2]."""
    points = np.asarray(directions, np.float64)
    q = legendre(points[:, 2], bands)
    power = np.ones(len(points), np.complex128)
    result = np.empty((len(points), bands**2))
    for m in range(bands):
        for degree in range(m, bands):
            centre = degree * (degree + 1)
            if m == 0:
                result[:, centre] = q[:, degree, 0]
            else:
                result[:, centre + m] = math.sqrt(2.0) * q[:, degree, m] * power.real
                result[:, centre - m] = math.sqrt(2.0) * q[:, degree, m] * power.imag
        power = power * (points[:, 0] + 1j * points[:, 1])
    return result


def project(environment: Environment, bands: int) -> NDArray[np.float64]:
    """Return the coefficients [bands^2, 3] of the radiance that `environment.lookup` gives.

    The bilinear interpolant is integrated over the sphere, not sampled at pixel centres: with hat functions
    h_i of rows and g_j of columns the integral separates into

        sum_ij L_ij (integral of h_i Q_lm sin^(m+1) d polar) (integral of g_j e^(i m azimuth) d azimuth),

    the second in closed form, sinc^2(m / W) times the centre's value. A constant has band 0 only, and turning
    a map by whole pixels is the same as `rotate_z`.
    """
    height, width, _ = environment.radiance.shape
    weights = _row_integrals(height, _checked(bands))
    azimuth = math.pi - 2.0 * math.pi * (np.arange(width) + 0.5) / width
    orders = np.arange(bands)
    columns = (2.0 * math.pi / width) * np.sinc(orders / width) ** 2
    waves = np.exp(1j * azimuth[:, None] * orders) * columns
    waves = np.concatenate([waves.real, waves.imag], axis=1).astype(np.float32 if width > 64 else np.float64)
    # One row after another keeps the product in double precision without a copy of the whole map.
    series = np.einsum("hwc,wm->hmc", environment.radiance, waves, optimize=True).astype(np.float64)
    moments = np.einsum("hlm,hmc->lmc", weights, series[:, :bands])
    sines = np.einsum("hlm,hmc->lmc", weights, series[:, bands:])
    result = np.empty((bands**2, 3))
    for degree in range(bands):
        centre = degree * (degree + 1)
        result[centre] = moments[degree, 0]
        for m in range(1, degree + 1):
            result[centre + m] = math.sqrt(2.0) * moments[degree, m]
            result[centre - m] = math.sqrt(2.0) * sines[degree, m]
    return rotate_z(result, environment.rotate_deg) if environment.rotate_deg else result


def _row_integrals(height: int, bands: int) -> NDArray[np.float64]:
    """Return the integral over the polar angle of every row's hat times Q_lm sin^(m+1), [height, l, m].

    Gauss-Legendre on every half row; the first and the last row reach their pole with full weight.
    """
    node, weight = np.polynomial.legendre.leggauss(_NODES_PER_HALF_ROW)
    half = 0.5 * math.pi / height
    polar = (half * (np.arange(2 * height)[:, None] + 0.5 * (node + 1.0))).ravel()
    place = polar / math.pi * height - 0.5
    row = np.clip(np.floor(place), 0, height - 1).astype(np.int64)
    below = np.clip(place - row, 0.0, 1.0)
    below[row == height - 1] = 0.0
    measure = np.tile(0.5 * half * weight, 2 * height)
    values = legendre(np.cos(polar), bands) * measure[:, None, None]
    values *= np.sin(polar)[:, None, None] ** (np.arange(bands) + 1)
    result = np.zeros((height, bands, bands))
    np.add.at(result, row, values * (1.0 - below)[:, None, None])
    np.add.at(result, np.minimum(row + 1, height - 1), values * below[:, None, None])
    return result


def rotate_z(coefficients: Array, degrees: float) -> NDArray[np.float64]:
    """Return the coefficients of the function turned by +`degrees` about +z: f'(d) = f(Rz(-degrees) d)."""
    values = np.asarray(coefficients, np.float64)
    result = values.copy()
    for degree in range(1, math.isqrt(len(values))):
        centre = degree * (degree + 1)
        for m in range(1, degree + 1):
            cosine, sine = math.cos(math.radians(m * degrees)), math.sin(math.radians(m * degrees))
            result[centre + m] = cosine * values[centre + m] - sine * values[centre - m]
            result[centre - m] = sine * values[centre + m] + cosine * values[centre - m]
    return result


def cosine_factors(bands: int) -> NDArray[np.float64]:
    """Return the factor per coefficient that turns radiance into irradiance, [bands^2].

    The clamped cosine's zonal coefficients times sqrt(4 pi / (2 l + 1)): pi, 2 pi / 3, pi / 4, 0, -pi / 24.
    Source: Ramamoorthi and Hanrahan 2001, Eq. 7 and 8.
    """
    factors = []
    for degree in range(_checked(bands)):
        if degree == 1:
            value = 2.0 * math.pi / 3.0
        elif degree % 2:
            value = 0.0
        else:
            half = degree // 2
            sign = -1.0 if half % 2 == 0 else 1.0
            value = sign * 2.0 * math.pi / ((degree + 2) * (degree - 1))
            value *= math.factorial(degree) / (2**degree * math.factorial(half) ** 2)
        factors.append(value)
    return np.repeat(factors, 2 * np.arange(bands) + 1)
