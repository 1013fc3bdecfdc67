"""The transport of an exported bundle: baked from the graphs just written, stored, and compared."""

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from flashcache.export.onnx import WeightFile
from flashcache.export.relight_graph import relight, relight_graph
from flashcache.physical.model import InverseModel
from jaxtyping import Float
from lambent_proto.v1 import bundle_pb2
from lambent_relight.baked.transport import Transport, transport_files
from lambent_relight.bundle.graphs import SurfaceCaches
from lambent_relight.fused.reader import FusedCaches
from numpy import ndarray

from lambent_worker.bundle.graphs import PARITY_ROWS
from lambent_worker.bundle.manifest import add_graph
from lambent_worker.bundle.parity import TOLERANCE, ParityResult
from lambent_worker.bundle.surface import AtlasSurface
from lambent_worker.bundle.transport import BakedSurface, TransportConfig, bake_transport
from lambent_worker.bundle.transport_bounce import Reflectors
from lambent_worker.bundle.transport_rays import SecondaryRays
from lambent_worker.errors import WorkerError

_RAYS_ON_DEVICE = 1 << 18


def baked_transport(
    model: InverseModel,
    caches: SurfaceCaches,
    surface: AtlasSurface,
    folder: Path,
    config: TransportConfig,
    *,
    store: Path,
    advance: Callable[[float], None],
) -> tuple[Transport, dict[str, float]]:
    """Return the transport of `surface`, and metrics of the bake; the graphs lie in `folder`/models.

    Rays are answered by `caches`, or by the model itself where it lies on a graphics card. Finished ones
    lie in `store` until the bake is done. `advance` is called with the finished share and may raise to stop.
    """
    found = caches.material(surface.positions)
    reflectors = Reflectors(found.albedo, found.perceptual_roughness, found.metalness)
    covered = BakedSurface(
        surface.size, surface.texel_index, surface.positions, surface.texel_normals.astype(np.float32)
    )
    digest = hashlib.sha256(repr(config.rays).encode())
    for array in (covered.positions, covered.normals):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update((folder / "models" / "weights.bin").read_bytes())
    num_threads = 1
    if isinstance(caches, FusedCaches) and next(model.parameters()).device.type == "cpu":
        # Compiled code is called by the threads that do everything else of a chunk.
        caches, num_threads = caches.in_callers_thread(), caches.num_threads
    transport, figures = bake_transport(
        covered,
        reflectors,
        secondary_rays(model, caches),
        origin_offset=model.limits.origin_offset,
        config=config,
        store=store / digest.hexdigest()[:16],
        advance=advance,
        num_threads=num_threads,
    )
    shutil.rmtree(store, ignore_errors=True)
    return transport, figures


def write_transport(
    transport: Transport, manifest: bundle_pb2.BundleManifest, folder: Path, *, tier: str
) -> None:
    """Write `transport` into `folder`/transport and describe it in `manifest`."""
    (folder / "transport").mkdir(exist_ok=True)
    for path, data in transport_files(transport, manifest, tier=tier).items():
        (folder / path).write_bytes(data)


def secondary_rays(model: InverseModel, caches: SurfaceCaches) -> SecondaryRays:
    """Return the fastest evaluation of secondary rays on the model's device."""
    device = next(model.parameters()).device
    if device.type == "cpu":

        def compiled(
            origin: Float[ndarray, "rays 3"], direction: Float[ndarray, "rays 3"]
        ) -> tuple[Float[ndarray, "rays 1"], Float[ndarray, "rays 1"]]:
            hits = caches.secondary(origin, direction)
            return hits.opacity, hits.distance

        return compiled

    @torch.no_grad()
    def on_device(
        origin: Float[ndarray, "rays 3"], direction: Float[ndarray, "rays 3"]
    ) -> tuple[Float[ndarray, "rays 1"], Float[ndarray, "rays 1"]]:
        parts = []
        for start in range(0, len(origin), _RAYS_ON_DEVICE):
            rows = slice(start, start + _RAYS_ON_DEVICE)
            rays = [torch.from_numpy(np.ascontiguousarray(a[rows])).to(device) for a in (origin, direction)]
            light = torch.zeros(len(rays[0]), dtype=torch.long, device=device)
            answer = model.fast(*rays, light)
            parts.append(torch.stack([answer.opacity, answer.distance], dim=-1))
        values = torch.cat(parts).float().cpu().numpy()
        return values[:, :1], values[:, 1:]

    return on_device


def write_relight_graph(manifest: bundle_pb2.BundleManifest, folder: Path, *, seed: int) -> ParityResult:
    """Write models/relight.onnx for the transport in `manifest`, once it was compared with numpy.

    Raises WorkerError `export.parity` when the graph differs from the formula by more than 1e-5.
    """
    bands = {planes.name: planes.bands for planes in manifest.transport.planes}
    sizes = (bands["direct"] ** 2, bands["visibility"] ** 2)
    metadata = {
        "flashcache.schema": manifest.schema_version,
        "flashcache.scene_id": manifest.scene_id,
        "flashcache.frame": "right-handed, z up",
        "flashcache.radiance": "linear-scene",
        "producer": f"lambent {manifest.generator.version} {manifest.generator.git_revision}".rstrip(),
    }
    data = relight_graph(*sizes, WeightFile(), metadata).SerializeToString(deterministic=True)
    inputs = _random_pixels(*sizes, seed)
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    (found,) = session.run(["radiance"], inputs)
    expected = relight(**{name: values.astype(np.float64) for name, values in inputs.items()})
    error = float((np.abs(found - expected) / np.maximum(1.0, np.abs(expected))).max())
    if not error <= TOLERANCE:
        raise WorkerError(
            "export.parity",
            f'the graph "models/relight.onnx" differs from its formula by {error:.2e} (allowed: '
            f"{TOLERANCE:.0e}); the bundle was not written. Report this with the version of onnxruntime "
            f"({onnxruntime.__version__})",
        )
    (folder / "models" / "relight.onnx").write_bytes(data)
    result = ParityResult(max_abs_error=error, num_samples=len(found), num_left_out=0)
    add_graph(manifest, "relight", "models/relight.onnx", "", result)
    return result


def _random_pixels(num_direct: int, num_visibility: int, seed: int) -> dict[str, Float[ndarray, "rows _"]]:
    rng = np.random.default_rng(seed)
    widths = {
        "transfer_direct": num_direct,
        "transfer_indirect": 27,
        "visibility": num_visibility,
        "sh_reflect": num_visibility,
    }
    inputs = {name: rng.normal(0.0, 0.3, (PARITY_ROWS, width)) for name, width in widths.items()}
    inputs["light_sh"] = rng.normal(0.0, 1.0, (num_direct, 3))
    inputs["albedo_diffuse"] = rng.uniform(0.0, 1.0, (PARITY_ROWS, 3))
    inputs["spec_prefiltered"] = rng.uniform(0.0, 2.0, (PARITY_ROWS, 3))
    return {name: values.astype(np.float32) for name, values in inputs.items()}
