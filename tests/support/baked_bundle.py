"""A bundle of boxes with exact graphs, a mesh with an atlas, and light transport baked from exact rays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from google.protobuf import json_format
from lambent_asset.bundle.glb import write_glb
from lambent_asset.textures.surface import AtlasSurface
from lambent_asset.textures.textures import TextureSet, tangent_normals
from lambent_asset.transport.transport import TransportConfig, bake_transport
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_relight.baked.mesh import glb_of
from lambent_relight.baked.raster import nearest_texel
from lambent_relight.baked.transport import Transport, transport_files
from lambent_relight.cameras import Camera
from support.analytic_bundle import write_analytic_bundle, write_manifest
from support.analytic_scene import AnalyticScene, Box, NumpyOps, Surface
from support.quad_surface import Quad, surface_of

SLAB = Box((-1.0, -1.0, -0.6), (1.0, 1.0, -0.4), Surface(albedo=(0.6, 0.6, 0.6), perceptual_roughness=0.7))
BLOCK = Box((-0.4, -0.4, -0.4), (0.4, 0.4, 0.4), Surface(albedo=(0.8, 0.3, 0.2), perceptual_roughness=0.6))
SCENE = AnalyticScene((SLAB, BLOCK))


def quads_of(box: Box) -> list[Quad]:
    """Return the six sides of a box, facing outwards."""
    low, high = np.array(box.minimum), np.array(box.maximum)
    surface = {
        "albedo": box.surface.albedo,
        "perceptual_roughness": box.surface.perceptual_roughness,
        "metalness": box.surface.metalness,
    }
    quads = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        for top in (False, True):
            corner, u, v = low.copy(), np.zeros(3), np.zeros(3)
            corner[axis] = high[axis] if top else low[axis]
            u[first], v[second] = high[first] - low[first], high[second] - low[second]
            if not top:
                u, v = v, u
            quads.append(Quad(tuple(corner), tuple(u), tuple(v), **surface))
    return quads


def glb(vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> bytes:
    """Return a binary glTF file with positions, coordinates, indices and frames, which has no textures."""
    arrays = [vertices.astype("<f4"), uv.astype("<f4"), faces.astype("<u4").reshape(-1, 1)]
    arrays += [np.tile(np.float32(frame), (len(vertices), 1)) for frame in ([0, 0, 1], [1, 0, 0, 1])]
    kinds, components = ("VEC3", "VEC2", "SCALAR", "VEC3", "VEC4"), (5126, 5126, 5125, 5126, 5126)
    data, views, accessors = b"", [], []
    for index, (array, kind, component) in enumerate(zip(arrays, kinds, components, strict=True)):
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        accessors.append({"bufferView": index, "componentType": component, "count": len(array), "type": kind})
        data += array.tobytes()
    attributes = {"POSITION": 0, "TEXCOORD_0": 1, "NORMAL": 3, "TANGENT": 4}
    primitive = {"attributes": attributes, "indices": 2}
    document = {
        "asset": {"version": "2.0"},
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return glb_of(document, data)


def boxes_surface(scene: AnalyticScene, side: int) -> tuple[AtlasSurface, TextureSet]:
    """Return the surface of a scene of boxes, each side with `side` x `side` texels, and its textures."""
    baked, reflectors, mesh = surface_of([quad for box in scene.shapes for quad in quads_of(box)], side)
    edges = mesh["vertices"][mesh["faces"]]
    facing = np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0])
    normals = np.zeros_like(mesh["vertices"])
    # Every quad has vertices of its own.
    normals[mesh["faces"].reshape(-1)] = np.repeat(facing, 3, axis=0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    surface = AtlasSurface(
        **mesh,
        normals=normals,
        size=baked.size,
        texel_index=baked.texel_index,
        positions=baked.positions,
        texel_normals=baked.normals,
        cell=0.05,
    )
    owner = nearest_texel(surface.texel_index, surface.size)
    textures = TextureSet(
        albedo=reflectors.albedo[owner],
        perceptual_roughness=reflectors.perceptual_roughness[owner],
        metalness=reflectors.metalness[owner],
        occlusion=np.ones((surface.size, surface.size, 1), np.float32),
        tangent_normal=tangent_normals(surface)[owner],
    )
    return surface, textures


def write_mesh(folder: Path, surface: AtlasSurface, textures: TextureSet, manifest: BundleManifest) -> None:
    """Write a bundle's mesh into `folder`, and its atlas into `manifest`."""
    (folder / "mesh").mkdir(exist_ok=True)
    (folder / "mesh" / "asset.glb").write_bytes(write_glb(surface, textures, unit="unknown"))
    atlas = manifest.atlas
    atlas.size, atlas.material_size = surface.size, surface.size
    atlas.texel_size, atlas.albedo_source = surface.texel_size, "model"


def exact_rays(scene: AnalyticScene):
    """Return the fast cache of an analytic scene."""

    def secondary(origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        distance, hits = scene.first_hit(NumpyOps, origin, direction, scene.near)
        return hits.astype(np.float32), distance.astype(np.float32)

    return secondary


def baked_transport(
    scene: AnalyticScene, side: int, store: Path, tier: str = "full"
) -> tuple[Transport, dict]:
    """Return transport and mesh of a scene of boxes, each side with `side` x `side` texels."""
    surface, reflectors, mesh = surface_of([quad for box in scene.shapes for quad in quads_of(box)], side)
    transport, _ = bake_transport(
        surface,
        reflectors,
        exact_rays(scene),
        origin_offset=scene.origin_offset,
        config=TransportConfig(tier=tier),
        store=store,
    )
    return transport, mesh


def write_baked_bundle(
    folder: Path,
    scene: AnalyticScene = SCENE,
    *,
    side: int = 24,
    tier: str = "full",
    cameras: list[Camera] | None = None,
) -> Path:
    """Write a bundle of boxes with baked transport into `folder` and return it."""
    write_analytic_bundle(folder, scene, cameras)
    transport, _ = baked_transport(scene, side, folder.with_name(folder.name + ".rays"), tier)
    manifest = json_format.Parse((folder / "manifest.json").read_text(), BundleManifest())
    files = transport_files(transport, manifest)
    write_mesh(folder, *boxes_surface(scene, side), manifest)
    for path, data in files.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_bytes(data)
    write_manifest(folder, manifest)
    return folder
