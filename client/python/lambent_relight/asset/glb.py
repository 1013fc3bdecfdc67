"""The GLB of an asset with other textures than the bundle's: absolute albedo, WebP, or KTX 2.

Everything but the images stays as the bundle has it. Source: glTF 2.0 specification, section 4 (GLB);
EXT_texture_webp.
"""

import io
from collections.abc import Mapping
from typing import Any

from lambent_core.errors import BundleError
from PIL import Image

from lambent_relight.asset.ktx2 import KTX2, MIME, ktx2_of
from lambent_relight.asset.textured_mesh import TexturedMesh
from lambent_relight.baked.mesh import UNREADABLE, glb_chunks, glb_of, glb_view
from lambent_relight.baked.mesh_textures import textures_of

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
        try:
            content = files[number] if number in files else glb_view(document, payload, number)
            view["byteOffset"], view["byteLength"] = len(packed), len(content)
        except UNREADABLE as error:
            raise BundleError(
                "bundle.mesh_invalid", f"mesh/asset.glb has a part {number} that leaves it", "export it again"
            ) from error
        packed += content + b"\0" * (-len(content) % 4)
    document["buffers"] = [{"byteLength": len(packed)}]
    return glb_of(document, bytes(packed))
