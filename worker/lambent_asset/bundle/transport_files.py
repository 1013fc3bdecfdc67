"""The transport of an exported bundle: baked from the graphs just written, stored, and compared."""

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime
from flashcache.export.onnx import WeightFile
from flashcache.export.relight_graph import relight, relight_graph
from jaxtyping import Float
from lambent_compute.threads import available_threads
from lambent_core.errors import WorkerError
from lambent_proto.v1 import bundle_pb2
from lambent_relight.baked.raster import interpolate, rasterise_uv
from lambent_relight.baked.transport import Transport
from lambent_relight.bundle.graphs import SurfaceCaches
from numpy import ndarray

from lambent_asset.bundle.graphs import PARITY_ROWS
from lambent_asset.bundle.manifest import add_graph
from lambent_asset.bundle.parity import TOLERANCE, ParityResult
from lambent_asset.mesh.mesh_unseen import plain_where_unseen
from lambent_asset.textures.surface import AtlasSurface
from lambent_asset.transport.transport import TransportConfig, bake_transport
from lambent_asset.transport.transport_bounce import Reflectors
from lambent_asset.transport.transport_rays import BakedSurface, TriangleRays


def baked_transport(
    caches: SurfaceCaches,
    surface: AtlasSurface,
    folder: Path,
    config: TransportConfig,
    *,
    store: Path,
    advance: Callable[[float], None],
) -> tuple[Transport, dict[str, float]]:
    """Return the transport of `surface`, and metrics of the bake; the graphs lie in `folder`/models.

    Materials are those of `caches`; rays are traced against the mesh. Finished ones lie in `store` until the
    bake is done. `advance` is called with the finished share and may raise to stop.
    """
    trained = caches.material(surface.positions)
    materials = [
        plain_where_unseen(values, surface.positions, surface.unseen) if len(surface.unseen) else values
        for values in (trained.albedo, trained.perceptual_roughness, trained.metalness)
    ]
    reflectors = Reflectors(*materials)
    covered = BakedSurface(
        surface.size, surface.texel_index, mesh_positions(surface), surface.texel_normals.astype(np.float32)
    )
    rays = TriangleRays(surface.vertices, surface.faces)
    digest = hashlib.sha256(repr(config.rays).encode())
    for array in (covered.positions, covered.normals, surface.vertices, surface.faces):
        digest.update(np.ascontiguousarray(array).tobytes())
    transport, figures = bake_transport(
        covered,
        reflectors,
        rays,
        origin_offset=rays.offset,
        config=config,
        store=store / digest.hexdigest()[:16],
        advance=advance,
        num_threads=available_threads(),
    )
    shutil.rmtree(store, ignore_errors=True)
    return transport, figures


def mesh_positions(surface: AtlasSurface) -> Float[ndarray, "texels 3"]:
    """Return the places of the covered texels on the mesh itself, scene units."""
    fragments = rasterise_uv(surface.uv, surface.faces, surface.size)
    return interpolate(fragments, surface.faces, surface.vertices)


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
    (radiance,) = session.run(["radiance"], inputs)
    expected = relight(**{name: values.astype(np.float64) for name, values in inputs.items()})
    error = float((np.abs(radiance - expected) / np.maximum(1.0, np.abs(expected))).max())
    if not error <= TOLERANCE:
        raise WorkerError(
            "export.parity",
            f'the graph "models/relight.onnx" differs from its formula by {error:.2e} (allowed: '
            f"{TOLERANCE:.0e}); the bundle was not written. Report this with the version of onnxruntime "
            f"({onnxruntime.__version__})",
        )
    (folder / "models" / "relight.onnx").write_bytes(data)
    result = ParityResult(max_abs_error=error, num_samples=len(radiance), num_left_out=0)
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
