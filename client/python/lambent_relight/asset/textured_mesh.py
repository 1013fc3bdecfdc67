"""The mesh of a bundle with its textures, as other formats need it.

World coordinates (z up, scene units); u to the right and v down from the top row of the textures.
Source: docs/reference/bundle-format.md (mesh). The file may come from an untrusted source.
"""

import io
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lambent_relight.baked.mesh import glb_accessor, glb_chunks, mesh_from_glb
from lambent_relight.errors import BundleError
from lambent_relight.images import linear_from_srgb, srgb_from_linear

_MAX_SIDE = 16384


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TexturedMesh:
    """Triangles and three square textures as PNG files."""

    vertices: NDArray[np.float32]
    """[vertex, 3], scene units."""
    normals: NDArray[np.float32]
    """Unit, outwards, [vertex, 3]."""
    faces: NDArray[np.int32]
    """[face, 3], counter-clockwise seen from outside."""
    uv: NDArray[np.float32]
    """[vertex, 2]."""
    base_colour_png: bytes
    """sRGB-encoded albedo."""
    packed_png: bytes
    """Linear: occlusion in red, perceptual roughness in green, metalness in blue."""
    normal_png: bytes
    """Tangent space, -1..1 as 0..1, +y towards the top of the texture."""


def textured_mesh_from_glb(data: bytes) -> TexturedMesh:
    """Return mesh and textures of a bundle's mesh/asset.glb.

    Raises BundleError `bundle.mesh_invalid` for a file that cannot be read, and for one without textures.
    """
    mesh = mesh_from_glb(data)
    try:
        document, payload = glb_chunks(data)
        attributes = document["meshes"][0]["primitives"][0]["attributes"]
        normals = glb_accessor(document, payload, attributes["NORMAL"], "VEC3")
        pictures = [_png(document, payload, texture) for texture in textures_of(document)]
    except (KeyError, IndexError, TypeError, ValueError, struct.error, RecursionError) as error:
        raise BundleError(
            "bundle.mesh_invalid",
            f"mesh/asset.glb has no normals and textures that can be read ({str(error)[:100]})",
            "export the bundle again with `lambent export`",
        ) from error
    if normals.dtype != np.float32 or normals.shape != mesh.vertices.shape or not np.isfinite(normals).all():
        raise BundleError(
            "bundle.mesh_invalid", "mesh/asset.glb has unusable normals", "export the bundle again"
        )
    colour, packed, bent = pictures
    return TexturedMesh(
        vertices=mesh.vertices,
        normals=normals,
        faces=mesh.faces,
        uv=mesh.uv,
        base_colour_png=colour,
        packed_png=packed,
        normal_png=bent,
    )


def textures_of(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the textures of a document: base colour; occlusion, roughness and metalness; normal.

    Raises KeyError, IndexError, TypeError or ValueError where they are not there, or share a picture.
    """
    material = document["materials"][0]
    surface = material["pbrMetallicRoughness"]
    slots = (surface["baseColorTexture"], surface["metallicRoughnessTexture"], material["normalTexture"])
    textures = [document["textures"][slot["index"]] for slot in slots]
    if len({document["images"][texture["source"]]["bufferView"] for texture in textures}) < len(textures):
        raise ValueError("two textures share a picture")
    return textures


def with_absolute_albedo(mesh: TexturedMesh, scale_rgb: Sequence[float]) -> TexturedMesh:
    """Return the mesh with its albedo times `scale_rgb`, clipped to [0, 1] as when it is rendered."""
    if np.allclose(scale_rgb, 1.0, atol=1e-6):
        return mesh
    albedo = linear_from_srgb(pixels_of(mesh.base_colour_png) / 255.0) * np.asarray(scale_rgb)
    return replace(mesh, base_colour_png=png_of(srgb_from_linear(albedo)))


def pixels_of(png: bytes) -> NDArray[np.uint8]:
    """Return the 8-bit pixels [height, width, 3] of a PNG file."""
    with Image.open(io.BytesIO(png), formats=("PNG",)) as image:
        return np.asarray(image.convert("RGB"))


def png_of(values: NDArray[np.floating]) -> bytes:
    """Return values in [0, 1], [height, width] or [height, width, 3], as an 8-bit PNG file."""
    file = io.BytesIO()
    Image.fromarray(np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)).save(file, format="PNG")
    return file.getvalue()


def _png(document: dict[str, Any], payload: bytes, texture: dict[str, Any]) -> bytes:
    """Return the PNG file of a texture; raises ValueError for one that is no PNG, or too large."""
    view = document["bufferViews"][document["images"][texture["source"]]["bufferView"]]
    start, size = view.get("byteOffset", 0), view["byteLength"]
    if not all(isinstance(n, int) and n >= 0 for n in (start, size)) or start + size > len(payload):
        raise ValueError("a texture leaves the file")
    data = payload[start : start + size]
    try:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            if max(image.size) > _MAX_SIDE:
                raise ValueError(f"a texture of {image.size[0]} x {image.size[1]} pixels")
            image.load()
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError("a texture is no PNG") from error
    return data
