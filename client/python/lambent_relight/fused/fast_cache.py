"""The fast cache as compiled code: opacity and distance of secondary rays, and their radiance once adapted.

Source: supplement 2.1; docs/reference/bundle-format.md (fast cache).
"""

from typing import NamedTuple

import numpy as np
from lambent_compute import blocks
from lambent_compute.compiling import compiled, inlined
from lambent_compute.functions import softplus

from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.graphs import AdaptedHits, Rows, SecondaryHits
from lambent_relight.fused import grids, kernels
from lambent_relight.fused.kernels import BLOCK, STRIDE
from lambent_relight.fused.networks import Network, run_head, run_network, work_space
from lambent_relight.fused.weights import NotFused, Weights, chained, graph_constants


class _Distances(NamedTuple):
    """What places samples along rays."""

    radius: np.float32
    far: np.float32
    ladder: Rows
    num_frequencies: int
    num_samples: int
    num_code: int
    grid: grids.Grid
    code: Network
    network: Network
    head: Network


class _Colours(NamedTuple):
    """What turns samples along rays into radiance."""

    radius: np.float32
    bias: np.float32
    grid: grids.Grid
    decoder: Network
    head: Network


@inlined()
def _place(cache, origins, directions, first, count, space, opacity, distance, places, weights):
    """Write the hits of a block of rays, and the distances and weights of its samples [sample, STRIDE]."""
    points, vectors, features, inputs, raw, work = space
    kernels.load_rows(origins, first, count, points)
    kernels.load_rows(directions, first, count, vectors)
    kernels.contract_block(points, cache.radius)
    grids.encode(cache.grid, points, count, features)
    blocks.copy_rows(run_network(cache.code, features, work), 0, 0, cache.num_code, inputs, 0)
    middle = cache.num_code + 3 + 6 * cache.num_frequencies
    blocks.copy_rows(points, 0, 0, 3, inputs, cache.num_code)
    blocks.copy_rows(vectors, 0, 0, 3, inputs, middle)
    blocks.encode_frequencies(inputs, cache.num_code, 3, cache.num_frequencies)
    blocks.encode_frequencies(inputs, middle, 3, cache.num_frequencies)
    run_head(cache.head, run_network(cache.network, inputs, work), raw)
    kernels.place_samples(raw, count, cache.ladder, cache.far, opacity, distance, first, places, weights)


@inlined()
def _space(cache, work):
    """Return room for the values of a block of rays."""
    num_inputs = cache.num_code + 2 * (3 + 6 * cache.num_frequencies)
    return (
        np.zeros((3, STRIDE), np.float32),
        np.zeros((3, STRIDE), np.float32),
        np.zeros((len(cache.grid.levels) * cache.grid.table.shape[1], STRIDE), np.float32),
        np.zeros((num_inputs, STRIDE), np.float32),
        np.zeros((3 * cache.num_samples + 1, STRIDE), np.float32),
        work,
    )


@compiled()
def _secondary_rays(cache, origins, directions, work, opacity, distance):
    """Write the hits of rays [row, 3] to `opacity` and `distance` [row, 1]."""
    space = _space(cache, work)
    places = np.zeros((cache.num_samples, STRIDE), np.float32)
    weights = np.zeros((cache.num_samples, STRIDE), np.float32)
    for first in range(0, len(origins), BLOCK):
        count = min(BLOCK, len(origins) - first)
        _place(cache, origins, directions, first, count, space, opacity, distance, places, weights)


@compiled()
def _adapted_rays(cache, colours, origins, directions, work, opacity, distance, radiance):
    """Write the hits and the radiance [row, 3] of rays [row, 3]."""
    space = _space(cache, work)
    starts, vectors = np.zeros((3, STRIDE), np.float32), np.zeros((3, STRIDE), np.float32)
    points = np.zeros((3, STRIDE), np.float32)
    places = np.zeros((cache.num_samples, STRIDE), np.float32)
    weights = np.zeros((cache.num_samples, STRIDE), np.float32)
    num_features = len(colours.grid.levels) * colours.grid.table.shape[1]
    features = np.zeros((num_features, STRIDE), np.float32)
    mixed = np.zeros((num_features, STRIDE), np.float32)
    raw = np.zeros((3, STRIDE), np.float32)
    for first in range(0, len(origins), BLOCK):
        count = min(BLOCK, len(origins) - first)
        _place(cache, origins, directions, first, count, space, opacity, distance, places, weights)
        kernels.load_rows(origins, first, count, starts)
        kernels.load_rows(directions, first, count, vectors)
        mixed.fill(np.float32(0.0))
        for k in range(cache.num_samples):
            kernels.points_along(starts, vectors, places[k], count, points)
            kernels.contract_block(points, colours.radius)
            grids.encode(colours.grid, points, count, features)
            kernels.add_weighted(features, weights[k], mixed)
        run_head(colours.head, run_network(colours.decoder, mixed, work), raw)
        for axis in range(3):
            for r in range(BLOCK):
                raw[axis, r] = softplus(raw[axis, r] + colours.bias)
        for r in range(count):
            for axis in range(3):
                radiance[first + r, axis] = opacity[first + r, 0] * raw[axis, r]


class FusedFastCache:
    """Opacity and distance of secondary rays."""

    def __init__(self, bundle: Bundle, weights: Weights) -> None:
        """Collect the network; raises NotFused when the bundle has another one."""
        names = ("contraction_radius", "near", "far", "num_frequencies", "curve_power", "curve_premultiplier")
        constants = graph_constants(bundle, bundle.graph_path("fast_cache"), "fast_cache.v1", names)
        radius, num_frequencies = (
            np.float32(constants["contraction_radius"]),
            int(constants["num_frequencies"]),
        )
        near, far, power, premultiplier = (float(constants[name]) for name in names[1:3] + names[4:])
        if not radius > 0.0 or not 0 <= num_frequencies <= 16 or power in (0.0, 1.0):
            raise NotFused("the fast cache's constants are out of range")
        ladder = kernels.distance_ladder(near, far, power, premultiplier)
        if not np.isfinite(ladder).all():
            raise NotFused("the fast cache's distances are not finite")
        grid = weights.grid("fast.distance_grid")
        code, network = weights.layers("fast.code.layers"), weights.layers("fast.distance_network.layers")
        head = weights.layer(*(f"fast.{name}_head" for name in ("offset", "gate", "logit", "opacity")))
        num_samples = len(weights.tensor("fast.logit_head.bias"))
        num_code, _ = chained(code, grid.num_outputs)
        last, skip = chained(network, num_code + 2 * (3 + 6 * num_frequencies), may_skip=True)
        if head.weight.shape != (3 * num_samples + 1, last) or num_samples < 2:
            raise NotFused("the fast cache's heads have another shape")
        self.distances = _Distances(
            radius=radius,
            far=np.float32(far),
            ladder=ladder,
            num_frequencies=num_frequencies,
            num_samples=num_samples,
            num_code=num_code,
            grid=grid,
            code=Network.of(code),
            network=Network.of(network, skip=skip),
            head=Network.head(head),
        )
        self._work = work_space(self.distances.code, self.distances.network).shape

    def __call__(self, origin: Rows, direction: Rows, out: SecondaryHits) -> None:
        """Write the hits of rays [row, 3]."""
        work = np.zeros(self._work, np.float32)
        _secondary_rays(self.distances, origin, direction, work, out.opacity, out.distance)


class FusedAdaptedCache:
    """Opacity, distance and radiance of secondary rays in the light that a cache was adapted to."""

    def __init__(self, bundle: Bundle, weights: Weights, light: str) -> None:
        """Collect the network; raises NotFused when the bundle has another one."""
        self._distances = FusedFastCache(bundle, weights).distances
        path = bundle.graph_path("fast_cache", light)
        constants = graph_constants(bundle, path, "fast_cache.v1", ("contraction_radius", "colour_bias"))
        prefix = f"adapted.{light}"
        grid, decoder = weights.grid(f"{prefix}.feature_grid"), weights.layers(f"{prefix}.decoder")
        head = weights.layer(f"{prefix}.decoder_head")
        width, _ = chained(decoder, grid.num_outputs)
        if head.weight.shape != (3, width):
            raise NotFused("the adapted cache's head has another shape")
        self._colours = _Colours(
            radius=np.float32(constants["contraction_radius"]),
            bias=np.float32(constants["colour_bias"]),
            grid=grid,
            decoder=Network.of(decoder),
            head=Network.head(head),
        )
        networks = (self._distances.code, self._distances.network, self._colours.decoder)
        self._work = work_space(*networks).shape

    def __call__(self, origin: Rows, direction: Rows, out: AdaptedHits) -> None:
        """Write the hits and radiance of rays [row, 3]."""
        work = np.zeros(self._work, np.float32)
        _adapted_rays(
            self._distances, self._colours, origin, direction, work, out.opacity, out.distance, out.radiance
        )
