"""manifest.json: the contents of a bundle and the meaning of its numbers."""

import hashlib
import json
import subprocess
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from flashcache.export.onnx import WeightFile
from flashcache.kernels.layout import GridLayout
from flashcache.physical.model import InverseModel
from lambent_core.messages import message_to_dict
from lambent_proto import BUNDLE_VERSION
from lambent_proto.v1 import bundle_pb2
from lambent_relight.bundle.uncertainty import PATH, UncertaintyGrid

from lambent_asset.bundle.parity import TOLERANCE, ParityResult
from lambent_asset.mesh.mesh import Corner

# By folder and suffix.
_ROLES = {
    ("models", ".onnx"): "graph",
    ("models", ".bin"): "weights",
    ("mesh", ".glb"): "mesh",
    ("mesh", ".png"): "mask",
    ("mesh", ".usdz"): "mesh",
    ("transport", ".bin"): "transport",
    ("env", ".exr"): "environment",
    ("", ".json"): "cameras",
    ("", ".webp"): "poster",
    ("preview", ".png"): "preview",
    ("uncertainty", ".npy"): "uncertainty",
}


def new_manifest(
    model: InverseModel, box: tuple[Corner, Corner], *, name: str, preset: str, scene_id: str, train_step: int
) -> bundle_pb2.BundleManifest:
    """Return a manifest of everything but lights, files, graphs, weights and metrics."""
    manifest = bundle_pb2.BundleManifest(
        schema_version=BUNDLE_VERSION,
        scene_id=scene_id,
        name=name,
        created_at=datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
        preset=preset,
        albedo_scale_rgb=[1.0, 1.0, 1.0],
    )
    manifest.generator.name, manifest.generator.version = "lambent", version("lambent")
    manifest.generator.git_revision, manifest.generator.train_step = git_revision(), train_step
    world = manifest.world
    world.up_axis, world.handedness, world.unit = "z", "right", "unknown"
    world.environment_convention, world.radiance = "tensoir", "linear-rec709"
    manifest.bounds.minimum.extend(box[0])
    manifest.bounds.maximum.extend(box[1])
    manifest.secondary_rays.origin_offset = model.limits.origin_offset
    manifest.secondary_rays.near, manifest.secondary_rays.far = model.domain.secondary
    return manifest


def add_graph(
    manifest: bundle_pb2.BundleManifest, name: str, path: str, light: str, parity: ParityResult
) -> None:
    """Add a checked graph."""
    manifest.graphs.add(
        name=name,
        path=path,
        light=light,
        parity=bundle_pb2.Parity(
            max_abs_error=parity.max_abs_error, tolerance=TOLERANCE, num_samples=parity.num_samples
        ),
        rounding=parity.rounding,
    )


def add_weights(
    manifest: bundle_pb2.BundleManifest, weights: WeightFile, grids: Mapping[str, GridLayout]
) -> None:
    """Add the tensors of the weight file and the feature grids among them."""
    for tensor in weights.tensors.values():
        manifest.tensors.add(
            name=tensor.name,
            dtype=tensor.values.dtype.name,
            shape=tensor.values.shape,
            offset_bytes=tensor.offset_bytes,
            size_bytes=tensor.values.nbytes,
        )
    for name, layout in grids.items():
        manifest.grids.add(
            name=name,
            tensor=f"{name}.table",
            num_features=layout.num_features,
            half_extent=layout.half_extent,
            levels=[bundle_pb2.GridLevel(**asdict(level)) for level in layout.levels],
        )


def write_uncertainty(folder: Path, manifest: bundle_pb2.BundleManifest, grid: UncertaintyGrid) -> None:
    """Write the grid below `folder` and say in the manifest where it is and what it covers."""
    (folder / PATH).parent.mkdir(parents=True, exist_ok=True)
    (folder / PATH).write_bytes(grid.to_bytes())
    stated = manifest.uncertainty
    stated.path = PATH
    stated.channels.extend(grid.channels)
    stated.box.minimum.extend(grid.low.tolist())
    stated.box.maximum.extend(grid.high.tolist())


def write_manifest(folder: Path, manifest: bundle_pb2.BundleManifest) -> None:
    """Write manifest.json into `folder`, listing all files there."""
    del manifest.files[:]
    files = [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()]
    for path in sorted(set(files) - {"manifest.json"}):
        data = (folder / path).read_bytes()
        manifest.files.add(
            path=path,
            size_bytes=len(data),
            sha256=hashlib.sha256(data).hexdigest(),
            role=_ROLES[path.rpartition("/")[0], Path(path).suffix],
        )
    text = json.dumps(message_to_dict(manifest), indent=1)
    (folder / "manifest.json").write_text(text + "\n", encoding="utf-8")


def git_revision() -> str:
    """Return the commit of the source tree this module was imported from, or "" where it is installed."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
