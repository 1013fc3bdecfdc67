"""Bundles of untrained torch models: the exporter's graphs, the manifest's tables, network constants."""

from __future__ import annotations

import json
from pathlib import Path

import onnx
from flashcache.export import constants, graphs
from flashcache.export.onnx import WeightFile
from flashcache.export.reference import GbufferRule
from flashcache.export.stored_grids import exported_grids
from flashcache.physical.model import InverseModel
from lambent_relight.cameras import cameras_json, turntable
from support.analytic_bundle import manifest_of, write_manifest
from support.analytic_scene import AnalyticScene


def network_constants(model: InverseModel, rule: GbufferRule) -> dict[str, dict]:
    """Return the constants of each graph's network, by graph name."""
    metadata = {
        "gbuffer": constants.gbuffer_constants(model, rule),
        "material": constants.material_constants(model),
        "fast_cache": constants.fast_cache_constants(model.fast),
    }
    return {name: json.loads(values[constants.METADATA_KEY]) for name, values in metadata.items()}


def write_network_bundle(
    folder: Path, model: InverseModel, rule: GbufferRule, *, half_tables: bool = False
) -> Path:
    """Write a bundle of `model`, whose one light is "sky", and return its folder."""
    (folder / "models").mkdir(parents=True)
    weights = WeightFile(half_tables=half_tables)
    made = {
        "gbuffer": graphs.gbuffer_graph(model, rule, weights, {}),
        "material": graphs.material_graph(model, weights, {}),
        "fast_cache_sky": graphs.fast_cache_graph(model, 0, weights, {}),
    }
    for name, graph in made.items():
        (folder / "models" / f"{name}.onnx").write_bytes(graph.SerializeToString())
    (folder / "models" / "weights.bin").write_bytes(weights.to_bytes())
    (folder / "cameras.json").write_text(
        cameras_json(turntable(2, radius=4.0, width=16, height=16)), encoding="utf-8"
    )
    manifest = manifest_of(AnalyticScene((), origin_offset=0.01))
    manifest.secondary_rays.near, manifest.secondary_rays.far = model.domain.secondary
    for tensor in weights.tensors.values():
        manifest.tensors.add(
            name=tensor.name,
            dtype=tensor.values.dtype.name,
            shape=tensor.values.shape,
            offset_bytes=tensor.offset_bytes,
            size_bytes=tensor.values.nbytes,
        )
    for name, grid in exported_grids(model).items():
        entry = manifest.grids.add(
            name=name,
            tensor=f"{name}.table",
            num_features=grid.layout.num_features,
            half_extent=grid.layout.half_extent,
        )
        for level in grid.layout.levels:
            entry.levels.add(
                resolution=level.resolution,
                first_row=level.first_row,
                num_rows=level.num_rows,
                multiplier_y=level.multiplier_y,
                multiplier_z=level.multiplier_z,
            )
    write_manifest(folder, manifest)
    return folder


def set_network_metadata(folder: Path, graph: str, values: dict) -> None:
    """Write `values` as the constants of a graph's network; the manifest must be written again."""
    path = folder / "models" / f"{graph}.onnx"
    model = onnx.load(path, load_external_data=False)
    del model.metadata_props[:]
    onnx.helper.set_model_props(model, {"lambent.network": json.dumps(values)})
    path.write_bytes(model.SerializeToString())
