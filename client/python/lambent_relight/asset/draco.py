"""A GLB whose mesh is packed with Draco. Needs the extra [draco].

Positions, normals and texture coordinates are rounded to the steps below; tangents and textures stay as they
are. Source: glTF extension KHR_draco_mesh_compression.
"""

from typing import Any

import numpy as np
from lambent_core.errors import BundleError, ExportError, pip_install
from numpy.typing import NDArray

from lambent_relight.asset.glb import packed_glb
from lambent_relight.baked.mesh import UNREADABLE, glb_accessor, glb_chunks, glb_view

DRACO = "KHR_draco_mesh_compression"
POSITION_BITS = 16
"""Steps along the longest side of the mesh's box, as a power of two."""
UV_BITS = 16
"""Steps across the used part of the atlas: sixteen and more per texel of an atlas of 4096."""
NORMAL_BITS = 12
"""Of each octahedral coordinate of a normal: errors below 0.05 degrees."""
LEVEL = 7
"""0..10: effort of the packing."""
_FLOAT, _UINT32 = 5126, 5125
_ATTRIBUTES = {
    "POSITION": ("VEC3", 0),
    "NORMAL": ("VEC3", 1),
    "TEXCOORD_0": ("VEC2", 3),
    "TANGENT": ("VEC4", 4),
}
"""Type in glTF, and kind of attribute in Draco, to which tangents are generic."""


def glb_with_draco(data: bytes) -> bytes:
    """Return the GLB `data` of a bundle with its mesh packed; there is no plain mesh to fall back to.

    Vertices and triangles come in another order, and triangles without area are left out. Raises BundleError
    `bundle.mesh_invalid` for a mesh that Draco does not take, ExportError `export.draco_missing` where the
    package DracoPy is missing.
    """
    draco = _library("--draco")
    try:
        document, payload = glb_chunks(data)
        primitive = document["meshes"][0]["primitives"][0]
        names = [name for name in _ATTRIBUTES if name in primitive["attributes"]]
        arrays = {
            name: glb_accessor(document, payload, primitive["attributes"][name], _ATTRIBUTES[name][0])
            for name in names
        }
        corners = glb_accessor(document, payload, primitive["indices"], "SCALAR").reshape(-1, 3)
        packed = draco.encode(
            arrays["POSITION"],
            corners.astype(np.uint32),
            quantization_bits=POSITION_BITS,
            compression_level=LEVEL,
            # The library takes these as doubles and stores them as floats.
            tex_coord=arrays["TEXCOORD_0"].astype(np.float64),
            tex_coord_quantization_bits=UV_BITS,
            normals=arrays["NORMAL"].astype(np.float64),
            normal_quantization_bits=NORMAL_BITS,
            generic_attributes={0: arrays["TANGENT"]} if "TANGENT" in arrays else None,
        )
        decoded = draco.decode(packed)
        stored = {attribute["attribute_type"]: attribute for attribute in decoded.attributes}
        identifiers = {name: stored[_ATTRIBUTES[name][1]]["unique_id"] for name in names}
        accessors: list[dict[str, Any]] = []
        for name in names:
            kind = _ATTRIBUTES[name][0]
            accessors.append({"componentType": _FLOAT, "count": len(decoded.points), "type": kind})
            primitive["attributes"][name] = len(accessors) - 1
        low, high = decoded.points.min(axis=0), decoded.points.max(axis=0)
        accessors[primitive["attributes"]["POSITION"]] |= {"min": low.tolist(), "max": high.tolist()}
        accessors.append({"componentType": _UINT32, "count": int(decoded.faces.size), "type": "SCALAR"})
        primitive["indices"] = len(accessors) - 1
        primitive["extensions"] = {DRACO: {"attributes": identifiers}}
        document["accessors"] = accessors
        for key in ("extensionsUsed", "extensionsRequired"):
            document[key] = [*document.get(key, ()), DRACO]
        own = _without_plain_mesh(document, packed)
    except (*UNREADABLE, AssertionError, draco.EncodingFailedException) as error:
        raise BundleError(
            "bundle.mesh_invalid",
            f"mesh/asset.glb is not a mesh that Draco takes ({str(error)[:100]})",
            "export the bundle again",
        ) from error
    return packed_glb(document, payload, own)


def unpacked(
    document: dict[str, Any], payload: bytes, primitive: dict[str, Any]
) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
    """Return the attributes of a packed primitive by name, and the indices of its triangles' corners.

    Raises ExportError `export.draco_missing` where the package DracoPy is missing, and KeyError, TypeError or
    ValueError for a primitive that cannot be unpacked.
    """
    packed = primitive["extensions"][DRACO]
    data = glb_view(document, payload, packed["bufferView"])
    library = _library("a mesh that is packed with Draco")
    try:
        decoded = library.decode(data)
    except library.FileTypeException as error:
        raise ValueError("a packed mesh is not Draco data") from error
    arrays = {attribute["unique_id"]: np.asarray(attribute["data"]) for attribute in decoded.attributes}
    named = {name: arrays[number] for name, number in packed["attributes"].items()}
    return named, np.asarray(decoded.faces, np.int64).reshape(-1)


def _without_plain_mesh(document: dict[str, Any], packed: bytes) -> dict[int, bytes]:
    """Keep the views of images only, append that of the packed mesh, and return its content by number."""
    images = document.get("images", ())
    views = [document["bufferViews"][image["bufferView"]] for image in images]
    for number, image in enumerate(images):
        image["bufferView"] = number
    document["bufferViews"] = [*views, {"buffer": 0, "byteOffset": 0, "byteLength": 0}]
    primitive = document["meshes"][0]["primitives"][0]
    primitive["extensions"][DRACO]["bufferView"] = len(views)
    return {len(views): packed}


def _library(wanted_by: str) -> Any:
    try:
        import DracoPy
    except ImportError as error:
        raise ExportError(
            "export.draco_missing",
            f"{wanted_by} needs the package DracoPy, which is not here",
            pip_install("draco"),
        ) from error
    return DracoPy
