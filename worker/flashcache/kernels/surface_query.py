"""Normals and outgoing radiance of points, a block of points after another; no gradients.

Source: supplement 2.2, as `flashcache.fields.density.NormalField` and `flashcache.fields.appearance`.
"""

import math
from typing import NamedTuple

import numpy as np
from lambent_compute import blocks, functions, tiles
from lambent_compute.blocks import Networks
from lambent_compute.compiling import compiled, inlined
from lambent_compute.tiles import COLUMNS
from numpy.typing import NDArray

from flashcache.kernels import lookup
from flashcache.kernels.lookup import Grid

POINTS = 256
"""Points of a block: their features stay in the core's own cache while the levels of a grid pass by."""

ONE, TWO, ZERO = np.float32(1.0), np.float32(2.0), np.float32(0.0)


class Directional(NamedTuple):
    """The constants of an `IntegratedDirectionalEncoding`, whose polynomials are an affine layer."""

    orders: NDArray[np.int64]
    """Power of x + iy in each term."""
    rates: NDArray[np.float32]


class Appearance(NamedTuple):
    """What is read of an appearance besides its grid, networks and directional encoding.

    Layers are the polynomials, the heads, the bottleneck, and from `factor` and `reflection` on the two
    networks with their heads, up to `end`.
    """

    factor: int
    reflection: int
    end: int
    num_lights: int
    view_frequencies: int
    """-1 without the view direction as an input."""
    inverse_radius: np.float32
    width_bias: np.float32
    factor_bias: np.float32
    most: np.float32
    """Largest radiance."""
    with_specular: bool


@inlined()
def _read_points(positions, hidden, start, size, inverse_radius, contracted, features, first):
    """Contract a block of points, and copy their hidden features to `features` at row `first`."""
    for i in range(size):
        contracted[0, i], contracted[1, i], contracted[2, i] = blocks.contract(
            positions[start + i, 0], positions[start + i, 1], positions[start + i, 2], inverse_radius
        )
    for i in range(size):
        for f in range(hidden.shape[1]):
            features[first + f, i] = hidden[start + i, f]


@inlined()
def _encode_lobe(reflected, width, directional, networks, powers, chebyshev, along_z, tile, row):
    """Write the encoded lobe around `reflected` [3, COLUMNS] to `tile` at `row`, real parts first."""
    real, imaginary = powers
    for r in range(COLUMNS):
        chebyshev[0, r], chebyshev[1, r] = ONE, reflected[2, r]
        real[0, r], imaginary[0, r] = ONE, ZERO
    for k in range(1, chebyshev.shape[0]):
        if k > 1:
            for r in range(COLUMNS):
                chebyshev[k, r] = TWO * reflected[2, r] * chebyshev[k - 1, r] - chebyshev[k - 2, r]
        for r in range(COLUMNS):
            a, b = real[k - 1, r], imaginary[k - 1, r]
            real[k, r] = a * reflected[0, r] - b * reflected[1, r]
            imaginary[k, r] = a * reflected[1, r] + b * reflected[0, r]
    tiles.affine(networks.parameters, networks.layers[0], chebyshev, 0, along_z, 0, False)
    terms = len(directional.orders)
    for t in range(terms):
        order, rate = directional.orders[t], directional.rates[t]
        for r in range(COLUMNS):
            value = along_z[t, r] * functions.exponential(-rate * width[r])
            tile[row + t, r] = value * real[order, r]
            tile[row + terms + t, r] = value * imaginary[order, r]


@compiled()
def outgoing(
    begin, end, positions, hidden, normal, omega_o, light, table, parameters, settings, constants, widest,
    diffuse, specular, irradiance,
):  # fmt: skip
    """Write the three parts of the radiance [point, 3] that points send towards `omega_o`.

    The arguments from `table` to `constants` are `Grid`, `Networks`, `Appearance` and `Directional` as
    plain tuples.
    """
    grid, networks, query = Grid(*table), Networks(*parameters), Appearance(*settings)
    directional = Directional(*constants)
    width = hidden.shape[1]
    num_encoded = grid.counts.shape[0] * grid.table.shape[1]
    num_lights, bottleneck = query.num_lights, networks.layers[2, 3]
    lobe = bottleneck + 2 * len(directional.orders)
    features = np.zeros((width + num_encoded, POINTS), np.float32)
    contracted, voxels = np.zeros((3, POINTS), np.float32), lookup.voxels_of(POINTS)
    inputs = np.zeros((widest, COLUMNS), np.float32)
    first, second, heads, along_z = np.zeros((4, widest, COLUMNS), np.float32)
    chebyshev = np.zeros((networks.layers[0, 2], COLUMNS), np.float32)
    real, imaginary = np.zeros_like(chebyshev), np.zeros_like(chebyshev)
    reflected, view = np.zeros((3, COLUMNS), np.float32), np.zeros((3, COLUMNS), np.float32)
    cosine, factor, spread, value = np.zeros((4, COLUMNS), np.float32)
    for start in range(begin, end, POINTS):
        size = min(POINTS, end - start)
        _read_points(positions, hidden, start, size, query.inverse_radius, contracted, features, 0)
        lookup.encode(contracted, size, grid, voxels, features, width)
        for c in range(0, size, COLUMNS):
            rows = min(COLUMNS, size - c)
            base = start + c
            tiles.affine(networks.parameters, networks.layers[1], features, c, heads, 0, False)
            for axis in range(3):
                for r in range(rows):
                    row = axis + (6 * light[base + r] if num_lights > 1 else 0)
                    value[r] = heads[row, r] - TWO
                    spread[r] = heads[row + 3, r] - TWO
                for r in range(rows):
                    sent = functions.softplus(value[r])
                    diffuse[base + r, axis] = query.most if sent > query.most else sent
                    irradiance[base + r, axis] = functions.softplus(spread[r])
            if not query.with_specular:
                specular[base : base + rows] = ZERO
                continue
            tint = 6 * num_lights
            for r in range(COLUMNS):
                spread[r] = functions.softplus(heads[tint + 3, r] + query.width_bias)
            tiles.affine(networks.parameters, networks.layers[2], features, c, inputs, 0, False)
            for r in range(rows):
                along = ZERO
                for axis in range(3):
                    view[axis, r] = omega_o[base + r, axis]
                    along += normal[base + r, axis] * view[axis, r]
                cosine[r] = along
                for axis in range(3):
                    reflected[axis, r] = TWO * along * normal[base + r, axis] - view[axis, r]
            for r in range(COLUMNS):
                inputs[bottleneck, r] = cosine[r]
            raw = blocks.run(
                networks, query.factor, query.reflection, ONE, inputs, bottleneck + 1, 0, first, second
            )
            for r in range(COLUMNS):
                factor[r] = functions.sigmoid(raw[0, r] + query.factor_bias)
            _encode_lobe(
                reflected, spread, directional, networks, (real, imaginary), chebyshev, along_z,
                inputs, bottleneck,
            )  # fmt: skip
            num_inputs = lobe
            if query.view_frequencies >= 0:
                blocks.copy_rows(view, 0, 0, 3, inputs, lobe)
                blocks.encode_frequencies(inputs, lobe, 3, query.view_frequencies)
                num_inputs += 3 + 6 * query.view_frequencies
            raw = blocks.run(networks, query.reflection, query.end, ONE, inputs, num_inputs, 0, first, second)
            for axis in range(3):
                for r in range(rows):
                    row = axis + (3 * light[base + r] if num_lights > 1 else 0)
                    value[r] = raw[row, r] - ONE
                for r in range(rows):
                    sent = functions.sigmoid(heads[tint + axis, r]) * factor[r] * functions.softplus(value[r])
                    specular[base + r, axis] = query.most if sent > query.most else sent


@compiled()
def normals(begin, end, positions, hidden, has_grid, table, parameters, inverse_radius, widest, normal):
    """Write unit normals [point, 3]; `table` and `parameters` are `Grid` and `Networks` as plain tuples.

    Without a grid the only layer is the head.
    """
    grid, networks = Grid(*table), Networks(*parameters)
    num_encoded = grid.counts.shape[0] * grid.table.shape[1] if has_grid else 0
    num_inputs = num_encoded + hidden.shape[1]
    features = np.zeros((num_inputs, POINTS), np.float32)
    contracted, voxels = np.zeros((3, POINTS), np.float32), lookup.voxels_of(POINTS)
    first, second = np.zeros((2, widest, COLUMNS), np.float32)
    for start in range(begin, end, POINTS):
        size = min(POINTS, end - start)
        _read_points(positions, hidden, start, size, inverse_radius, contracted, features, num_encoded)
        if has_grid:
            lookup.encode(contracted, size, grid, voxels, features, 0)
        for c in range(0, size, COLUMNS):
            raw = blocks.run(networks, 0, len(networks.layers), ONE, features, num_inputs, c, first, second)
            for r in range(min(COLUMNS, size - c)):
                x, y, z = raw[0, r], raw[1, r], raw[2, r]
                length = math.sqrt(x * x + y * y + z * z)
                inverse = -ONE / (np.float32(1e-8) if length < np.float32(1e-8) else length)
                point = normal[start + c + r]
                point[0], point[1], point[2] = inverse * x, inverse * y, inverse * z
