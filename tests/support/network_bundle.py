"""Bundles that carry the networks of a torch model beside an analytic scene's graphs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
from flashcache.encoding.hash_grid import HashGrid
from flashcache.physical.model import InverseModel
from google.protobuf import json_format
from lambent_proto.v1.bundle_pb2 import BundleManifest
from support.analytic_bundle import write_manifest


def add_networks(folder: Path, model: InverseModel) -> None:
    """Write `model`'s tensors, grids and constants into the bundle in `folder`."""
    manifest = json_format.Parse((folder / "manifest.json").read_text(encoding="utf-8"), BundleManifest())
    path = folder / "models" / "weights.bin"
    weights = bytearray(path.read_bytes())
    for name, tensor in model.state_dict().items():
        data = tensor.detach().numpy().astype(np.float32)
        weights.extend(bytes(-len(weights) % 256))
        manifest.tensors.add(
            name=name,
            dtype="float32",
            shape=data.shape,
            offset_bytes=len(weights),
            size_bytes=data.nbytes,
        )
        weights.extend(data.tobytes())
    path.write_bytes(bytes(weights))
    for name, module in model.named_modules():
        if isinstance(module, HashGrid):
            layout = module.layout
            grid = manifest.grids.add(
                name=name,
                tensor=f"{name}.table",
                num_features=layout.num_features,
                half_extent=layout.half_extent,
                output_scale=1.0,
            )
            for level in layout.levels:
                grid.levels.add(
                    resolution=level.resolution,
                    first_row=level.first_row,
                    num_rows=level.num_rows,
                    multiplier_y=level.multiplier_y,
                    multiplier_z=level.multiplier_z,
                )
    config, domain = model.config, model.domain
    layers = config.fast.distance_layers
    constants = {
        "fast_cache_sky": {
            "kind": "fast_cache.v1",
            "contraction_radius": domain.contraction_radius,
            "near": domain.secondary[0],
            "far": domain.secondary[1],
            "num_samples": config.fast.num_samples,
            "num_frequencies": config.fast.num_frequencies,
            "skip_after": 3 if layers > 3 else None,
            "curve_power": -1.5,
            "curve_premultiplier": 2.0,
        },
        "material": {
            "kind": "material.v1",
            "contraction_radius": domain.contraction_radius,
            "albedo_bias": config.materials.albedo_bias,
            "alpha_bias": config.materials.alpha_bias,
            "metalness_bias": config.materials.metalness_bias,
            "alpha_minimum": 1e-4,
            "softplus_beta": config.nerf.density.softplus_beta,
        },
    }
    for name, values in constants.items():
        set_network_metadata(folder, name, values)
    write_manifest(folder, manifest)


def set_network_metadata(folder: Path, graph: str, values: dict) -> None:
    """Write `values` as the constants of a graph's network."""
    path = folder / "models" / f"{graph}.onnx"
    model = onnx.load(path, load_external_data=False)
    onnx.helper.set_model_props(model, {"lambent.network": json.dumps(values)})
    path.write_bytes(model.SerializeToString())
