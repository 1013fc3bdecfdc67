"""The bundle's three graphs as functions on arrays, run by onnxruntime.

gbuffer: camera ray -> surface.  fast_cache: secondary ray -> opacity and distance.  material: point ->
surface properties. All arrays are float32; rows are independent, so long batches run in chunks.
Source: docs/reference/bundle-format.md.
"""

from dataclasses import dataclass, fields
from typing import Any, NoReturn, Protocol

import numpy as np
import onnxruntime
from lambent_compute.threads import available_threads
from lambent_core.errors import BundleError, UnsupportedQuality
from numpy.typing import NDArray

from lambent_relight.bundle.bundle import WEIGHTS_PATH, Bundle
from lambent_relight.bundle.onnx_check import check_onnx, keep_outputs

Rows = NDArray[np.float32]

_ROWS_PER_CALL = {"gbuffer": 128, "fast_cache": 8192, "material": 8192}
"""Bounds the memory of a graph's intermediate values: a camera ray evaluates density at about 100 points."""


@dataclass(frozen=True)
class PrimaryHits:
    """Surfaces hit by camera rays; values are means over the ray, valid where `opacity` > 0."""

    opacity: Rows
    distance: Rows
    normal: Rows
    albedo: Rows
    perceptual_roughness: Rows
    metalness: Rows


@dataclass(frozen=True)
class SecondaryHits:
    """Hits of rays from a surface, independent of the light."""

    opacity: Rows
    """Probability that the ray is blocked, [ray, 1]; 1 - opacity is visibility of the environment."""
    distance: Rows
    """Expected distance from the ray's origin, scene units, [ray, 1]."""


@dataclass(frozen=True)
class AdaptedHits(SecondaryHits):
    """Hits of rays from a surface under the light that a fast cache was adapted to."""

    radiance: Rows
    """Incoming radiance including all bounces: linear, premultiplied by `opacity`, [ray, 3]."""


@dataclass(frozen=True)
class PointMaterials:
    """Surface properties at points."""

    albedo: Rows
    perceptual_roughness: Rows
    metalness: Rows
    normal: Rows


class SurfaceCaches(Protocol):
    """The queries of refined relighting; implemented by ONNX graphs or by the fused reader."""

    name: str
    """"onnxruntime", "fused", or "none" if the bundle has no networks."""

    def gbuffer(self, origin: Rows, direction: Rows) -> PrimaryHits:
        """Return the surfaces hit by camera rays [ray, 3]."""

    def secondary(self, origin: Rows, direction: Rows) -> SecondaryHits:
        """Return the hits of rays [ray, 3] from offset surface points."""

    def material(self, position: Rows) -> PointMaterials:
        """Return the surface properties at points [point, 3]."""


class NoCaches:
    """Stands in for the networks of a bundle that has none; raises an error that names the alternatives."""

    name = "none"

    def gbuffer(self, *_: Any, **__: Any) -> NoReturn:
        """Raise UnsupportedQuality, as the other functions do."""
        raise UnsupportedQuality(
            "relight.networks_missing",
            "the bundle carries baked light transport and no networks",
            'use the quality "baked" or "preview", or a bundle of the full tier',
        )

    secondary = material = adapted = gbuffer


class OnnxGraph:
    """One graph with named inputs and outputs."""

    def __init__(
        self,
        bundle: Bundle,
        path: str,
        inputs: tuple[str, ...],
        outputs: dict[str, int],
        *,
        threads: int,
        rows_per_call: int,
    ) -> None:
        """Open a graph for the named outputs [row, n] alone; what only others need is not computed.

        Raises BundleError when its inputs or outputs are not the named ones.
        """
        data, weights = bundle.graph(path), bundle.weights
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 3
        # Spinning idle threads would slow down everything else on a small machine.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        if check_onnx(data, path=path, weights_bytes=len(weights)):
            name = WEIGHTS_PATH.rpartition("/")[2]
            options.add_external_initializers_from_files_in_memory([name], [weights], [len(weights)])
        try:
            needed = keep_outputs(data, set(outputs))
            self._session = onnxruntime.InferenceSession(needed, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime has no common base class for its errors
            raise BundleError(
                "bundle.graph_damaged",
                f'onnxruntime refuses "{path}" ({str(error).splitlines()[0][:200]})',
                "fetch the bundle again, or update onnxruntime",
            ) from error
        found_inputs = {item.name: item.shape for item in self._session.get_inputs()}
        found_outputs = {item.name: item.shape for item in self._session.get_outputs()}
        wrong_inputs = set(found_inputs) != set(inputs) or any(s[1:] != [3] for s in found_inputs.values())
        wrong_outputs = any(found_outputs.get(name, [])[1:] != [size] for name, size in outputs.items())
        if wrong_inputs or wrong_outputs:
            raise BundleError(
                "bundle.graph_signature",
                f'"{path}" has inputs {found_inputs} and outputs {found_outputs}',
                f"expected inputs {list(inputs)} and outputs {outputs}",
            )
        self._path, self._inputs, self._outputs = path, inputs, list(outputs)
        self._rows_per_call = rows_per_call

    def __call__(self, *arrays: Rows) -> dict[str, Rows]:
        """Return the outputs by name for inputs [row, 3], computed `rows_per_call` at a time."""
        pieces = []
        for start in range(0, max(len(arrays[0]), 1), self._rows_per_call):
            feed = {
                name: np.ascontiguousarray(array[start : start + self._rows_per_call], np.float32)
                for name, array in zip(self._inputs, arrays, strict=True)
            }
            pieces.append(self._run(feed))
        return {name: np.concatenate([p[i] for p in pieces]) for i, name in enumerate(self._outputs)}

    def _run(self, feed: dict[str, Rows]) -> list[Rows]:
        try:
            return self._session.run(self._outputs, feed)
        except Exception as error:  # onnxruntime has no common base class for its errors
            raise BundleError(
                "bundle.graph_failed",
                f'"{self._path}" fails when it runs ({str(error).splitlines()[0][:200]})',
                "fetch or export the bundle again",
            ) from error


_WIDTHS = {"normal": 3, "albedo": 3, "radiance": 3}


def output_widths(kind: type) -> dict[str, int]:
    """Return the outputs that a result class holds, and their widths."""
    return {field.name: _WIDTHS.get(field.name, 1) for field in fields(kind)}


class OnnxCaches:
    """The graphs of a bundle, opened when first used."""

    name = "onnxruntime"

    def __init__(self, bundle: Bundle, *, num_threads: int | None = None) -> None:
        """Prepare `bundle`'s graphs for `num_threads` CPU threads (default: all this process may use)."""
        self._bundle = bundle
        self._threads = num_threads or available_threads()
        self._opened: dict[str, OnnxGraph] = {}

    def _graph(self, name: str, inputs: tuple[str, ...], kind: type, light: str = "") -> OnnxGraph:
        key = f"{name}/{light}"
        if key not in self._opened:
            path = self._bundle.graph_path(name, light)
            self._opened[key] = OnnxGraph(
                self._bundle,
                path,
                inputs,
                output_widths(kind),
                threads=self._threads,
                rows_per_call=_ROWS_PER_CALL[name],
            )
        return self._opened[key]

    def gbuffer(self, origin: Rows, direction: Rows) -> PrimaryHits:
        """Return the surfaces hit by camera rays [ray, 3]."""
        return PrimaryHits(**self._graph("gbuffer", ("origin", "direction"), PrimaryHits)(origin, direction))

    def secondary(self, origin: Rows, direction: Rows) -> SecondaryHits:
        """Return the hits of rays [ray, 3] from offset surface points, which all lights share."""
        return SecondaryHits(
            **self._graph("fast_cache", ("origin", "direction"), SecondaryHits)(origin, direction)
        )

    def material(self, position: Rows) -> PointMaterials:
        """Return the surface properties at points [point, 3]."""
        return PointMaterials(**self._graph("material", ("position",), PointMaterials)(position))

    def adapted(self, light: str, origin: Rows, direction: Rows) -> AdaptedHits:
        """Return hits and radiance of rays [ray, 3] from the cache adapted to `light`."""
        graph = self._graph("fast_cache", ("origin", "direction"), AdaptedHits, light)
        return AdaptedHits(**graph(origin, direction))
