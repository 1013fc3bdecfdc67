"""Material textures of an atlas, as planes of numbers and as the PNG files that glTF refers to.

Planes are [size, size, n] float32, rows from the top, every texel filled: those outside charts repeat their
nearest covered texel, so that filtering and small versions of a texture find no foreign colour. The albedo
may have a size of its own; the others have the surface's, which is as fine as the model.
"""

import io
from dataclasses import dataclass

import numpy as np
import torch
from flashcache.color import perceptual_roughness_from_alpha
from flashcache.physical.model import InverseModel
from lambent_core.colour import srgb_from_linear
from lambent_relight.baked.raster import interpolate, nearest_texel, rasterise_uv
from numpy.typing import NDArray
from PIL import Image

from lambent_asset.mesh.atlas import tangents, unit
from lambent_asset.mesh.mesh_unseen import plain_where_unseen
from lambent_asset.textures.surface import AtlasSurface

Plane = NDArray[np.float32]
CHUNK_POINTS = 32768
ROWS_AT_ONCE = 256
LEAST_Z = 0.05
"""A normal of the normal map keeps this share of the vertex normal, so that no texel faces inwards."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TextureSet:
    """The textures of a surface."""

    albedo: Plane
    """Base colour, linear Rec. 709."""
    perceptual_roughness: Plane
    metalness: Plane
    occlusion: Plane
    """Share of cosine-weighted light from a uniform surround that reaches the surface, 0..1."""
    tangent_normal: Plane
    """Unit, in the frame of the interpolated vertex tangents: x along u, y towards falling v, z outwards."""


def bake_materials(
    model: InverseModel,
    surface: AtlasSurface,
    occlusion: NDArray[np.float32],
    albedo: Plane | None = None,
) -> TextureSet:
    """Return the textures of `surface` from the trained materials and the occlusion of covered texels.

    `albedo` is a texture of another size that takes the place of the model's.
    """
    owner = nearest_texel(surface.texel_index, surface.size)
    planes = _materials(model, surface.positions)
    if len(surface.unseen):
        planes = {
            name: plain_where_unseen(values, surface.positions, surface.unseen)
            for name, values in planes.items()
        }
    return TextureSet(
        albedo=planes["albedo"][owner] if albedo is None else albedo,
        perceptual_roughness=planes["perceptual_roughness"][owner],
        metalness=planes["metalness"][owner],
        occlusion=np.clip(occlusion, 0.0, 1.0).astype(np.float32).reshape(-1, 1)[owner],
        tangent_normal=tangent_normals(surface)[owner],
    )


def tangent_normals(surface: AtlasSurface) -> NDArray[np.float32]:
    """Return the normals of covered texels in the frames a viewer reconstructs there, unit.

    The frame is the interpolated vertex normal and tangent, both made unit, and w times their cross product;
    it is not quite orthogonal, so that coordinates are found by solving for them.
    """
    frame = tangents(surface.vertices, surface.faces, surface.uv, surface.normals)
    places = rasterise_uv(surface.uv, surface.faces, surface.size)
    normal = unit(interpolate(places, surface.faces, surface.normals)).astype(np.float64)
    tangent = interpolate(places, surface.faces, frame).astype(np.float64)
    along = unit(tangent[:, :3])
    across = unit(np.sign(tangent[:, 3:]) * np.cross(normal, along))
    matrix = np.stack([along, across, normal], axis=-1)
    # If a tangent is parallel to the normal there is no valid frame: keep the vertex normal.
    poor = np.abs(np.linalg.det(matrix)) < 1e-3
    matrix[poor] = np.eye(3)
    local = np.linalg.solve(matrix, surface.texel_normals[..., None].astype(np.float64))[..., 0]
    local[poor] = [0.0, 0.0, 1.0]
    local[:, 2] = np.maximum(local[:, 2], LEAST_Z)
    return unit(local).astype(np.float32)


@torch.no_grad()
def _materials(model: InverseModel, positions: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
    device = next(model.parameters()).device
    parts = []
    for start in range(0, len(positions), CHUNK_POINTS):
        materials = model.materials(torch.from_numpy(positions[start : start + CHUNK_POINTS]).to(device))
        roughness = perceptual_roughness_from_alpha(materials.alpha)
        parts.append((materials.albedo.cpu(), roughness.cpu(), materials.metalness.cpu()))
    names = ("albedo", "perceptual_roughness", "metalness")
    return {
        name: torch.cat([part[k] for part in parts]).numpy().reshape(len(positions), -1)
        for k, name in enumerate(names)
    }


def base_colour_png(textures: TextureSet) -> bytes:
    """Return the base colour, sRGB-encoded, as glTF wants it."""
    levels = np.empty(textures.albedo.shape, np.uint8)
    for first in range(0, len(levels), ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        levels[rows] = _levels(srgb_from_linear(textures.albedo[rows]))
    return _png(levels)


def occlusion_roughness_metalness_png(textures: TextureSet) -> bytes:
    """Return occlusion in red, perceptual roughness in green and metalness in blue, linear."""
    planes = [textures.occlusion, textures.perceptual_roughness, textures.metalness]
    return _png(_levels(np.concatenate(planes, axis=-1)))


def normal_png(textures: TextureSet) -> bytes:
    """Return the tangent-space normals, -1..1 as 0..1, green towards the top of the texture."""
    return _png(_levels(0.5 * textures.tangent_normal + 0.5))


def _levels(values: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)


def _png(levels: NDArray[np.uint8]) -> bytes:
    image = Image.fromarray(levels)
    out = io.BytesIO()
    image.save(out, format="PNG")
    return out.getvalue()
