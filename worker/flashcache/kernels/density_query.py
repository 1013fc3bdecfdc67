"""Density networks for blocks of points; no gradients. Source: `flashcache.fields.density.DensityField`."""

from typing import NamedTuple

import numpy as np
from lambent_compute import blocks, functions, tiles
from lambent_compute.blocks import Networks
from lambent_compute.compiling import compiled, inlined
from lambent_compute.tiles import COLUMNS
from numpy.typing import NDArray

from flashcache.kernels import lookup
from flashcache.kernels.lookup import Grid, Voxels

POINTS = 1024
"""Points of a block: their features stay in the core's own cache while the levels of a grid pass by."""

LARGEST_LOGARITHM = np.float32(70.0)
ZERO = np.float32(0.0)


class Density(NamedTuple):
    """What is read of a density field besides its grid, its networks and the occupancy.

    Its layers are those from `begin` up to `end`, the head being the last of them.
    """

    begin: int
    end: int
    sharpness: np.float32
    """Of the softplus."""
    bias: np.float32
    inverse_radius: np.float32


class Box(NamedTuple):
    """The box of an occupancy; without one, all of space may hold something."""

    exists: bool
    middle: NDArray[np.float32]
    inverse_half: NDArray[np.float32]


class Scratch(NamedTuple):
    """Memory for a block of points: those that may hold something, one after another."""

    index: NDArray[np.int64]  # type: ignore[assignment]  # hides `tuple.index`
    """Their numbers among all points."""
    contracted: NDArray[np.float32]
    shares: NDArray[np.float32]
    features: NDArray[np.float32]
    voxels: Voxels
    first: NDArray[np.float32]
    second: NDArray[np.float32]
    """Outputs of the layers of a network: each of the two holds the inputs of the next layer in turn."""


@inlined()
def scratch_of(num_points, num_features, widest):
    """Return memory for blocks of `num_points`, a multiple of the columns of a tile."""
    return Scratch(
        np.zeros(num_points, np.int64),
        np.zeros((3, num_points), np.float32),
        np.zeros((1, num_points), np.float32),
        np.zeros((num_features, num_points), np.float32),
        lookup.voxels_of(num_points),
        np.zeros((widest, COLUMNS), np.float32),
        np.zeros((widest, COLUMNS), np.float32),
    )


@inlined()
def num_features_of(grid):
    """Return the number of features of a point."""
    return grid.counts.shape[0] * grid.table.shape[1]


@inlined()
def _occupied(points, count, occupancy, box, scratch):
    """Return how many of the first `count` of `points` [3, any] may hold something, and list them."""
    index, shares, contracted = scratch.index, scratch.shares, scratch.contracted
    if not box.exists:
        for i in range(count):
            index[i] = i
            shares[0, i] = np.float32(1.0)
        return count
    for axis in range(3):
        for i in range(count):
            contracted[axis, i] = (points[axis, i] - box.middle[axis]) * box.inverse_half[axis]
    lookup.encode(contracted, count, occupancy, scratch.voxels, shares, 0)
    occupied = 0
    for i in range(count):
        share = shares[0, i]
        index[occupied] = i
        shares[0, occupied] = share
        # A NaN counts.
        occupied += 0 if share == ZERO else 1
    return occupied


@inlined()
def _contract(points, count, inverse_radius):
    """Replace the first `count` of `points` [3, any] by contracted coordinates."""
    for i in range(count):
        points[0, i], points[1, i], points[2, i] = blocks.contract(
            points[0, i], points[1, i], points[2, i], inverse_radius
        )


@inlined()
def densities(points, count, grid, networks, density, occupancy, box, scratch, result):
    """Write the density [1/scene unit] at the first `count` of `points` [3, any] to `result` [any]."""
    index, contracted, shares = scratch.index, scratch.contracted, scratch.shares
    occupied = _occupied(points, count, occupancy, box, scratch)
    for i in range(count):
        result[i] = ZERO
    for j in range(occupied):
        for axis in range(3):
            contracted[axis, j] = points[axis, index[j]]
    _contract(contracted, occupied, density.inverse_radius)
    lookup.encode(contracted, occupied, grid, scratch.voxels, scratch.features, 0)
    inputs = num_features_of(grid)
    for c in range(0, occupied, COLUMNS):
        raw = blocks.run(
            networks, density.begin, density.end, density.sharpness,
            scratch.features, inputs, c, scratch.first, scratch.second,
        )  # fmt: skip
        for r in range(COLUMNS):
            raw[0, r] = of_raw(raw[0, r], density.bias)
        for r in range(min(COLUMNS, occupied - c)):
            result[index[c + r]] = shares[0, c + r] * raw[0, r]


@inlined()
def of_raw(raw, bias):
    """Return the density for a network's raw output."""
    logarithm = raw + bias
    return functions.exponential(LARGEST_LOGARITHM if logarithm > LARGEST_LOGARITHM else logarithm)


@compiled()
def samples(
    begin,
    end,
    positions,
    table,
    parameters,
    settings,
    occupancy_table,
    box_arrays,
    widest,
    density,
    hidden,
):
    """Write density [point] and hidden feature [point, width] at `positions` [point, 3].

    The arguments from `table` to `box_arrays` are `Grid`, `Networks`, `Density`, `Grid` and `Box` as
    plain tuples.
    """
    grid, networks, query = Grid(*table), Networks(*parameters), Density(*settings)
    occupancy, box = Grid(*occupancy_table), Box(*box_arrays)
    num_features, width = num_features_of(grid), hidden.shape[1]
    scratch = scratch_of(POINTS, num_features, widest)
    points, shares = np.zeros((3, POINTS), np.float32), np.zeros((1, POINTS), np.float32)
    contracted = scratch.contracted
    for start in range(begin, end, POINTS):
        size = min(POINTS, end - start)
        for i in range(size):
            for axis in range(3):
                points[axis, i] = positions[start + i, axis]
            shares[0, i] = np.float32(1.0)
        if box.exists:
            for axis in range(3):
                for i in range(size):
                    contracted[axis, i] = (points[axis, i] - box.middle[axis]) * box.inverse_half[axis]
            lookup.encode(contracted, size, occupancy, scratch.voxels, shares, 0)
        for axis in range(3):
            for i in range(size):
                contracted[axis, i] = points[axis, i]
        _contract(contracted, size, query.inverse_radius)
        lookup.encode(contracted, size, grid, scratch.voxels, scratch.features, 0)
        for c in range(0, size, COLUMNS):
            rows = min(COLUMNS, size - c)
            last = blocks.run(
                networks, query.begin, query.end - 1, query.sharpness,
                scratch.features, num_features, c, scratch.first, scratch.second,
            )  # fmt: skip
            for r in range(rows):
                for f in range(width):
                    hidden[start + c + r, f] = last[f, r]
            head = networks.layers[query.end - 1]
            tiles.affine(networks.parameters, head, last, 0, points, 0, False)
            for r in range(rows):
                density[start + c + r] = shares[0, c + r] * of_raw(points[0, r], query.bias)
