"""Compiled functions of a block of rows: contraction, sums, and places along rays.

Inside a block, values lie as [feature, STRIDE] with BLOCK rows, so that the innermost loop runs over rows and
is vectorised. All kernels release the interpreter lock and write nothing but their outputs, so blocks run
in threads. Numbers are float32 as in the ONNX graphs; sums are reordered (1e-6 relative).
What is rounded is computed for all rows of a block, so that an answer does not depend on their number: vector
instructions and those for what is left over may round otherwise.
"""

import numpy as np
from lambent_compute import blocks
from lambent_compute.compiling import inlined
from lambent_compute.functions import exponential, sigmoid
from lambent_compute.tiles import COLUMNS as BLOCK
from numpy.typing import NDArray

STRIDE = BLOCK + 16
"""Row length of arrays of activations: with a power of two, rows would share a few lines of the cache."""
_LADDER_STEPS = 16_384


@inlined()
def load_rows(rows, first, count, columns):
    """Write `count` rows of `rows` [row, n] from number `first` on to `columns` [n, STRIDE]."""
    for r in range(count):
        for i in range(rows.shape[1]):
            columns[i, r] = rows[first + r, i]


@inlined()
def contract_block(points, radius):
    """Replace `points` [3, STRIDE] by contracted coordinates, in units of `radius`."""
    for r in range(BLOCK):
        # Divided as in the ONNX graph: fine grids magnify a difference in the last digit.
        x, y, z = points[0, r] / radius, points[1, r] / radius, points[2, r] / radius
        points[0, r], points[1, r], points[2, r] = blocks.contract(x, y, z, np.float32(1.0))


def distance_ladder(near: float, far: float, power: float, premultiplier: float) -> NDArray[np.float32]:
    """Return distances at evenly spaced places from 0 to 1 on the fast cache's curve, scene units.

    Between neighbours the curve is straight within 1e-7 of `far` where it is as bent as that of training.
    """
    a = abs(power - 1.0)
    start, end = ((a / power) * ((premultiplier * t / a + 1.0) ** power - 1.0) for t in (near, far))
    y = np.linspace(start, end, _LADDER_STEPS + 1)
    return ((a / premultiplier) * ((power * y / a + 1.0) ** (1.0 / power) - 1.0)).astype(np.float32)


@inlined()
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
    total, moment = np.zeros(BLOCK, np.float32), np.zeros(BLOCK, np.float32)
    largest = raw[2 * num_samples].copy()
    for k in range(1, num_samples):
        for r in range(BLOCK):
            largest[r] = max(largest[r], raw[2 * num_samples + k, r])
    for k in range(num_samples):
        even, part = np.float32(k / (num_samples - 1.0)), np.float32(1.0 / num_samples)
        for r in range(BLOCK):
            s = even + raw[k, r] * part * sigmoid(raw[num_samples + k, r] - two)
            whole = np.floor(s)
            rest = s - whole
            odd = whole - two * np.floor(whole * half)
            rest = (rest + odd * (one - two * rest)) * scale
            step = min(np.int32(rest), steps - 1)
            low = ladder[step]
            places[k, r] = low + (rest - np.float32(step)) * (ladder[step + 1] - low)
        for r in range(BLOCK):
            weights[k, r] = exponential(raw[2 * num_samples + k, r] - largest[r])
            total[r] += weights[k, r]
            moment[r] += weights[k, r] * places[k, r]
    seen = largest
    for r in range(BLOCK):
        seen[r] = sigmoid(raw[3 * num_samples, r] + two)
        moment[r] = far if seen[r] < np.float32(1e-3) else moment[r] / total[r]
    for r in range(count):
        opacity[first + r, 0], distance[first + r, 0] = seen[r], moment[r]
    for k in range(num_samples):
        for r in range(BLOCK):
            weights[k, r] *= seen[r] / total[r]


@inlined()
def points_along(origins, directions, places, count, points):
    """Write origins + places * directions to `points`, all [3, STRIDE] but `places` [STRIDE]."""
    for axis in range(3):
        for r in range(count):
            points[axis, r] = origins[axis, r] + places[r] * directions[axis, r]


@inlined()
def add_weighted(values, weights, total):
    """Add `values` [n, STRIDE] times `weights` [BLOCK] to `total` [n, STRIDE]."""
    for i in range(values.shape[0]):
        for r in range(BLOCK):
            total[i, r] += values[i, r] * weights[r]
