"""The textures in a bundle's mesh/asset.glb.

The file may come from an untrusted source, so everything in it is checked before use.
"""

import io
import struct
from typing import Any

import numpy as np
from lambent_core.errors import BundleError
from numpy.typing import NDArray
from PIL import Image

from lambent_relight.baked.mesh import UNREADABLE, glb_chunks, glb_view
from lambent_relight.bundle.bundle import MAX_ATLAS

_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def texture_files(data: bytes) -> tuple[bytes, bytes, bytes]:
    """Return base colour (sRGB-encoded); occlusion, roughness and metalness; and normals, of a GLB, as PNGs.

    Raises BundleError `bundle.mesh_invalid` where they are missing.
    """
    try:
        document, payload = glb_chunks(data)
        colour, packed, normal = (texture_png(document, payload, each) for each in textures_of(document))
    except UNREADABLE as error:
        raise BundleError(
            "bundle.mesh_invalid",
            f"mesh/asset.glb has no textures that can be read ({str(error)[:100]})",
            "export the bundle again with `lambent export`",
        ) from error
    return colour, packed, normal


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


def pixels_of(png: bytes) -> NDArray[np.uint8]:
    """Return the 8-bit pixels [height, width, 3] of a PNG file."""
    with Image.open(io.BytesIO(png), formats=("PNG",)) as image:
        return np.asarray(image.convert("RGB"))


def texture_png(document: dict[str, Any], payload: bytes, texture: dict[str, Any]) -> bytes:
    """Return the PNG file of a texture; raises ValueError for one that is not a PNG, or too large."""
    data = glb_view(document, payload, document["images"][texture["source"]]["bufferView"])
    if not data.startswith(_SIGNATURE):
        raise ValueError("a texture is not a PNG")
    # Before anything is decoded: some bytes can state pictures of gigabytes.
    width, height = struct.unpack_from(">II", data, 16)
    if max(width, height) > MAX_ATLAS:
        raise ValueError(f"a texture of {width} x {height} texels, more than {MAX_ATLAS} a side")
    try:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            image.load()
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError("a texture is not a PNG") from error
    return data
