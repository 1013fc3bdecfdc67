"""A complete bundle whose graphs are exact ray tracing of an analytic scene."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import onnx
from google.protobuf import json_format
from lambent_proto import BUNDLE_VERSION
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_relight.cameras import Camera, cameras_json, turntable
from support.analytic_scene import FAR, AnalyticScene
from support.onnx_expressions import OnnxOps, Value

_ROLES = {".onnx": "graph", ".bin": "weights", ".json": "cameras"}


def gbuffer_model(scene: AnalyticScene) -> onnx.ModelProto:
    """Return origin, direction -> surface, as the gbuffer graph of a bundle."""
    ops = OnnxOps()
    origin, direction = Value(ops, "origin"), Value(ops, "direction")
    distance, hits = scene.first_hit(ops, origin, direction, ops.constant(0.0))
    albedo, roughness, metalness, normal = scene.surface_at(ops, origin + distance * direction)
    opacity = ops.where(hits, ops.constant(1.0), ops.constant(0.0))
    outputs = {
        "opacity": (opacity, 1),
        "distance": (distance, 1),
        "normal": (normal, 3),
        "albedo": (albedo, 3),
        "perceptual_roughness": (roughness, 1),
        "metalness": (metalness, 1),
    }
    return ops.model("ray", ["origin", "direction"], outputs)


def fast_cache_model(scene: AnalyticScene) -> onnx.ModelProto:
    """Return origin, direction -> radiance (none), opacity, distance."""
    ops = OnnxOps()
    origin, direction = Value(ops, "origin"), Value(ops, "direction")
    distance, hits = scene.first_hit(ops, origin, direction, ops.constant(scene.near))
    opacity = ops.where(hits, ops.constant(1.0), ops.constant(0.0))
    outputs = {"radiance": (direction * 0.0, 3), "opacity": (opacity, 1), "distance": (distance, 1)}
    return ops.model("ray", ["origin", "direction"], outputs)


def material_model(scene: AnalyticScene) -> onnx.ModelProto:
    """Return position -> surface properties of the nearest shape."""
    ops = OnnxOps()
    position = Value(ops, "position")
    albedo, roughness, metalness, normal = scene.surface_at(ops, position)
    outputs = {
        "albedo": (albedo, 3),
        "perceptual_roughness": (roughness, 1),
        "metalness": (metalness, 1),
        "normal": (normal, 3),
        "opacity": (roughness * 0.0 + 1.0, 1),
    }
    return ops.model("point", ["position"], outputs)


def _move_weights(model: onnx.ModelProto, weights: bytearray) -> None:
    """Move the model's constants behind `weights`, each at a multiple of 256 bytes."""
    for tensor in model.graph.initializer:
        data = onnx.numpy_helper.to_array(tensor).tobytes()
        if tensor.data_type != onnx.TensorProto.FLOAT:
            continue  # axes must be known when the graph is opened
        weights.extend(bytes(-len(weights) % 256))
        entries = {"location": "weights.bin", "offset": len(weights), "length": len(data)}
        weights.extend(data)
        tensor.ClearField("raw_data")
        tensor.data_location = onnx.TensorProto.EXTERNAL
        for key, value in entries.items():
            tensor.external_data.add(key=key, value=str(value))


def write_manifest(folder: Path, manifest: BundleManifest) -> None:
    """Write `manifest` with the files that lie in `folder` now."""
    del manifest.files[:]
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and p.name != "manifest.json"):
        data = path.read_bytes()
        manifest.files.add(
            path=path.relative_to(folder).as_posix(),
            size_bytes=len(data),
            sha256=hashlib.sha256(data).hexdigest(),
            role=_ROLES.get(path.suffix, "report"),
        )
    text = json_format.MessageToJson(
        manifest, preserving_proto_field_name=True, always_print_fields_with_no_presence=True
    )
    (folder / "manifest.json").write_text(text, encoding="utf-8")


def manifest_of(scene: AnalyticScene) -> BundleManifest:
    """Return a manifest without files."""
    manifest = BundleManifest(
        schema_version=BUNDLE_VERSION, scene_id="analytic", name="analytic", preset="none"
    )
    manifest.train_lights.append("sky")
    manifest.world.up_axis, manifest.world.handedness, manifest.world.unit = "z", "right", "unknown"
    manifest.world.environment_convention, manifest.world.radiance = "tensoir", "linear-rec709"
    manifest.bounds.minimum.extend([-2.0] * 3)
    manifest.bounds.maximum.extend([2.0] * 3)
    manifest.secondary_rays.origin_offset = scene.origin_offset
    manifest.secondary_rays.near, manifest.secondary_rays.far = scene.near, FAR
    manifest.albedo_scale_rgb.extend([1.0] * 3)
    for name, light in (("gbuffer", ""), ("material", ""), ("fast_cache", "sky")):
        manifest.graphs.add(name=name, path=f"models/{name}{'_' if light else ''}{light}.onnx", light=light)
    return manifest


def write_analytic_bundle(
    folder: Path, scene: AnalyticScene, cameras: Sequence[Camera] | None = None
) -> Path:
    """Write a bundle for `scene` into `folder` and return it."""
    (folder / "models").mkdir(parents=True)
    weights = bytearray()
    models = {
        "gbuffer": gbuffer_model(scene),
        "material": material_model(scene),
        "fast_cache_sky": fast_cache_model(scene),
    }
    for name, model in models.items():
        onnx.checker.check_model(model, full_check=True)
        _move_weights(model, weights)
        (folder / "models" / f"{name}.onnx").write_bytes(model.SerializeToString())
    (folder / "models" / "weights.bin").write_bytes(bytes(weights))
    cameras = cameras or turntable(4, radius=4.0, width=16, height=16)
    (folder / "cameras.json").write_text(cameras_json(cameras), encoding="utf-8")
    write_manifest(folder, manifest_of(scene))
    return folder
