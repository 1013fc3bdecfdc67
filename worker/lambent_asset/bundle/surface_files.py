"""The asset of a bundle: a textured mesh of the trained model, written as glTF."""

import logging
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from flashcache.config import ExportConfig
from flashcache.physical.model import InverseModel
from lambent_core.scene import Camera
from lambent_proto.v1 import bundle_pb2
from lambent_relight import cameras as relight_cameras
from lambent_relight.baked.raster import block_means, nearest_texel, rasterise
from lambent_relight.bundle.archive import open_source
from lambent_relight.bundle.bundle import WEIGHTS_PATH, Bundle
from lambent_relight.bundle.graphs import OnnxCaches, SurfaceCaches
from lambent_relight.fused.reader import FusedCaches
from lambent_relight.fused.weights import NotFused
from numpy.typing import NDArray
from PIL import Image

from lambent_asset.bundle.glb import check_glb, write_glb
from lambent_asset.bundle.mesh_levels import level_textures, levels_of_detail
from lambent_asset.bundle.transport_files import mesh_positions
from lambent_asset.bundle.usd import write_usdz
from lambent_asset.mesh.mesh import Corner
from lambent_asset.mesh.mesh_health import mesh_health
from lambent_asset.textures.surface import AtlasSurface
from lambent_asset.textures.surface_occlusion import bake_occlusion
from lambent_asset.textures.textures import Plane, TextureSet, bake_materials
from lambent_asset.transport.transport_rays import TriangleRays

ASSET_PATH = "mesh/asset.glb"
USDZ_PATH = "mesh/asset.usdz"
UNSEEN_PATH = "mesh/unseen.png"
SUPERSAMPLING = 4
"""Samples of a silhouette along each side of a pixel."""


def write_asset(
    model: InverseModel,
    surface: AtlasSurface,
    albedo: Plane | None,
    config: ExportConfig,
    manifest: bundle_pb2.BundleManifest,
    folder: Path,
) -> None:
    """Write mesh/asset.glb, and .usdz if requested, into `folder`.

    `albedo` is the texture made from the photographs, None for the model's.
    What no photograph shows is marked in mesh/unseen.png. Levels of detail are written beside the mesh, but
    not into a lite bundle.
    Raises WorkerError where the file is not read back as it was meant.
    """
    rays = TriangleRays(surface.vertices, surface.faces)
    occlusion = bake_occlusion(
        replace(surface, positions=mesh_positions(surface)),
        rays,
        origin_offset=rays.offset,
        num_points=config.occlusion_points,
        num_rays=config.occlusion_rays,
    )
    textures = bake_materials(model, surface, occlusion, albedo)
    source = "model" if albedo is None else "photographs"
    write_mesh(surface, textures, manifest, folder, source=source, usdz=config.usdz)
    # A lite bundle is fetched as a whole, by programs that show its mesh as it is.
    if config.transport_tier != "lite":
        write_levels(surface, textures, manifest, folder)
    write_unseen(surface, manifest, folder)
    manifest.metrics["mesh_simplification_error"] = surface.mesh_error
    health = mesh_health(surface.vertices, surface.faces)
    manifest.metrics["mesh_boundary_edges"] = health.boundary_edges
    manifest.metrics["mesh_non_manifold_edges"] = health.non_manifold_edges
    manifest.metrics["mesh_pieces"] = health.pieces


def write_mesh(
    surface: AtlasSurface,
    textures: TextureSet,
    manifest: bundle_pb2.BundleManifest,
    folder: Path,
    *,
    source: str,
    usdz: bool,
) -> None:
    """Write mesh/asset.glb, and .usdz if requested; state its atlas, whose albedo is from `source`.

    Raises WorkerError where the file is not read back as it was meant.
    """
    asset = write_glb(surface, textures, unit=manifest.world.unit)
    check_glb(asset, surface)
    (folder / ASSET_PATH).write_bytes(asset)
    if usdz:
        write_usdz(folder / USDZ_PATH, surface, textures)
    size, atlas = len(textures.albedo), manifest.atlas
    atlas.size, atlas.material_size, atlas.albedo_source = size, surface.size, source
    atlas.texel_size = surface.texel_size * surface.size / size
    manifest.metrics["mesh_faces"] = len(surface.faces)
    manifest.metrics["mesh_vertices"] = len(surface.vertices)


def write_levels(
    surface: AtlasSurface, textures: TextureSet, manifest: bundle_pb2.BundleManifest, folder: Path
) -> None:
    """Write the levels of detail of `surface` as mesh/lod1.glb and so on, and list them."""
    for number, level in enumerate(levels_of_detail(surface), 1):
        path = f"mesh/lod{number}.glb"
        small = level_textures(textures, level, 2**number)
        (folder / path).write_bytes(write_glb(level, small, unit=manifest.world.unit))
        manifest.mesh_levels.add(path=path, num_faces=len(level.faces), texture_size=len(small.albedo))


def write_unseen(surface: AtlasSurface, manifest: bundle_pb2.BundleManifest, folder: Path) -> None:
    """Write the mask of texels that no photograph shows, if there are any, and state their share."""
    if not len(surface.unseen):
        return
    manifest.metrics["mesh_unseen_share"] = float(surface.unseen.mean())
    if not surface.unseen.any():
        return
    marked = surface.unseen[nearest_texel(surface.texel_index, surface.size)]
    Image.fromarray(np.where(marked, 255, 0).astype(np.uint8)).save(folder / UNSEEN_PATH)
    manifest.atlas.unseen_path = UNSEEN_PATH


def written_caches(manifest: bundle_pb2.BundleManifest, folder: Path) -> SurfaceCaches:
    """Return the written graphs as clients evaluate them: compiled, or run by onnxruntime."""
    listed = bundle_pb2.BundleManifest()
    listed.CopyFrom(manifest)
    # Files are listed last, when all are there.
    listed.files.add(path=WEIGHTS_PATH)
    bundle = Bundle(path=folder, manifest=listed, source=open_source(folder))
    try:
        return FusedCaches(bundle)
    except NotFused as reason:
        logging.getLogger(__name__).info("asset.caches_by_onnxruntime: %s", reason)
        return OnnxCaches(bundle)


def pixel_size(cameras: Iterable[Camera], box: tuple[Corner, Corner]) -> float:
    """Return the footprint of a pixel at the centre of `box`, scene units: median over cameras, else 0."""
    middle = 0.5 * (np.array(box[0]) + np.array(box[1]))
    sizes = [
        float(np.linalg.norm(np.asarray(camera.camera_to_world)[:3, 3] - middle)) / camera.focal_x
        for camera in cameras
    ]
    return float(np.median(sizes)) if sizes else 0.0


def silhouette_iou(
    surface: AtlasSurface, camera: relight_cameras.Camera, opacity: NDArray[np.floating]
) -> float:
    """Return the overlap of the mesh's silhouette with the volume's `opacity` [height, width, 1], 0..1.

    Intersection over union of partial coverage: the sum of the smaller values divided by that of the larger.
    """
    height, width = camera.height * SUPERSAMPLING, camera.width * SUPERSAMPLING
    fragments = rasterise(surface.vertices, surface.faces, camera.resized(width, height))
    covered = block_means(fragments.covered.astype(np.float32), SUPERSAMPLING)
    seen = np.clip(opacity.reshape(covered.shape), 0.0, 1.0)
    union = float(np.maximum(covered, seen).sum())
    return float(np.minimum(covered, seen).sum()) / union if union > 0.0 else 1.0
