"""Density, normals and materials at points, as compiled code.

Source: supplement 2.2 (density, predicted normals) and 2.6 (materials); docs/reference/bundle-format.md.
"""

from typing import NamedTuple

import numpy as np
from lambent_compute import blocks
from lambent_compute.compiling import compiled, inlined
from lambent_compute.functions import exponential, sigmoid

from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.graphs import Rows
from lambent_relight.fused import grids, kernels
from lambent_relight.fused.kernels import BLOCK, STRIDE
from lambent_relight.fused.networks import Network, run_head, run_network, work_space
from lambent_relight.fused.weights import NotFused, Weights, chained, graph_constants

_BIASES = ("density_bias", "albedo_bias", "alpha_bias", "metalness_bias")
CONSTANTS = ("contraction_radius", *_BIASES, "alpha_minimum")
OCCUPANCY_BOX = ("occupancy_min", "occupancy_max")
NUM_PROPERTIES = 8
"""Normal (3), albedo (3), perceptual roughness and metalness of a point."""
_LARGEST_LOG = np.float32(70.0)


class Occupancy(NamedTuple):
    """The factor on densities: a grid over a box of the world; without levels it is 1 everywhere."""

    grid: grids.Grid
    middle: Rows
    half: Rows
    """Half the box's sides, scene units."""


class Fields(NamedTuple):
    """The networks of density, normals and materials."""

    radius: np.float32
    """Contraction radius, scene units."""
    occupancy: Occupancy
    density_grid: grids.Grid
    density: Network
    density_head: Network
    density_bias: np.float32
    normal_grid: grids.Grid
    normals: Network
    normal_head: Network
    material_grid: grids.Grid
    materials: Network
    material_bias: Rows
    alpha_minimum: np.float32

    @classmethod
    def of(
        cls, bundle: Bundle, weights: Weights, graph: str, extra: tuple[str, ...] = ()
    ) -> tuple["Fields", dict]:
        """Return the networks, and the constants of one of the bundle's graphs.

        Raises NotFused when the bundle has other networks.
        """
        occupied = "nerf.occupancy.table" in weights
        names = CONSTANTS + (OCCUPANCY_BOX if occupied else ()) + extra
        kind = f"{graph}.v2" if occupied else f"{graph}.v1"
        constants = graph_constants(bundle, bundle.graph_path(graph), kind, names, ("softplus_beta",))
        radius, sharpness = np.float32(constants["contraction_radius"]), constants["softplus_beta"]
        if not radius > 0.0 or (sharpness is not None and not sharpness > 0.0):
            raise NotFused("contraction_radius and softplus_beta must be positive")
        density_grid, density = (
            weights.grid("nerf.density.grid"),
            weights.layers("nerf.density.network.layers"),
        )
        hidden, _ = chained(density, density_grid.num_outputs)
        normal_grid, normals, width = grids.Grid.empty(), [], hidden
        if "nerf.normals.grid.table" in weights:
            normal_grid = weights.grid("nerf.normals.grid")
            normals = weights.layers("nerf.normals.network.layers")
            width, _ = chained(normals, normal_grid.num_outputs + hidden)
        material_grid = weights.grid("materials.grid")
        density_head, normal_head = weights.layer("nerf.density.head"), weights.layer("nerf.normals.head")
        materials = weights.layer("materials.albedo", "materials.alpha", "materials.metalness")
        shapes = [layer.weight.shape for layer in (density_head, normal_head, materials)]
        if shapes != [(1, hidden), (3, width), (5, material_grid.num_outputs)]:
            raise NotFused(f"the heads have the shapes {shapes}")
        bias_names = ("albedo_bias",) * 3 + ("alpha_bias", "metalness_bias")
        networks = cls(
            radius=radius,
            occupancy=_occupancy(weights, constants) if occupied else _everywhere(),
            density_grid=density_grid,
            density=Network.of(density, sharpness=sharpness or 0.0),
            density_head=Network.head(density_head),
            density_bias=np.float32(constants["density_bias"]),
            normal_grid=normal_grid,
            normals=Network.of(normals),
            normal_head=Network.head(normal_head),
            material_grid=material_grid,
            materials=Network.head(materials),
            material_bias=np.array([constants[name] for name in bias_names], np.float32),
            alpha_minimum=np.float32(constants["alpha_minimum"]),
        )
        return networks, constants

    def work(self) -> Rows:
        """Return room for the networks' activations."""
        return work_space(self.density, self.normals)


def _everywhere() -> Occupancy:
    return Occupancy(grids.Grid.empty(), np.zeros(3, np.float32), np.ones(3, np.float32))


def _occupancy(weights: Weights, constants: dict) -> Occupancy:
    grid = weights.grid("nerf.occupancy")
    low, high = (np.asarray(constants[name], np.float32) for name in OCCUPANCY_BOX)
    half = np.float32(0.5) * (high - low)
    if low.shape != (3,) or not (half > 0.0).all() or grid.num_outputs != 1:
        raise NotFused("the occupancy's box or grid is not understood")
    return Occupancy(grid, low + half, half)


@inlined()
def _shares(occupancy, points, count, places, out):
    """Write the factors on the density at world `points` [3, STRIDE] to `out` [1, STRIDE]."""
    for axis in range(3):
        for r in range(BLOCK):
            places[axis, r] = (points[axis, r] - occupancy.middle[axis]) / occupancy.half[axis]
            out[0, r] = np.float32(1.0)
    grids.encode(occupancy.grid, places, count, out)


@inlined()
def _hidden(fields, points, count, features, work):
    """Return the hidden feature [width, STRIDE] of the density at world points, which are contracted."""
    kernels.contract_block(points, fields.radius)
    grids.encode(fields.density_grid, points, count, features)
    return run_network(fields.density, features, work)


@compiled()
def densities(fields, positions, work, out):
    """Write densities [point], 1/scene unit, at world positions [point, 3]; `work` is that of `Fields.work`.

    Networks are evaluated only where the occupancy leaves something of the density.
    """
    points, places = np.zeros((3, STRIDE), np.float32), np.zeros((3, STRIDE), np.float32)
    share, raw = np.empty((1, STRIDE), np.float32), np.empty((1, STRIDE), np.float32)
    num_features = len(fields.density_grid.levels) * fields.density_grid.table.shape[1]
    features = np.zeros((num_features, STRIDE), np.float32)
    kept, factors = np.empty(2 * BLOCK, np.int64), np.empty(2 * BLOCK, np.float32)
    num_kept = np.int64(0)
    for first in range(0, len(positions), BLOCK):
        count = min(BLOCK, len(positions) - first)
        kernels.load_rows(positions, first, count, points)
        _shares(fields.occupancy, points, count, places, share)
        for r in range(count):
            out[first + r] = np.float32(0.0)
            if share[0, r] > np.float32(0.0):
                kept[num_kept], factors[num_kept] = first + r, share[0, r]
                num_kept += 1
        at_end = first + BLOCK >= len(positions)
        while num_kept >= BLOCK or (at_end and num_kept > 0):
            some = min(BLOCK, num_kept)
            for r in range(some):
                for axis in range(3):
                    points[axis, r] = positions[kept[r], axis]
            hidden = _hidden(fields, points, some, features, work)
            run_head(fields.density_head, hidden, raw)
            for r in range(BLOCK):
                raw[0, r] = exponential(min(raw[0, r] + fields.density_bias, _LARGEST_LOG))
            for r in range(some):
                out[kept[r]] = raw[0, r] * factors[r]
            num_kept -= some
            for r in range(num_kept):
                kept[r], factors[r] = kept[some + r], factors[some + r]


@compiled()
def surfaces(fields, positions, work, out):
    """Write normals and materials at world positions [point, 3] to `out` [point, NUM_PROPERTIES]."""
    points, values = np.zeros((3, STRIDE), np.float32), np.zeros((NUM_PROPERTIES, STRIDE), np.float32)
    num_features = len(fields.density_grid.levels) * fields.density_grid.table.shape[1]
    features = np.zeros((num_features, STRIDE), np.float32)
    width = fields.density_head.layers[0, 2]
    num_own = len(fields.normal_grid.levels) * fields.normal_grid.table.shape[1]
    inputs = np.zeros((num_own + width, STRIDE), np.float32)
    raw = np.zeros((fields.materials.layers[0, 2], STRIDE), np.float32)
    one = np.float32(1.0)
    for first in range(0, len(positions), BLOCK):
        count = min(BLOCK, len(positions) - first)
        kernels.load_rows(positions, first, count, points)
        blocks.copy_rows(_hidden(fields, points, count, features, work), 0, 0, width, inputs, num_own)
        grids.encode(fields.normal_grid, points, count, inputs)
        last = run_network(fields.normals, inputs, work)
        run_head(fields.normal_head, last, values)
        for r in range(BLOCK):
            x, y, z = values[0, r], values[1, r], values[2, r]
            share = -one / max(np.sqrt(x * x + y * y + z * z), np.float32(1e-8))
            values[0, r], values[1, r], values[2, r] = share * x, share * y, share * z
        grids.encode(fields.material_grid, points, count, raw)
        run_head(fields.materials, raw, values[3:])
        for k in range(3, NUM_PROPERTIES):
            for r in range(BLOCK):
                values[k, r] = sigmoid(values[k, r] + fields.material_bias[k - 3])
        for r in range(BLOCK):
            values[6, r] = np.sqrt(values[6, r] * (one - fields.alpha_minimum) + fields.alpha_minimum)
        for r in range(count):
            for k in range(NUM_PROPERTIES):
                out[first + r, k] = values[k, r]
