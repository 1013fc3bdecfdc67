"""Compiled functions of a block of rows: contraction, encodings, activations, and places along rays.

Inside a block, values lie as [feature, STRIDE] with BLOCK rows, so that the innermost loop runs over rows and
is vectorised. All kernels release the interpreter lock and write nothing but their outputs, so blocks run
in threads. Numbers are float32 as in the ONNX graphs; sums are reordered (1e-6 relative).
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lambent_relight.compiling import COMPILE_OPTIONS
from lambent_relight.fused.tiles import BLOCK

_IN_ORDER = {**COMPILE_OPTIONS, "fastmath": {"contract"}}
"""For code whose steps undo each other's rounding, so that they may not change places."""
_LADDER_STEPS = 16_384


@njit(**COMPILE_OPTIONS)
def load_rows(rows, first, count, columns):
    """Write `count` rows of `rows` [row, n] from number `first` on to `columns` [n, STRIDE]."""
    for r in range(count):
        for i in range(rows.shape[1]):
            columns[i, r] = rows[first + r, i]


@njit(**COMPILE_OPTIONS)
def copy_rows(source, count, target, first):
    """Copy the first `count` features of `source` [n, STRIDE] to `target`, from feature `first` on."""
    for i in range(count):
        for r in range(BLOCK):
            target[first + i, r] = source[i, r]


@njit(**COMPILE_OPTIONS)
def contract_block(points, count, radius):
    """Replace `points` [3, STRIDE] by contracted coordinates (Mip-NeRF 360 Eq. 10), in units of `radius`."""
    one, two = np.float32(1.0), np.float32(2.0)
    for r in range(count):
        x, y, z = points[0, r] / radius, points[1, r] / radius, points[2, r] / radius
        norm = max(math.sqrt(x * x + y * y + z * z), one)
        scale = (two - one / norm) / norm
        points[0, r], points[1, r], points[2, r] = x * scale, y * scale, z * scale


@njit(**COMPILE_OPTIONS)
def _power_of_half(f):
    """Return 2^-f for f in [0, 1] (Chebyshev interpolation, error 2e-9)."""
    value = np.float32(0.00010932892473647371)
    value = value * f + np.float32(-0.0012755400966852903)
    value = value * f + np.float32(0.009579859673976898)
    value = value * f + np.float32(-0.05549093335866928)
    value = value * f + np.float32(0.24022433161735535)
    value = value * f + np.float32(-0.6931470632553101)
    return value * f + np.float32(1.0)


@njit(**COMPILE_OPTIONS)
def _log_of_one_plus(t):
    """Return log(1 + t) for t in [0, 1] (Chebyshev interpolation of the quotient by t, error 6e-9)."""
    value = np.float32(-0.0031760570127516985)
    value = value * t + np.float32(0.019542528316378593)
    value = value * t + np.float32(-0.05637361481785774)
    value = value * t + np.float32(0.10543623566627502)
    value = value * t + np.float32(-0.1526966691017151)
    value = value * t + np.float32(0.1966327428817749)
    value = value * t + np.float32(-0.24951615929603577)
    value = value * t + np.float32(0.33329710364341736)
    value = value * t + np.float32(-0.49999892711639404)
    value = value * t + np.float32(1.0)
    return value * t


@njit(**COMPILE_OPTIONS)
def softplus(values, sharpness):
    """Replace `values` [n, STRIDE] by log(1 + exp(sharpness v)) / sharpness.

    Written as max(x, 0) + log(1 + exp(-|x|)) with both functions as polynomials (error 1e-7), which a
    compiler vectorises; calls into the mathematical library it does not.
    """
    exponent = np.empty(BLOCK, np.int32)
    power = exponent.view(np.float32)
    for i in range(values.shape[0]):
        row = values[i]
        for r in range(BLOCK):
            # exp(-|x|) = 2^-k 2^-f with f in [0, 1)
            y = min(abs(row[r] * sharpness) * np.float32(1.4426950408889634), np.float32(120.0))
            exponent[r] = (127 - np.int32(y)) << 23
        for r in range(BLOCK):
            x = row[r] * sharpness
            y = min(abs(x) * np.float32(1.4426950408889634), np.float32(120.0))
            f = y - np.float32(np.int32(y))
            t = power[r] * _power_of_half(f)
            row[r] = (max(x, np.float32(0.0)) + _log_of_one_plus(t)) / sharpness


@njit(**_IN_ORDER)
def _sines_and_cosines(angles, factor, count, sines, cosines):
    """Write sin and cos of `angles` times `factor` (Cephes polynomials, error 1e-7), without branches."""
    half, one, two = np.float32(0.5), np.float32(1.0), np.float32(2.0)
    for r in range(count):
        x = angles[r] * factor
        quarters = np.floor(x * np.float32(0.6366197723675814) + half)
        # A quarter turn in three parts, of which the first has a short product with whole numbers.
        y = x - quarters * np.float32(1.5703125)
        y = y - quarters * np.float32(4.837512969970703e-4)
        y = y - quarters * np.float32(7.549789948768648e-8)
        z = y * y
        sine = np.float32(-1.9515295891e-4) * z + np.float32(8.3321608736e-3)
        sine = (sine * z + np.float32(-1.6666654611e-1)) * z * y + y
        cosine = np.float32(2.443315711809948e-5) * z + np.float32(-1.388731625493765e-3)
        cosine = (cosine * z + np.float32(4.166664568298827e-2)) * z * z - half * z + one
        halves = np.floor(quarters * half)
        odd = quarters - halves * two
        later = halves + odd
        sines[r] = (sine + odd * (cosine - sine)) * (one - two * (halves - two * np.floor(halves * half)))
        cosines[r] = (cosine + odd * (sine - cosine)) * (one - two * (later - two * np.floor(later * half)))


@njit(**COMPILE_OPTIONS)
def encode_frequencies(vectors, count, num_frequencies, out, first):
    """Write [v, sin(2^j v).., cos(2^j v)..] of `vectors` [3, STRIDE] to rows `first`.. of `out`."""
    for axis in range(3):
        for r in range(count):
            out[first + axis, r] = vectors[axis, r]
    for octave in range(num_frequencies):
        factor = np.float32(1 << octave)
        for axis in range(3):
            sines, cosines = first + 3 + 3 * octave + axis, first + 3 + 3 * (num_frequencies + octave) + axis
            _sines_and_cosines(vectors[axis], factor, count, out[sines], out[cosines])


@njit(**COMPILE_OPTIONS)
def exponentials(values, out, bits):
    """Write exp of `values` [BLOCK] to `out`; `bits` [BLOCK] is int32 scratch. Relative error 2e-7."""
    power = bits.view(np.float32)
    log2_of_e, most = np.float32(1.4426950408889634), np.float32(125.0)
    for r in range(BLOCK):
        y = np.floor(min(max(values[r] * log2_of_e, -most), most))
        bits[r] = (np.int32(y) + 128) << 23
    for r in range(BLOCK):
        y = min(max(values[r] * log2_of_e, -most), most)
        # 2^y = 2^(whole + 1) 2^-(1 - rest)
        out[r] = power[r] * _power_of_half(np.float32(1.0) - (y - np.floor(y)))


def distance_ladder(near: float, far: float, power: float, premultiplier: float) -> NDArray[np.float32]:
    """Return distances at evenly spaced places from 0 to 1 on the fast cache's curve, scene units.

    Between neighbours the curve is straight within 1e-7 of `far` where it is as bent as that of training.
    """
    a = abs(power - 1.0)
    start, end = ((a / power) * ((premultiplier * t / a + 1.0) ** power - 1.0) for t in (near, far))
    y = np.linspace(start, end, _LADDER_STEPS + 1)
    return ((a / premultiplier) * ((power * y / a + 1.0) ** (1.0 / power) - 1.0)).astype(np.float32)


@njit(**COMPILE_OPTIONS)
def place_samples(raw, count, ladder, far, opacity, distance, first, places, weights):
    """Write opacity and expected distance of a block to rows `first`.. of the outputs.

    `raw` [3 num_samples + 1, STRIDE] holds offsets, gates, weight logits, and the logit of the sum; `ladder`
    is `distance_ladder`. `places` and `weights` [num_samples, STRIDE] get the samples' distances and their
    shares of the opacity. Source: docs/reference/bundle-format.md (fast cache).
    """
    num_samples = places.shape[0]
    half, one, two = np.float32(0.5), np.float32(1.0), np.float32(2.0)
    steps = len(ladder) - 1
    scale = np.float32(steps)
    bits = np.empty(BLOCK, np.int32)
    value, decay = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    total, moment = np.zeros(BLOCK, np.float32), np.zeros(BLOCK, np.float32)
    largest = raw[2 * num_samples].copy()
    for k in range(1, num_samples):
        for r in range(BLOCK):
            largest[r] = max(largest[r], raw[2 * num_samples + k, r])
    for k in range(num_samples):
        even, part = np.float32(k / (num_samples - 1.0)), np.float32(1.0 / num_samples)
        for r in range(BLOCK):
            value[r] = two - raw[num_samples + k, r]
        exponentials(value, decay, bits)
        for r in range(BLOCK):
            s = even + raw[k, r] * part / (one + decay[r])
            whole = np.floor(s)
            rest = s - whole
            odd = whole - two * np.floor(whole * half)
            rest = (rest + odd * (one - two * rest)) * scale
            step = min(np.int32(rest), steps - 1)
            low = ladder[step]
            places[k, r] = low + (rest - np.float32(step)) * (ladder[step + 1] - low)
        for r in range(BLOCK):
            value[r] = raw[2 * num_samples + k, r] - largest[r]
        exponentials(value, weights[k], bits)
        for r in range(BLOCK):
            total[r] += weights[k, r]
            moment[r] += weights[k, r] * places[k, r]
    for r in range(BLOCK):
        value[r] = -two - raw[3 * num_samples, r]
    exponentials(value, decay, bits)
    for r in range(count):
        seen = one / (one + decay[r])
        opacity[first + r, 0] = seen
        distance[first + r, 0] = far if seen < np.float32(1e-3) else moment[r] / total[r]
    for k in range(num_samples):
        for r in range(BLOCK):
            weights[k, r] /= total[r] * (one + decay[r])


@njit(**COMPILE_OPTIONS)
def points_along(origins, directions, places, count, points):
    """Write origins + places * directions to `points`, all [3, STRIDE] but `places` [STRIDE]."""
    for axis in range(3):
        for r in range(count):
            points[axis, r] = origins[axis, r] + places[r] * directions[axis, r]


@njit(**COMPILE_OPTIONS)
def add_weighted(values, weights, total):
    """Add `values` [n, STRIDE] times `weights` [BLOCK] to `total` [n, STRIDE]."""
    for i in range(values.shape[0]):
        for r in range(BLOCK):
            total[i, r] += values[i, r] * weights[r]
