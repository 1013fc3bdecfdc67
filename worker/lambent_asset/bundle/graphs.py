"""The graphs of a bundle, each compared with the model before it is accepted."""

from collections.abc import Callable, Sequence
from hashlib import sha256
from pathlib import Path

import onnx
import torch
from flashcache.caches.fast_cache import LEAST_OPACITY
from flashcache.export import graphs, reference
from flashcache.export.onnx import WEIGHTS_NAME, WeightFile
from flashcache.export.reference import GbufferRule
from flashcache.export.stored_grids import exported_grids
from flashcache.physical.model import InverseModel
from lambent_proto import BUNDLE_VERSION
from lambent_proto.v1 import bundle_pb2
from lambent_relight.bundle.bundle import NETWORKS

from lambent_asset.bundle import manifest as manifests
from lambent_asset.bundle.parity import Inputs, ParityResult, Twin, compare

PARITY_ROWS = 4096
"""Random inputs on which every graph is compared with the model."""


def write_graphs(
    model: InverseModel,
    rule: GbufferRule,
    manifest: bundle_pb2.BundleManifest,
    folder: Path,
    *,
    trained: InverseModel | None = None,
    seed: int,
    advance: Callable[[str, ParityResult], None],
) -> None:
    """Write all graphs and their weights into `folder`/models and note them in `manifest`.

    With `trained`, `model` is the same with tables of float16 numbers: they are stored as such, and the
    manifest says what that changed. `advance` is called with the path and result of each comparison.
    Raises WorkerError when a graph differs from the model.
    """
    weights = WeightFile(half_tables=trained is not None)
    metadata = {
        "flashcache.schema": BUNDLE_VERSION,
        "flashcache.scene_id": manifest.scene_id,
        "flashcache.hash": "lattice-v1",
        "flashcache.grids": graphs.grid_metadata(model),
        "flashcache.frame": "right-handed, z up",
        "flashcache.radiance": "linear-scene",
        "flashcache.train_step": str(manifest.generator.train_step),
        "producer": f"lambent {manifest.generator.version} {manifest.generator.git_revision}".rstrip(),
    }
    rays = camera_rays(model, rule, PARITY_ROWS, seed)
    secondary = secondary_rays(rule.box_min, rule.box_max, PARITY_ROWS, seed + 1)
    points = {"position": secondary["origin"]}

    def gbuffer(trained: InverseModel, inputs: Inputs) -> reference.Outputs:
        return reference.gbuffer(trained, rule, **inputs)

    def material(trained: InverseModel, inputs: Inputs) -> reference.Outputs:
        return reference.material(trained, **inputs)

    def fast_cache(light: int) -> Twin:
        return lambda trained, inputs: reference.fast_cache(trained, light, **inputs)

    made: list[tuple[str, str, onnx.ModelProto, Twin, Inputs]] = [
        ("gbuffer", "", graphs.gbuffer_graph(model, rule, weights, metadata), gbuffer, rays),
        ("material", "", graphs.material_graph(model, weights, metadata), material, points),
    ]
    for index, light in enumerate(manifest.train_lights):
        lit = {**metadata, "flashcache.train_light": light}
        graph = graphs.fast_cache_graph(model, index, weights, lit)
        made.append(("fast_cache", light, graph, fast_cache(index), secondary))
    data = weights.to_bytes()
    (folder / "models" / WEIGHTS_NAME).write_bytes(data)
    for name, light, graph, twin, inputs in made:
        path = f"models/{name}_{light}.onnx" if light else f"models/{name}.onnx"
        graph.metadata_props.add(key="flashcache.weights_sha256", value=sha256(data).hexdigest())
        (folder / path).write_bytes(graph.SerializeToString(deterministic=True))
        edge = ("opacity", LEAST_OPACITY) if name == "fast_cache" else None
        result = compare(path, folder / path, twin, model, inputs, trained=trained, edge=edge)
        manifests.add_graph(manifest, name, path, light, result)
        advance(path, result)
    layouts = {name: grid.layout for name, grid in exported_grids(model).items()}
    manifests.add_weights(manifest, weights, layouts)


def remove_networks(manifest: bundle_pb2.BundleManifest, folder: Path) -> None:
    """Remove the networks and their weights from an unfinished bundle; the data baked from them is kept."""
    networks = [graph for graph in manifest.graphs if graph.name in NETWORKS]
    for graph in networks:
        (folder / graph.path).unlink()
        manifest.graphs.remove(graph)
    (folder / "models" / WEIGHTS_NAME).unlink()
    manifest.ClearField("tensors")
    manifest.ClearField("grids")


def camera_rays(model: InverseModel, rule: GbufferRule, count: int, seed: int) -> dict[str, torch.Tensor]:
    """Return rays from all around the object, from as far as its cameras are, to random points of its box."""
    generator = torch.Generator().manual_seed(seed)
    low, high = torch.tensor(rule.box_min), torch.tensor(rule.box_max)
    targets = low + torch.rand(count, 3, generator=generator) * (high - low)
    around = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    origins = 0.5 * (low + high) + around * (0.5 * sum(model.domain.primary))
    return {"origin": origins, "direction": torch.nn.functional.normalize(targets - origins, dim=-1)}


def secondary_rays(
    box_min: Sequence[float], box_max: Sequence[float], count: int, seed: int
) -> dict[str, torch.Tensor]:
    """Return rays from random points of a box in random directions."""
    generator = torch.Generator().manual_seed(seed)
    low, high = torch.tensor(box_min), torch.tensor(box_max)
    points = low + torch.rand(count, 3, generator=generator) * (high - low)
    around = torch.randn(count, 3, generator=generator)
    return {"origin": points, "direction": torch.nn.functional.normalize(around, dim=-1)}
