"""Writes a copy of a bundle with an additional fast cache that is adapted to an environment."""

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType

import numpy as np
import onnx
import torch
from flashcache.caches.fast_cache import LEAST_OPACITY, FastCache
from flashcache.export import graphs, reference
from flashcache.export.onnx import StoredTensor, WeightFile
from lambent_proto.v1 import bundle_pb2
from lambent_relight.bundle.adapted import METADATA_KEY, AdaptedLight
from lambent_relight.bundle.archive import read_checked
from lambent_relight.bundle.bundle import WEIGHTS_PATH, Bundle
from lambent_relight.bundle.onnx_check import metadata

from lambent_asset.bundle import manifest as manifests
from lambent_asset.bundle.graphs import PARITY_ROWS, secondary_rays
from lambent_asset.bundle.parity import compare

_MAX_FILE_BYTES = 2 << 30
_WEIGHTS_KEY = "flashcache.weights_sha256"


def write_adapted(
    bundle: Bundle,
    cache: FastCache,
    light: AdaptedLight,
    folder: Path,
    figures: Mapping[str, float] = MappingProxyType({}),
) -> Path:
    """Copy `bundle` into `folder`, which must not exist, with `cache` added as `fast_cache_<light>`.

    Tables are float16 where the bundle's are. `figures` join the manifest's metrics. Raises WorkerError
    `export.parity` when the graph differs from the cache.
    """
    manifest = bundle_pb2.BundleManifest()
    manifest.CopyFrom(bundle.manifest)
    for file in manifest.files:
        copied = folder / file.path
        copied.parent.mkdir(parents=True, exist_ok=True)
        copied.write_bytes(read_checked(bundle.source, file.path, limit_bytes=_MAX_FILE_BYTES))
    weights = _weights_of(bundle)
    old = set(weights.tensors)
    if weights.half_tables:
        with torch.no_grad():
            cache.feature_grid.table.copy_(cache.feature_grid.table.half().float())
    known = metadata(bundle.graph(bundle.graph_path("fast_cache")))
    shared = {
        key: value for key, value in known.items() if key.startswith("flashcache.") or key == "producer"
    }
    shared.pop("flashcache.train_light", None)
    graph = graphs.adapted_cache_graph(cache, light.name, weights, {**shared, METADATA_KEY: light.to_json()})
    data = weights.to_bytes()
    (folder / WEIGHTS_PATH).write_bytes(data)
    for entry in manifest.graphs:
        _name_weights(folder / entry.path, data)
    path = f"models/fast_cache_{light.name}.onnx"
    (folder / path).write_bytes(graph.SerializeToString(deterministic=True))
    _name_weights(folder / path, data)
    parity = compare(
        path,
        folder / path,
        lambda own, inputs: reference.cache_outputs(own, 0, **inputs),
        cache,
        secondary_rays(tuple(manifest.bounds.minimum), tuple(manifest.bounds.maximum), PARITY_ROWS, 0),
        edge=("opacity", LEAST_OPACITY),
    )
    manifest.metrics.update(figures)
    manifests.add_graph(manifest, "fast_cache", path, light.name, parity)
    added = {name: tensor for name, tensor in weights.tensors.items() if name not in old}
    grids = {f"{graphs.adapted_prefix(light.name)}.feature_grid": cache.feature_grid.layout}
    manifests.add_weights(manifest, WeightFile(tensors=added), grids)
    manifests.write_manifest(folder, manifest)
    return folder


def _weights_of(bundle: Bundle) -> WeightFile:
    """Return a bundle's weight file, ready for more tensors."""
    data = bundle.weights
    tensors = {}
    for entry in bundle.manifest.tensors:
        dtype = np.dtype(entry.dtype).newbyteorder("<")
        count = int(entry.size_bytes) // dtype.itemsize
        values = np.frombuffer(data, dtype, count, int(entry.offset_bytes)).reshape(tuple(entry.shape))
        tensors[entry.name] = StoredTensor(
            name=entry.name, values=values, offset_bytes=int(entry.offset_bytes)
        )
    half = tensors["fast.feature_grid.table"].values.dtype == np.float16
    return WeightFile(tensors=tensors, size_bytes=len(data), half_tables=half)


def _name_weights(path: Path, data: bytes) -> None:
    """Write into a graph which weight file it belongs to, if it has any weights there."""
    model = onnx.load(str(path), load_external_data=False)
    external = any(tensor.external_data for tensor in model.graph.initializer)
    if not external:
        return
    kept = {prop.key: prop.value for prop in model.metadata_props if prop.key != _WEIGHTS_KEY}
    del model.metadata_props[:]
    onnx.helper.set_model_props(model, {**kept, _WEIGHTS_KEY: sha256(data).hexdigest()})
    path.write_bytes(model.SerializeToString(deterministic=True))
