"""The bundle's networks without a graph runtime, from the same weights.

Reads the tensors that the manifest places in models/weights.bin, and the constants that the graphs carry
as metadata under `lambent.network`. It knows the networks `gbuffer` and `material`, v1 and v2, and
`fast_cache.v1`; for any other the graphs are run by onnxruntime. Answers equal the graphs' within 1e-5.
Source: supplement 2.1 (fast cache), 2.2 and 2.6; docs/reference/bundle-format.md.
"""

from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np

from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.graphs import (
    AdaptedHits,
    PointMaterials,
    PrimaryHits,
    Rows,
    SecondaryHits,
    available_threads,
    in_threads,
    output_widths,
)
from lambent_relight.fused import kernels
from lambent_relight.fused.fields import SurfaceFields
from lambent_relight.fused.gbuffer import FusedGbuffer
from lambent_relight.fused.weights import (
    NotFused,
    Weights,
    chained,
    graph_constants,
    run_layers,
)

T = TypeVar("T")

_RAYS_PER_TASK = 4096
_CAMERA_RAYS_PER_TASK = 256


class FusedFastCache:
    """Opacity and distance of secondary rays."""

    def __init__(self, bundle: Bundle, weights: Weights) -> None:
        """Collect the network; raises NotFused when the bundle has another one."""
        names = ("contraction_radius", "near", "far", "num_frequencies", "curve_power", "curve_premultiplier")
        constants = graph_constants(bundle, bundle.graph_path("fast_cache"), "fast_cache.v1", names)
        self._radius = np.float32(constants["contraction_radius"])
        self._num_frequencies = int(constants["num_frequencies"])
        near, far, power, premultiplier = (float(constants[name]) for name in names[1:3] + names[4:])
        if not self._radius > 0.0 or not 0 <= self._num_frequencies <= 16 or power in (0.0, 1.0):
            raise NotFused("the fast cache's constants are out of range")
        self._far, self._ladder = np.float32(far), kernels.distance_ladder(near, far, power, premultiplier)
        if not np.isfinite(self._ladder).all():
            raise NotFused("the fast cache's distances are not finite")
        self._grid = weights.grid("fast.distance_grid")
        self._code = weights.layers("fast.code.layers")
        self._network = weights.layers("fast.distance_network.layers")
        heads = [f"fast.{name}_head" for name in ("offset", "gate", "logit", "opacity")]
        self._head = weights.layer(*heads)
        self._num_samples = len(weights.tensor("fast.logit_head.bias"))
        self._num_encoded = 3 + 6 * self._num_frequencies
        self._num_code, _ = chained(self._code, self._grid.num_outputs)
        num_inputs = self._num_code + 2 * self._num_encoded
        last, self._skip = chained(self._network, num_inputs, may_skip=True)
        if self._head.weight.shape != (3 * self._num_samples + 1, last) or self._num_samples < 2:
            raise NotFused("the fast cache's heads have another shape")

    def __call__(self, origin: Rows, direction: Rows, out: SecondaryHits) -> None:
        """Write the hits of rays [row, 3]."""
        for _ in self.placed(origin, direction, out):
            pass

    def placed(
        self, origin: Rows, direction: Rows, out: SecondaryHits
    ) -> Iterator[tuple[slice, int, Rows, Rows]]:
        """Write the hits of rays [row, 3] block by block, and yield the samples of each block.

        Yields its rows, their number, and distances and weights [sample, BLOCK], which are used again.
        """
        inputs = np.zeros((self._num_code + 2 * self._num_encoded, kernels.BLOCK), np.float32)
        places, weights = np.zeros((2, self._num_samples, kernels.BLOCK), np.float32)
        for part, points, count in kernels.blocks(origin):
            vectors = np.zeros_like(points)
            vectors[:, :count] = direction[part].T
            kernels.contract_block(points, count, self._radius)
            inputs[: self._num_code] = run_layers(self._code, self._grid.encode(points, count))
            middle = self._num_code + self._num_encoded
            kernels.encode_frequencies(points, count, self._num_frequencies, inputs, self._num_code)
            kernels.encode_frequencies(vectors, count, self._num_frequencies, inputs, middle)
            last = run_layers(self._network, inputs, self._skip)
            raw = run_layers([self._head], last, relu=False)
            kernels.place_samples(
                raw,
                count,
                self._ladder,
                self._far,
                out.opacity,
                out.distance,
                part.start,
                places,
                weights,
            )
            yield part, count, places, weights


class FusedAdaptedCache:
    """Opacity, distance and radiance of secondary rays in the light that a cache was adapted to."""

    def __init__(self, bundle: Bundle, weights: Weights, light: str) -> None:
        """Collect the network; raises NotFused when the bundle has another one."""
        self._geometry = FusedFastCache(bundle, weights)
        path = bundle.graph_path("fast_cache", light)
        constants = graph_constants(bundle, path, "fast_cache.v1", ("contraction_radius", "colour_bias"))
        self._radius = np.float32(constants["contraction_radius"])
        self._bias = np.float32(constants["colour_bias"])
        prefix = f"adapted.{light}"
        self._grid = weights.grid(f"{prefix}.feature_grid")
        self._decoder = weights.layers(f"{prefix}.decoder")
        self._head = weights.layer(f"{prefix}.decoder_head")
        width, _ = chained(self._decoder, self._grid.num_outputs)
        if self._head.weight.shape != (3, width):
            raise NotFused("the adapted cache's head has another shape")

    def __call__(self, origin: Rows, direction: Rows, out: AdaptedHits) -> None:
        """Write the hits and radiance of rays [row, 3]."""
        for part, count, places, weights in self._geometry.placed(origin, direction, out):
            origins, directions, points = np.zeros((3, 3, kernels.BLOCK), np.float32)
            origins[:, :count], directions[:, :count] = origin[part].T, direction[part].T
            mixed = np.zeros((self._grid.num_outputs, kernels.BLOCK), np.float32)
            for place, weight in zip(places, weights, strict=True):
                kernels.points_along(origins, directions, place, count, points)
                kernels.contract_block(points, count, self._radius)
                kernels.add_weighted(self._grid.encode(points, count), weight, mixed)
            colour = run_layers([self._head], run_layers(self._decoder, mixed), relu=False)
            colour += self._bias
            kernels.softplus(colour, np.float32(1.0))
            out.radiance[part] = out.opacity[part] * colour[:, :count].T


class FusedMaterials:
    """Materials and normals of points."""

    def __init__(self, bundle: Bundle, weights: Weights) -> None:
        """Collect the networks; raises NotFused when the bundle has others."""
        self._fields = SurfaceFields(bundle, weights, "material")

    def __call__(self, position: Rows, out: PointMaterials) -> None:
        """Write the surface at points [row, 3]."""
        for part, points, count in kernels.blocks(position):
            self._fields.contract(points, count)
            hidden, _ = self._fields.density(points, count)
            values = self._fields.materials(points, count)[:, :count].T
            out.albedo[part] = values[:, 0:3]
            out.perceptual_roughness[part], out.metalness[part] = values[:, 3:4], values[:, 4:5]
            out.normal[part] = self._fields.normal(points, count, hidden)[:, :count].T


class FusedCaches:
    """The bundle's three functions, answered by compiled code."""

    name = "fused"

    def __init__(self, bundle: Bundle, *, num_threads: int | None = None) -> None:
        """Collect the networks of `bundle`; raises NotFused, with the reason, when they are not known."""
        weights = Weights(bundle)
        self._bundle, self._weights = bundle, weights
        self._adapted: dict[str, FusedAdaptedCache] = {}
        self._fast = FusedFastCache(bundle, weights)
        self._materials = FusedMaterials(bundle, weights)
        self._gbuffer = FusedGbuffer(bundle, weights)
        self._threads = num_threads or available_threads()

    def gbuffer(self, origin: Rows, direction: Rows) -> PrimaryHits:
        """Return the surfaces hit by camera rays [ray, 3]."""
        return self._run(PrimaryHits, self._gbuffer, _CAMERA_RAYS_PER_TASK, origin, direction)

    def secondary(self, origin: Rows, direction: Rows) -> SecondaryHits:
        """Return the hits of rays [ray, 3] from offset surface points."""
        return self._run(SecondaryHits, self._fast, _RAYS_PER_TASK, origin, direction)

    def adapted(self, light: str, origin: Rows, direction: Rows) -> AdaptedHits:
        """Return hits and radiance of rays [ray, 3] from the cache adapted to `light`."""
        if light not in self._adapted:
            self._adapted[light] = FusedAdaptedCache(self._bundle, self._weights, light)
        return self._run(AdaptedHits, self._adapted[light], _RAYS_PER_TASK, origin, direction)

    def material(self, position: Rows) -> PointMaterials:
        """Return the surface properties at points [point, 3]."""
        return self._run(PointMaterials, self._materials, _RAYS_PER_TASK, position)

    def _run(self, kind: type[T], function: Callable[..., None], rows_per_task: int, *arrays: Rows) -> T:
        count = len(arrays[0])
        arrays = tuple(np.ascontiguousarray(array, np.float32) for array in arrays)
        found = {name: np.zeros((count, width), np.float32) for name, width in output_widths(kind).items()}

        def task(start: int) -> None:
            rows = slice(start, start + rows_per_task)
            function(*(array[rows] for array in arrays), kind(**{k: v[rows] for k, v in found.items()}))

        in_threads(task, range(0, count, rows_per_task), self._threads)
        return kind(**found)
