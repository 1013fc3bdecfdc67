"""Two rounds of proposals and the final densities along rays, a block of rays after another; no gradients.

Arrays of a block are [sample, ray]; points are numbered sample after sample. Source: supplement 2.2, as
`flashcache.volume.proposal_sampling.sample_rays` and `flashcache.volume.quadrature.render_weights`.
"""

import numpy as np
from lambent_compute import functions
from lambent_compute.blocks import Networks
from lambent_compute.compiling import compiled, inlined

from flashcache.kernels import density_query
from flashcache.kernels.density_query import Box, Density
from flashcache.kernels.lookup import Grid

RAYS = 128
"""Rays of a block: their points' features stay in the core's own cache."""

HALF, ONE, TWO, ZERO = np.float32(0.5), np.float32(1.0), np.float32(2.0), np.float32(0.0)


@inlined()
def _resample(edges, weights, count, num_new, exponent, num_rays, cdf, place, centres, new_edges):
    """Write the edges of `num_new` intervals by the `count` masses between `edges`; see `step_function`."""
    floor = np.float32(1e-5)
    for r in range(num_rays):
        cdf[0, r] = ZERO
        place[r] = 0
    for k in range(count):
        if exponent == ONE:
            for r in range(num_rays):
                cdf[k + 1, r] = cdf[k, r] + (weights[k, r] + floor)
        else:
            for r in range(num_rays):
                cdf[k + 1, r] = cdf[k, r] + functions.power(weights[k, r] + floor, exponent)
    for k in range(1, count + 1):
        for r in range(num_rays):
            cdf[k, r] /= cdf[count, r] if k < count else ONE
    for r in range(num_rays):
        cdf[count, r] = ONE
    for k in range(num_new):
        u = (np.float32(k) + HALF) / np.float32(num_new)
        for r in range(num_rays):
            j = place[r]
            while j < count - 1 and cdf[j + 1, r] <= u:
                j += 1
            place[r] = j
            width = cdf[j + 1, r] - cdf[j, r]
            share = (u - cdf[j, r]) / (width if width > np.float32(1e-12) else np.float32(1e-12))
            share = ONE if share > ONE else share
            centres[k, r] = edges[j, r] + share * (edges[j + 1, r] - edges[j, r])
    for k in range(1, num_new):
        for r in range(num_rays):
            new_edges[k, r] = HALF * (centres[k, r] + centres[k - 1, r])
    for r in range(num_rays):
        first = TWO * centres[0, r] - new_edges[1, r]
        last = TWO * centres[num_new - 1, r] - new_edges[num_new - 1, r]
        new_edges[0, r] = first if first > ZERO else ZERO
        new_edges[num_new, r] = last if last < ONE else ONE


@inlined()
def _place(edges, count, rays, ladder, num_rays, distances, middles, points):
    """Write distances of the edges, middles of the intervals and points there, for rays [8, ray]."""
    scale, slope, exponent = ladder
    for k in range(count + 1):
        for r in range(num_rays):
            y = rays[6, r] + edges[k, r] * rays[7, r]
            distances[k, r] = scale * (functions.power(slope * y + ONE, exponent) - ONE)
    for k in range(count):
        for r in range(num_rays):
            t = HALF * (distances[k + 1, r] + distances[k, r])
            middles[k, r] = t
            for axis in range(3):
                points[axis, k * num_rays + r] = rays[axis, r] + t * rays[3 + axis, r]


@inlined()
def _weigh(densities, distances, count, num_rays, before, weights):
    """Write the render weights of the intervals (paper Eq. 3)."""
    for r in range(num_rays):
        before[r] = ZERO
    for k in range(count):
        for r in range(num_rays):
            depth = densities[k * num_rays + r] * (distances[k + 1, r] - distances[k, r])
            weights[k, r] = functions.opaque_share(depth) * functions.exponential(-before[r])
            before[r] += depth


@compiled()
def sample(
    begin, end, origins, directions, starts, lengths, ladder, counts, exponent,
    tables, parameters, settings, occupancy_table, box_arrays, widest, weights, middles,
):  # fmt: skip
    """Write the final render weights [ray, sample] and the distances of the intervals' middles.

    `starts` and `lengths` [ray] are ladder coordinates of the near end, and of the far end from there;
    `ladder` has the constants of the inverse. `counts` are the numbers of samples. `tables` and
    `settings` are those of both proposals and of the density; they and the next ones are `Grid`,
    `Networks`, `Density`, `Grid` and `Box` as plain tuples.
    """
    networks = Networks(*parameters)
    occupancy, box = Grid(*occupancy_table), Box(*box_arrays)
    grids = Grid(*tables[0]), Grid(*tables[1]), Grid(*tables[2])
    queries = Density(*settings[0]), Density(*settings[1]), Density(*settings[2])
    most, num_features = 1, 1
    for level in range(3):
        most = max(most, counts[level])
        num_features = max(num_features, density_query.num_features_of(grids[level]))
    scratch = density_query.scratch_of(RAYS * most, num_features, widest)
    rays = np.zeros((8, RAYS), np.float32)
    points = np.zeros((3, RAYS * most), np.float32)
    densities = np.zeros(RAYS * most, np.float32)
    edges, other, distances, cdf = np.zeros((4, most + 2, RAYS), np.float32)
    masses, centres, between = np.zeros((3, most + 1, RAYS), np.float32)
    place, before = np.zeros(RAYS, np.int64), np.zeros(RAYS, np.float32)
    for start in range(begin, end, RAYS):
        size = min(RAYS, end - start)
        for r in range(size):
            for axis in range(3):
                rays[axis, r] = origins[start + r, axis]
                rays[3 + axis, r] = directions[start + r, axis]
            rays[6, r], rays[7, r] = starts[start + r], lengths[start + r]
            edges[0, r], edges[1, r], masses[0, r] = ZERO, ONE, ONE
        count = 1
        for level in range(3):
            _resample(edges, masses, count, counts[level], exponent, size, cdf, place, centres, other)
            edges, other, count = other, edges, counts[level]
            _place(edges, count, rays, ladder, size, distances, between, points)
            density_query.densities(
                points, count * size, grids[level], networks, queries[level], occupancy, box, scratch,
                densities,
            )  # fmt: skip
            _weigh(densities, distances, count, size, before, masses)
        for r in range(size):
            for k in range(count):
                weights[start + r, k] = masses[k, r]
                middles[start + r, k] = between[k, r]
