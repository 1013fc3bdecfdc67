"""Density, normal and material networks, evaluated a block of contracted points at a time.

Source: supplement 2.2 (density, predicted normals) and 2.6 (materials); docs/reference/bundle-format.md.
"""

import numpy as np

from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.graphs import Rows
from lambent_relight.fused import kernels
from lambent_relight.fused.weights import NotFused, Weights, chained, graph_constants, run_layers

CONSTANTS = ("contraction_radius", "density_bias", "albedo_bias", "alpha_bias", "metalness_bias")
CONSTANTS += ("alpha_minimum",)
OCCUPANCY_BOX = ("occupancy_min", "occupancy_max")


class SurfaceFields:
    """Density, normals and materials at points, with the constants of one of the bundle's graphs."""

    def __init__(self, bundle: Bundle, weights: Weights, graph: str, extra: tuple[str, ...] = ()):
        """Collect the networks; raises NotFused when the bundle has others."""
        path = bundle.graph_path(graph)
        self._occupancy, box, kind = None, (), f"{graph}.v1"
        if "nerf.occupancy.table" in weights:
            self._occupancy, box, kind = weights.grid("nerf.occupancy"), OCCUPANCY_BOX, f"{graph}.v2"
        self.constants = graph_constants(bundle, path, kind, CONSTANTS + box + extra, ("softplus_beta",))
        if self._occupancy is not None:
            low, high = (np.asarray(self.constants[name], np.float32) for name in box)
            self._box_half = np.float32(0.5) * (high - low)
            self._box_middle = low + self._box_half
            if low.shape != (3,) or not (self._box_half > 0.0).all() or self._occupancy.num_outputs != 1:
                raise NotFused("the occupancy's box or grid is not understood")
        self._radius = np.float32(self.constants["contraction_radius"])
        self._sharpness = self.constants["softplus_beta"]
        if not self._radius > 0.0 or self._sharpness == 0.0:
            raise NotFused("contraction_radius and softplus_beta must be positive")
        self._density_grid = weights.grid("nerf.density.grid")
        self._density = weights.layers("nerf.density.network.layers")
        self._density_head = weights.layer("nerf.density.head")
        hidden, _ = chained(self._density, self._density_grid.num_outputs)
        self._normal_head = weights.layer("nerf.normals.head")
        self._normal_grid, self._normal_network = None, []
        width = hidden
        if "nerf.normals.grid.table" in weights:
            self._normal_grid = weights.grid("nerf.normals.grid")
            self._normal_network = weights.layers("nerf.normals.network.layers")
            width, _ = chained(self._normal_network, self._normal_grid.num_outputs + hidden)
        self._material_grid = weights.grid("materials.grid")
        self._materials = weights.layer("materials.albedo", "materials.alpha", "materials.metalness")
        shapes = [layer.weight.shape for layer in (self._density_head, self._normal_head, self._materials)]
        if shapes != [(1, hidden), (3, width), (5, self._material_grid.num_outputs)]:
            raise NotFused(f"the heads have the shapes {shapes}")

    def occupied(self, points: Rows, count: int) -> Rows | None:
        """Return the factor on the density at world `points` [3, block], or None where it is 1 everywhere."""
        if self._occupancy is None:
            return None
        places = (points - self._box_middle[:, None]) / self._box_half[:, None]
        return self._occupancy.encode(places, count)[0]

    def contract(self, points: Rows, count: int) -> Rows:
        """Replace world `points` [3, block] by contracted coordinates, and return them."""
        kernels.contract_block(points, count, self._radius)
        return points

    def density(self, points: Rows, count: int) -> tuple[Rows, Rows]:
        """Return the hidden feature [width, block] and density [block], 1/scene unit, at contracted points.

        The density is not multiplied by `occupied` yet.
        """
        hidden = self._density_grid.encode(points, count)
        for layer in self._density:
            hidden = run_layers([layer], hidden, relu=self._sharpness is None)
            if self._sharpness is not None:
                kernels.softplus(hidden, np.float32(self._sharpness))
        raw = run_layers([self._density_head], hidden, relu=False)[0]
        return hidden, np.exp(np.minimum(raw + np.float32(self.constants["density_bias"]), np.float32(70.0)))

    def normal(self, points: Rows, count: int, hidden: Rows) -> Rows:
        """Return predicted unit normals [3, block] from the density's hidden feature."""
        if self._normal_grid is not None:
            hidden = run_layers(
                self._normal_network, np.concatenate([self._normal_grid.encode(points, count), hidden])
            )
        raw = run_layers([self._normal_head], hidden, relu=False)
        return -raw / np.maximum(np.sqrt((raw * raw).sum(axis=0)), np.float32(1e-8))

    def materials(self, points: Rows, count: int) -> Rows:
        """Return albedo (3), perceptual roughness and metalness as [5, block]."""
        raw = run_layers([self._materials], self._material_grid.encode(points, count), relu=False)
        names = ("albedo_bias",) * 3 + ("alpha_bias", "metalness_bias")
        raw += np.array([self.constants[name] for name in names], np.float32)[:, None]
        values = np.float32(1.0) / (np.float32(1.0) + np.exp(-raw))
        floor = np.float32(self.constants["alpha_minimum"])
        values[3] = np.sqrt(values[3] * (np.float32(1.0) - floor) + floor)
        return values
