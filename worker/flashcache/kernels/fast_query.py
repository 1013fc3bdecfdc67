"""The fast cache's answers as one compiled function, a block of rays after another; no gradients.

Source: supplement 2.1, as `flashcache.caches.fast_cache.FastCache`.
"""

from typing import NamedTuple

import numpy as np
from lambent_compute import blocks, functions
from lambent_compute.blocks import Networks
from lambent_compute.compiling import compiled
from lambent_compute.tiles import COLUMNS

from flashcache.kernels import lookup

RAYS = 128
"""Rays of a block: their features stay in the core's own cache while the levels of a grid pass by."""

HALF, ONE, TWO = np.float32(0.5), np.float32(1.0), np.float32(2.0)


class FastQuery(NamedTuple):
    """What the function reads of a fast cache besides the two grids and the networks.

    Layers are those of the code, of the distance network, of its head, of the decoder and of its head.
    """

    num_code: int
    """Layers of the code."""
    num_distance: int
    """Layers of the distance network."""
    num_samples: int
    num_lights: int
    position_frequencies: int
    direction_frequencies: int
    inverse_radius: np.float32
    colour_bias: np.float32
    far: np.float32
    start: np.float32
    """Ladder coordinate of the near end."""
    length: np.float32
    """Ladder coordinate of the far end, from there."""
    ladder: tuple[np.float32, np.float32, np.float32]
    """a / premultiplier, power / a and 1 / power of the curve of distances, with a = |power - 1|."""
    widest: int
    """Rows of a tile that holds any layer's inputs or outputs."""
    least_opacity: np.float32


@compiled()
def answer(
    begin, end, origins, directions, light, distance_table, feature_table, parameters, settings,
    radiance, opacity, distance,
):  # fmt: skip
    """Write the answers to the rays `begin` to `end`: the results of `FastCache.forward`.

    The four arguments after `light` are two `Grid`, `Networks` and `FastQuery` as plain tuples.
    """
    distance_grid, feature_grid = lookup.Grid(*distance_table), lookup.Grid(*feature_table)
    networks, query = Networks(*parameters), FastQuery(*settings)
    count = query.num_samples
    head = query.num_code + query.num_distance
    decoder, colours = head + 1, head + 3
    num_features = feature_grid.counts.shape[0] * feature_grid.table.shape[1]
    num_coded = distance_grid.counts.shape[0] * distance_grid.table.shape[1]
    num_code = networks.layers[query.num_code - 1, 3] if query.num_code else num_coded
    at_directions = num_code + 3 + 6 * query.position_frequencies
    num_encoded = at_directions + 3 + 6 * query.direction_frequencies
    part = ONE / np.float32(count)
    scale, slope, exponent = query.ladder

    # Memory for a block of rays, as [row, ray]; `t` and `w` are the distances and weights of its samples.
    rays = np.zeros((6, RAYS), np.float32)
    contracted = np.zeros((3, RAYS), np.float32)
    voxels = lookup.voxels_of(RAYS * count)
    codes = np.zeros((num_coded, RAYS), np.float32)
    points = np.zeros((3, RAYS * count), np.float32)
    features = np.zeros((num_features, RAYS * count), np.float32)
    t, w = np.zeros((count, RAYS), np.float32), np.zeros((count, RAYS), np.float32)
    # Memory for a tile of it: a network's inputs, and its layers' outputs, which alternate between two.
    inputs = np.zeros((query.widest, COLUMNS), np.float32)
    even_layers, odd_layers = np.zeros_like(inputs), np.zeros_like(inputs)
    largest, total, seen, moment, value = np.zeros((5, COLUMNS), np.float32)
    for start in range(begin, end, RAYS):
        size = min(RAYS, end - start)
        # Points lie sample after sample.
        stride = blocks.whole_tiles(size)
        for r in range(size):
            for axis in range(3):
                rays[axis, r] = origins[start + r, axis]
                rays[3 + axis, r] = directions[start + r, axis]

        # 1. One look-up of the distance grid at each origin.
        for r in range(size):
            contracted[0, r], contracted[1, r], contracted[2, r] = blocks.contract(
                rays[0, r], rays[1, r], rays[2, r], query.inverse_radius
            )
        lookup.encode(contracted, size, distance_grid, voxels, codes, 0)
        for c in range(0, size, COLUMNS):
            rows = min(COLUMNS, size - c)

            # 2. The distance network sees the code of that, the origin and the direction. Its outputs are
            # `count` offsets, gates and logits each, and the opacity.
            code = blocks.run(networks, 0, query.num_code, ONE, codes, num_coded, c, even_layers, odd_layers)
            if query.num_code == 0:
                blocks.copy_rows(codes, c, 0, num_coded, inputs, 0)
            else:
                blocks.copy_rows(code, 0, 0, num_code, inputs, 0)
            blocks.copy_rows(contracted, c, 0, 3, inputs, num_code)
            blocks.copy_rows(rays, c, 3, 3, inputs, at_directions)
            blocks.encode_frequencies(inputs, num_code, 3, query.position_frequencies)
            blocks.encode_frequencies(inputs, at_directions, 3, query.direction_frequencies)
            raw = blocks.run(
                networks, query.num_code, head + 1, ONE, inputs, num_encoded, 0, even_layers, odd_layers
            )

            # 3. Weights are a softmax of the logits times the opacity: first the largest logit, so that no
            # exponential overflows, then the exponentials with their total.
            for r in range(COLUMNS):
                most = raw[2 * count, r]
                for k in range(1, count):
                    most = raw[2 * count + k, r] if raw[2 * count + k, r] > most else most
                largest[r] = most
                total[r] = np.float32(0.0)
            for k in range(count):
                even = np.float32(k) / np.float32(count - 1)
                for r in range(COLUMNS):
                    share = functions.exponential(raw[2 * count + k, r] - largest[r])
                    w[k, c + r] = share
                    total[r] += share
                    # 4. Places are spread evenly over the ray, shifted by their gated offsets and folded back
                    # into [0, 1]; the ladder makes distances of them (`FastCache._sample_distances`).
                    shifted = even + raw[k, r] * part * functions.sigmoid(raw[count + k, r] - TWO)
                    whole = np.floor(shifted)
                    rest = shifted - whole
                    odd = whole - TWO * np.floor(whole * HALF)
                    y = query.start + query.length * (rest + odd * (ONE - TWO * rest))
                    t[k, c + r] = scale * (functions.power(slope * y + ONE, exponent) - ONE)
            for r in range(COLUMNS):
                seen[r] = functions.sigmoid(raw[3 * count, r] + TWO)
                total[r] = seen[r] / total[r]
                moment[r] = np.float32(0.0)
            for k in range(count):
                for r in range(COLUMNS):
                    w[k, c + r] *= total[r]
                    moment[r] += w[k, c + r] * t[k, c + r]

            # 5. Opacity, and the mean distance over the weights.
            for r in range(rows):
                hit = seen[r] >= query.least_opacity
                opacity[start + c + r] = seen[r]
                distance[start + c + r] = moment[r] / seen[r] if hit else query.far

        # 6. One look-up of the feature grid at each sample.
        for k in range(count):
            for r in range(size):
                i = k * stride + r
                points[0, i], points[1, i], points[2, i] = blocks.contract(
                    rays[0, r] + t[k, r] * rays[3, r],
                    rays[1, r] + t[k, r] * rays[4, r],
                    rays[2, r] + t[k, r] * rays[5, r],
                    query.inverse_radius,
                )
        lookup.encode(points, stride * count, feature_grid, voxels, features, 0)
        for c in range(0, size, COLUMNS):
            rows = min(COLUMNS, size - c)

            # 7. The decoder sees the weighted sum of a ray's features, and answers for every light: that of
            # the ray is picked. Colour times opacity makes empty rays black.
            for f in range(num_features):
                for r in range(COLUMNS):
                    inputs[f, r] = np.float32(0.0)
                for k in range(count):
                    for r in range(COLUMNS):
                        inputs[f, r] += w[k, c + r] * features[f, k * stride + c + r]
            raw = blocks.run(
                networks, decoder, colours + 1, ONE, inputs, num_features, 0, even_layers, odd_layers
            )
            for axis in range(3):
                for r in range(rows):
                    row = axis + (3 * light[start + c + r] if query.num_lights > 1 else 0)
                    value[r] = raw[row, r] + query.colour_bias
                for r in range(rows):
                    radiance[start + c + r, axis] = opacity[start + c + r] * functions.softplus(value[r])
