"""Tensors, layers and feature grids of a bundle's models/weights.bin, for compiled code.

Float32 arrays are views of the file's bytes, float16 ones are widened: a CPU interpolates those no faster.
Everything compiled code will index is checked here.
"""

import json
import math
from collections.abc import Mapping

import numpy as np
from lambent_core.errors import BundleError

from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.graphs import Rows
from lambent_relight.bundle.onnx_check import metadata
from lambent_relight.fused.grids import Grid
from lambent_relight.fused.networks import Layer

METADATA_KEY = "lambent.network"
_DTYPES: Mapping[str, np.dtype[np.floating]] = {"float32": np.dtype("<f4"), "float16": np.dtype("<f2")}


class NotFused(Exception):  # noqa: N818 - an answer, not a fault
    """Compiled code does not support the bundle's networks; the message says why."""


class Weights:
    """The named tensors of a bundle."""

    def __init__(self, bundle: Bundle) -> None:
        """Index the manifest's tensors."""
        self._data = bundle.weights
        self._tensors = {tensor.name: tensor for tensor in bundle.manifest.tensors}
        self._grids = {grid.name: grid for grid in bundle.manifest.grids}

    def __contains__(self, name: str) -> bool:
        """Return whether there is a tensor of this name."""
        return name in self._tensors

    def tensor(self, name: str) -> Rows:
        """Return a tensor as float32; raises NotFused without one, BundleError where it is cut off."""
        entry = self._tensors.get(name)
        dtype = _DTYPES.get(entry.dtype) if entry is not None else None
        if entry is None or dtype is None:
            raise NotFused(f"there is no float32 or float16 tensor {name!r}")
        shape = tuple(entry.shape)
        count = math.prod(shape)
        offset, size = entry.offset_bytes, dtype.itemsize * count
        aligned = offset >= 0 and offset % dtype.itemsize == 0
        if not (aligned and size == entry.size_bytes and offset + size <= len(self._data)):
            raise BundleError(
                "bundle.tensor_invalid",
                f"tensor {name!r} does not lie inside models/weights.bin",
                "export the bundle again",
            )
        values = np.frombuffer(self._data, dtype, count, int(offset)).reshape(shape)
        values = values.astype(np.float32, copy=False)
        # All alike: functions are compiled anew for arrays that may be written to.
        values.flags.writeable = False
        return values

    def layer(self, *names: str) -> Layer:
        """Return an affine layer, or several with the same inputs as one, their outputs after each other."""
        weights = [self.tensor(f"{name}.weight") for name in names]
        biases = [self.tensor(f"{name}.bias") for name in names]
        for name, weight, bias in zip(names, weights, biases, strict=True):
            if weight.ndim != 2 or bias.shape != weight.shape[:1] or weight.shape[1] != weights[0].shape[1]:
                raise NotFused(f"{name!r} is not an affine layer of the expected shape")
        return Layer(np.concatenate(weights), np.concatenate(biases))

    def layers(self, name: str) -> list[Layer]:
        """Return the layers `name`.0, `name`.1, ... as far as they go."""
        layers: list[Layer] = []
        while f"{name}.{len(layers)}.weight" in self:
            layers.append(self.layer(f"{name}.{len(layers)}"))
        return layers

    def grid(self, name: str) -> Grid:
        """Return the feature grid of this name; raises BundleError where it names rows that are not there."""
        entry = self._grids.get(name)
        if entry is None:
            raise NotFused(f"there is no grid {name!r}")
        table = self.tensor(entry.tensor)
        levels = np.array(
            [(v.resolution, v.first_row, v.num_rows, v.multiplier_y, v.multiplier_z) for v in entry.levels],
            np.int64,
        ).reshape(-1, 5)
        fits = table.ndim == 2 and table.shape[1] == entry.num_features
        # Compiled code does not check indices, so every row that a level can address must exist.
        inside = (levels[:, 0] >= 2) & (levels[:, 2] >= 1)
        inside &= levels[:, 1] + levels[:, 2] <= (len(table) if fits else 0)
        if not (len(levels) and inside.all() and entry.half_extent > 0.0):
            raise BundleError(
                "bundle.grid_invalid",
                f"grid {name!r} names rows its table has not",
                "export the bundle again",
            )
        return Grid(table, levels, entry.half_extent)


def graph_constants(
    bundle: Bundle, path: str, kind: str, names: tuple[str, ...], optional: tuple[str, ...] = ()
) -> dict:
    """Return the constants of the network of the graph at `path`; those in `optional` may be None.

    Raises NotFused unless the network is of this `kind`.
    """
    graph = path.rpartition("/")[2]
    data = bundle.graph(path)
    try:
        text = metadata(data).get(METADATA_KEY, "")
        values = json.loads(text) if text else {}
        if values.get("kind") != kind:
            raise NotFused(f"the {graph} graph's network is {values.get('kind')!r}, not {kind!r}")
        constants = {name: values[name] for name in names + optional}
        for name, value in constants.items():
            given = value is not None or name not in optional
            if given and not np.isfinite(np.asarray(value, np.float64)).all():
                raise ValueError(f"{name} is not finite")
    except (ValueError, TypeError, AttributeError, KeyError, RecursionError) as error:
        raise NotFused(f"the {graph} graph's {METADATA_KEY} is incomplete ({error})") from error
    return constants


def chained(layers: list[Layer], num_inputs: int, *, may_skip: bool = False) -> tuple[int, int | None]:
    """Return the width behind `layers`, and before which of them the inputs join again (None: nowhere).

    Raises NotFused when sizes do not fit each other.
    """
    width, skip = num_inputs, None
    for index, layer in enumerate(layers):
        size = layer.weight.shape[1]
        if may_skip and index > 0 and skip is None and size == width + num_inputs:
            skip = index
        elif size != width:
            raise NotFused(f"a layer has {size} inputs, expected {width}")
        width = layer.weight.shape[0]
    return width, skip
