"""The fast cache and the material field without a graph runtime, from the same weights.

Reads the tensors that the manifest places in models/weights.bin, and the constants that the graphs carry
as metadata under `lambent.network`. It knows two networks, `fast_cache.v1` and `material.v1`; for any other
there is no fused reader and the graphs are run by onnxruntime. Answers equal the graphs' within 1e-5.
Source: supplement 2.1 (fast cache) and 2.6 (materials); docs/reference/bundle-format.md.
"""

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent_relight import fused_kernels as kernels
from lambent_relight.bundle import Bundle
from lambent_relight.errors import BundleError
from lambent_relight.graphs import PointMaterials, Rows, SecondaryHits, available_threads
from lambent_relight.onnx_wire import metadata

METADATA_KEY = "lambent.network"
_ROWS_PER_TASK = 4096


class NotFused(Exception):  # noqa: N818 - an answer, not a fault
    """The bundle's networks are not the ones the fused reader knows; the message says why."""


@dataclass(frozen=True)
class Layer:
    """An affine layer: weight [out, in], bias [out]."""

    weight: Rows
    bias: Rows


@dataclass(frozen=True)
class FeatureGrid:
    """A multi-resolution feature grid."""

    table: Rows
    levels: NDArray[np.int64]
    half_extent: float
    output_scale: np.float32

    @property
    def num_outputs(self) -> int:
        """Features of a point."""
        return len(self.levels) * self.table.shape[1]

    def encode(self, points: Rows, count: int, out: Rows) -> None:
        """Write the features of `points` [3, block] to `out` [num_outputs, block]."""
        kernels.encode_grid(points, count, self.table, self.levels, self.half_extent, self.output_scale, out)


class Weights:
    """The named tensors of a bundle."""

    def __init__(self, bundle: Bundle) -> None:
        """Index the manifest's tensors; nothing is copied."""
        self._data = bundle.weights
        self._tensors = {tensor.name: tensor for tensor in bundle.manifest.tensors}
        self._grids = {grid.name: grid for grid in bundle.manifest.grids}

    def __contains__(self, name: str) -> bool:
        """Return whether there is a tensor of this name."""
        return name in self._tensors

    def tensor(self, name: str) -> Rows:
        """Return a float32 tensor; raises NotFused where there is none, BundleError where it is cut off."""
        entry = self._tensors.get(name)
        if entry is None or entry.dtype != "float32":
            raise NotFused(f"there is no float32 tensor {name!r}")
        shape = tuple(entry.shape)
        offset, count = int(entry.offset_bytes), int(np.prod(shape, dtype=np.int64))
        if offset % 4 or offset < 0 or 4 * count != entry.size_bytes or offset + 4 * count > len(self._data):
            raise BundleError(
                "bundle.tensor_invalid",
                f"tensor {name!r} does not lie inside models/weights.bin",
                "export the bundle again",
            )
        return np.frombuffer(self._data, np.float32, count, offset).reshape(shape)

    def layer(self, name: str) -> Layer:
        """Return the affine layer of this name."""
        weight, bias = self.tensor(f"{name}.weight"), self.tensor(f"{name}.bias")
        if weight.ndim != 2 or bias.shape != weight.shape[:1]:
            raise NotFused(f"{name!r} is not an affine layer")
        return Layer(weight, bias)

    def layers(self, name: str) -> list[Layer]:
        """Return the layers `name`.0, `name`.1, ... as far as they go."""
        found: list[Layer] = []
        while f"{name}.{len(found)}.weight" in self:
            found.append(self.layer(f"{name}.{len(found)}"))
        return found

    def grid(self, name: str) -> FeatureGrid:
        """Return the feature grid of this name."""
        entry = self._grids.get(name)
        if entry is None:
            raise NotFused(f"there is no grid {name!r}")
        table = self.tensor(entry.tensor)
        levels = np.array(
            [(v.resolution, v.first_row, v.num_rows, v.multiplier_y, v.multiplier_z) for v in entry.levels],
            np.int64,
        ).reshape(-1, 5)
        fits = table.ndim == 2 and table.shape[1] == entry.num_features
        # The kernels do not check indices, so that every row a level can name must be there.
        inside = (levels[:, 0] >= 2) & (levels[:, 2] >= 1) & (levels[:, 1] + levels[:, 2] <= len(table))
        if not (fits and len(levels) and inside.all() and entry.half_extent > 0.0):
            raise BundleError(
                "bundle.grid_invalid",
                f"grid {name!r} names rows its table has not",
                "export the bundle again",
            )
        return FeatureGrid(table, levels, entry.half_extent, np.float32(entry.output_scale or 1.0))


def _constants(bundle: Bundle, graph: str, kind: str, names: tuple[str, ...]) -> dict[str, float | None]:
    text = metadata(bundle.graph(bundle.graph_path(graph))).get(METADATA_KEY, "")
    try:
        values = json.loads(text) if text else {}
        if values.get("kind") != kind:
            raise NotFused(f"the {graph} graph is {values.get('kind')!r}, not {kind!r}")
        return {name: None if values[name] is None else float(values[name]) for name in names}
    except (ValueError, TypeError, AttributeError, KeyError) as error:
        raise NotFused(f"the {graph} graph's {METADATA_KEY} is incomplete ({error})") from error


def _chained(layers: list[Layer], num_inputs: int, skip_after: int | None = None) -> int:
    """Return the width of the last layer; raises NotFused when sizes do not fit."""
    width = num_inputs
    for index, layer in enumerate(layers):
        expected = width + (num_inputs if index == skip_after else 0)
        if layer.weight.shape[1] != expected:
            raise NotFused(f"a layer has {layer.weight.shape[1]} inputs, expected {expected}")
        width = layer.weight.shape[0]
    return width + (num_inputs if skip_after == len(layers) else 0)


class FusedFastCache:
    """Opacity and distance of secondary rays."""

    def __init__(self, bundle: Bundle, weights: Weights) -> None:
        """Collect the network; raises NotFused when the bundle has another one."""
        names = ("contraction_radius", "near", "far", "num_samples", "num_frequencies", "skip_after")
        names += ("curve_power", "curve_premultiplier")
        constants = _constants(bundle, "fast_cache", "fast_cache.v1", names)
        self._skip = None if constants["skip_after"] is None else int(constants["skip_after"])
        self._radius = np.float32(constants["contraction_radius"])
        self._num_samples = int(constants["num_samples"])
        self._num_frequencies = int(constants["num_frequencies"])
        self._curve = tuple(constants[name] for name in ("near", "far", "curve_power", "curve_premultiplier"))
        self._grid = weights.grid("fast.distance_grid")
        self._code = weights.layers("fast.code.layers")
        self._network = weights.layers("fast.distance_network.layers")
        self._head = weights.layer("fast.distance_head")
        code_width = _chained(self._code, self._grid.num_outputs)
        self._num_encoded = 3 + 6 * self._num_frequencies
        self._num_inputs = code_width + 2 * self._num_encoded
        last = _chained(self._network, self._num_inputs, self._skip)
        if self._head.weight.shape != (3 * self._num_samples + 1, last) or self._num_samples < 2:
            raise NotFused("the fast cache's head has another shape")

    def __call__(self, origin: Rows, direction: Rows, opacity: Rows, distance: Rows) -> None:
        """Write opacity and distance [row, 1] of rays [row, 3]."""
        block = kernels.BLOCK
        vectors, points = np.zeros((3, block), np.float32), np.zeros((3, block), np.float32)
        features = np.zeros((self._grid.num_outputs, block), np.float32)
        inputs = np.zeros((self._num_inputs, block), np.float32)
        first_encoded = self._num_inputs - 2 * self._num_encoded
        for start in range(0, len(origin), block):
            count = min(block, len(origin) - start)
            points[:, :count] = origin[start : start + count].T
            vectors[:, :count] = direction[start : start + count].T
            kernels.contract_block(points, count, self._radius)
            self._grid.encode(points, count, features)
            inputs[:first_encoded] = _run(self._code, features)
            kernels.encode_frequencies(points, count, self._num_frequencies, inputs, first_encoded)
            kernels.encode_frequencies(
                vectors, count, self._num_frequencies, inputs, first_encoded + self._num_encoded
            )
            raw = _run([self._head], _run(self._network, inputs, self._skip), relu=False)
            kernels.place_samples(raw, count, self._num_samples, *self._curve, opacity, distance, start)


class FusedMaterials:
    """Materials and normals of points."""

    def __init__(self, bundle: Bundle, weights: Weights) -> None:
        """Collect the networks; raises NotFused when the bundle has others."""
        names = ("contraction_radius", "albedo_bias", "alpha_bias", "metalness_bias", "alpha_minimum")
        constants = _constants(bundle, "material", "material.v1", (*names, "softplus_beta"))
        self._radius = np.float32(constants["contraction_radius"])
        self._alpha_minimum = np.float32(constants["alpha_minimum"])
        self._sharpness = constants["softplus_beta"]
        self._biases = tuple(np.float32(constants[name]) for name in names[1:4])
        self._grid = weights.grid("materials.grid")
        self._layers = [weights.layer("materials.bottleneck"), weights.layer("materials.head")]
        self._density_grid = weights.grid("nerf.density.grid")
        self._density = weights.layers("nerf.density.network.layers")
        hidden = _chained(self._density, self._density_grid.num_outputs)
        self._normal_head = weights.layer("nerf.normals.head")
        self._normal_grid, self._normal_network = None, []
        if "nerf.normals.grid.table" in weights:
            self._normal_grid = weights.grid("nerf.normals.grid")
            self._normal_network = weights.layers("nerf.normals.network.layers")
            hidden = _chained(self._normal_network, self._normal_grid.num_outputs + hidden)
        if _chained(self._layers, self._grid.num_outputs) < 9 or self._normal_head.weight.shape != (
            3,
            hidden,
        ):
            raise NotFused("the material or normal head has another shape")

    def __call__(self, position: Rows, out: PointMaterials) -> None:
        """Write the surface at points [row, 3]."""
        block = kernels.BLOCK
        points = np.zeros((3, block), np.float32)
        for start in range(0, len(position), block):
            part = slice(start, min(start + block, len(position)))
            count = part.stop - start
            points[:, :count] = position[part].T
            kernels.contract_block(points, count, self._radius)
            raw = _run(self._layers, _encode(self._grid, points, count), relu=False)[:, :count].T
            out.albedo[part] = _sigmoid(raw[:, 0:3] + self._biases[0])
            alpha = _sigmoid(raw[:, 6:7] + self._biases[1])
            alpha = alpha * (np.float32(1.0) - self._alpha_minimum) + self._alpha_minimum
            out.perceptual_roughness[part] = np.sqrt(alpha)
            out.metalness[part] = _sigmoid(raw[:, 8:9] + self._biases[2])
            out.normal[part] = self._normal(points, count)

    def _normal(self, points: Rows, count: int) -> Rows:
        hidden = _encode(self._density_grid, points, count)
        for layer in self._density:
            hidden = _run([layer], hidden, relu=self._sharpness is None)
            if self._sharpness is not None:
                kernels.softplus(hidden, count, np.float32(self._sharpness))
        if self._normal_grid is not None:
            features = np.concatenate([_encode(self._normal_grid, points, count), hidden])
            hidden = _run(self._normal_network, features)
        raw = _run([self._normal_head], hidden, relu=False)[:, :count].T
        return -raw / np.maximum(np.linalg.norm(raw, axis=-1, keepdims=True), 1e-8)


def _encode(grid: FeatureGrid, points: Rows, count: int) -> Rows:
    features = np.zeros((grid.num_outputs, kernels.BLOCK), np.float32)
    grid.encode(points, count, features)
    return features


def _run(layers: list[Layer], values: Rows, skip_after: int | None = None, *, relu: bool = True) -> Rows:
    """Return the activations [out, block] of hidden layers; `values` join again behind layer `skip_after`."""
    inputs = values
    for index, layer in enumerate(layers):
        if index == skip_after:
            values = np.concatenate([values, inputs])
        out = np.empty((len(layer.bias), kernels.BLOCK), np.float32)
        kernels.affine(layer.weight, layer.bias, values, out, relu)
        values = out
    return np.concatenate([values, inputs]) if skip_after == len(layers) else values


def _sigmoid(values: Rows) -> Rows:
    return np.float32(1.0) / (np.float32(1.0) + np.exp(-values))


class FusedCaches:
    """What refined relighting asks for, answered by compiled code."""

    name = "fused"

    def __init__(self, bundle: Bundle, *, num_threads: int | None = None) -> None:
        """Collect the networks of `bundle`; raises NotFused, with the reason, when they are not known."""
        weights = Weights(bundle)
        self._fast = FusedFastCache(bundle, weights)
        self._materials = FusedMaterials(bundle, weights)
        self._threads = num_threads or available_threads()

    def secondary(self, origin: Rows, direction: Rows) -> SecondaryHits:
        """Return what rays [ray, 3] from offset surface points see."""
        hits = SecondaryHits(*(np.empty((len(origin), 1), np.float32) for _ in range(2)))
        self._each_part(
            len(origin), lambda p: self._fast(origin[p], direction[p], hits.opacity[p], hits.distance[p])
        )
        return hits

    def material(self, position: Rows) -> PointMaterials:
        """Return the surface properties at points [point, 3]."""
        count = len(position)
        found = PointMaterials(*(np.empty((count, n), np.float32) for n in (3, 1, 1, 3)))

        def part(p: slice) -> None:
            view = PointMaterials(
                found.albedo[p], found.perceptual_roughness[p], found.metalness[p], found.normal[p]
            )
            self._materials(position[p], view)

        self._each_part(count, part)
        return found

    def _each_part(self, count: int, task: Callable[[slice], None]) -> None:
        parts = [
            slice(start, min(start + _ROWS_PER_TASK, count)) for start in range(0, count, _ROWS_PER_TASK)
        ]
        if self._threads == 1 or len(parts) < 2:
            for part in parts:
                task(part)
            return
        with ThreadPoolExecutor(self._threads) as pool:
            list(pool.map(task, parts))
