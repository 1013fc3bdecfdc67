"""The bundle's networks without a graph runtime, from the same weights.

Reads the tensors that the manifest places in models/weights.bin, and the constants that the graphs carry
as metadata under `lambent.network`. It knows the networks `gbuffer` and `material`, v1 and v2, and
`fast_cache.v1`; for any other the graphs are run by onnxruntime. Answers equal the graphs' within 1e-5.
Source: supplement 2.1 (fast cache), 2.2 and 2.6; docs/reference/bundle-format.md.
"""

import copy
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from lambent_compute.threads import available_threads, for_each

from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.graphs import (
    AdaptedHits,
    PointMaterials,
    PrimaryHits,
    Rows,
    SecondaryHits,
    output_widths,
)
from lambent_relight.fused import fields
from lambent_relight.fused.fast_cache import FusedAdaptedCache, FusedFastCache
from lambent_relight.fused.gbuffer import FusedGbuffer
from lambent_relight.fused.weights import NotFused, Weights

__all__ = ["FusedCaches", "NotFused"]

T = TypeVar("T")

_RAYS_PER_TASK = 4096
_CAMERA_RAYS_PER_TASK = 1024


class FusedMaterials:
    """Materials and normals of points."""

    def __init__(self, bundle: Bundle, weights: Weights) -> None:
        """Collect the networks; raises NotFused when the bundle has others."""
        self._fields, _ = fields.Fields.of(bundle, weights, "material")

    def __call__(self, position: Rows, out: PointMaterials) -> None:
        """Write the surface at points [row, 3]."""
        properties = np.empty((len(position), fields.NUM_PROPERTIES), np.float32)
        fields.surfaces(self._fields, position, self._fields.work(), properties)
        out.normal[:], out.albedo[:] = properties[:, 0:3], properties[:, 3:6]
        out.perceptual_roughness[:], out.metalness[:] = properties[:, 6:7], properties[:, 7:8]


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

    @property
    def num_threads(self) -> int:
        """The threads that answer a call."""
        return self._threads

    def in_callers_thread(self) -> "FusedCaches":
        """Return the same functions, answered by the thread that calls them."""
        single = copy.copy(self)
        single._threads = 1
        return single

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
        outputs = {name: np.zeros((count, width), np.float32) for name, width in output_widths(kind).items()}

        def task(start: int) -> None:
            rows = slice(start, start + rows_per_task)
            function(*(array[rows] for array in arrays), kind(**{k: v[rows] for k, v in outputs.items()}))

        for_each(task, range(0, count, rows_per_task), self._threads)
        return kind(**outputs)
