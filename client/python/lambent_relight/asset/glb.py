"""The GLB of an asset with other textures than the bundle's: absolute albedo, WebP, or KTX 2.

Everything but the images stays as the bundle has it. Source: glTF 2.0 specification, section 4 (GLB);
EXT_texture_webp.
"""

import io
import json
import struct
from collections.abc import Mapping
from typing import Any

from lambent_core.errors import BundleError
from PIL import Image

from lambent_relight.asset.ktx2 import KTX2, MIME, ktx2_of
from lambent_relight.asset.textured_mesh import TexturedMesh, textures_of
from lambent_relight.baked.mesh import glb_chunks

WEBP = "EXT_texture_webp"


def glb_with_textures(data: bytes, mesh: TexturedMesh, *, webp: bool = False, ktx2: bool = False) -> bytes:
    """Return the GLB `data` of a bundle with the textures of `mesh`, which was read from it.

    With `webp` they are lossless WebP, with `ktx2` KTX 2 files (`write_formats` refuses both at once), and
    there is no PNG to fall back to: readers need EXT_texture_webp or KHR_texture_basisu. Raises BundleError
    `bundle.mesh_invalid` for a file with parts that leave it, and ExportError as `ktx2_of` does.
    """
    document, payload = glb_chunks(data)
    pictures = (mesh.base_colour_png, mesh.packed_png, mesh.normal_png)
    extension, mime = (WEBP, "image/webp") if webp else (KTX2, MIME)
    files = {}
    for number, (texture, png) in enumerate(zip(textures_of(document), pictures, strict=True)):
        image = document["images"][texture["source"]]
        files[image["bufferView"]] = _webp(png) if webp else ktx2_of(png, srgb=number == 0) if ktx2 else png
        if webp or ktx2:
            image["mimeType"] = mime
            texture["extensions"] = {extension: {"source": texture.pop("source")}}
    if webp or ktx2:
        document["extensionsUsed"] = document["extensionsRequired"] = [extension]
    return packed_glb(document, payload, files)


def _webp(png: bytes) -> bytes:
    file = io.BytesIO()
    with Image.open(io.BytesIO(png), formats=("PNG",)) as image:
        image.save(file, format="WEBP", lossless=True, method=4)
    return file.getvalue()


def packed_glb(document: dict[str, Any], payload: bytes, files: Mapping[int, bytes]) -> bytes:
    """Return a GLB whose buffer views hold what they held in `payload`, or what `files` has for them."""
    packed = bytearray()
    for number, view in enumerate(document["bufferViews"]):
        stated = view if isinstance(view, dict) else {}
        start, size = stated.get("byteOffset", 0), stated.get("byteLength")
        if not all(isinstance(n, int) and n >= 0 for n in (start, size)) or start + size > len(payload):
            raise BundleError(
                "bundle.mesh_invalid", f"mesh/asset.glb has a part {number} that leaves it", "export it again"
            )
        content = files.get(number, payload[start : start + size])
        view["byteOffset"], view["byteLength"] = len(packed), len(content)
        packed += content + b"\0" * (-len(content) % 4)
    document["buffers"] = [{"byteLength": len(packed)}]
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(packed), 0x004E4942) + packed
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks
