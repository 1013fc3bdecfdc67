"""The surface of a bundle, read from its mesh/asset.glb for the rasteriser and the atlas.

Positions are kept as stored in the file, in world coordinates (z up); the node that rotates them to glTF's y
up is for other programs. Source: glTF 2.0 specification, sections 3.6 (accessors) and 4 (GLB). The file may
come from an untrusted source, so everything in it is checked before use.
"""

import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from lambent_core.errors import BundleError
from numpy.typing import NDArray

from lambent_relight.bundle.bundle import Bundle

MESH_PATH = "mesh/asset.glb"
MAX_MESH_BYTES = 512 << 20
UNREADABLE = (
    AttributeError,
    KeyError,
    IndexError,
    TypeError,
    ValueError,
    OverflowError,
    struct.error,
    RecursionError,
)
"""What a GLB that is not what it should be raises while its parts are looked up."""
_TYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True, eq=False)
class AtlasMesh:
    """Triangles with texture coordinates in the atlas."""

    vertices: NDArray[np.float32]
    """World coordinates [vertex, 3]."""
    faces: NDArray[np.int32]
    uv: NDArray[np.float32]
    """[vertex, 2] in [0, 1], v down from the top row of the atlas."""
    normals: NDArray[np.float32] | None = None
    """Of the vertices, [vertex, 3]; None, as the next, where nothing is seen of the mesh but its shape."""
    tangents: NDArray[np.float32] | None = None
    """Frames of the normal map, [vertex, 4] as in glTF: x along u, and the sign of the bitangent."""


def read_mesh(bundle: Bundle) -> AtlasMesh:
    """Return the mesh of a bundle; raises BundleError `bundle.mesh_invalid` for one that cannot be used."""
    return mesh_from_glb(bundle.read(MESH_PATH, MAX_MESH_BYTES))


def mesh_from_glb(data: bytes) -> AtlasMesh:
    """Return the first primitive of a binary glTF file."""
    try:
        document, payload = glb_chunks(data)
        if any("uri" in buffer for buffer in document["buffers"]):
            raise ValueError("its data are in another file")
        primitive = document["meshes"][0]["primitives"][0]
        attributes = primitive["attributes"]
        vertices = glb_accessor(document, payload, attributes["POSITION"], "VEC3")
        uv = glb_accessor(document, payload, attributes["TEXCOORD_0"], "VEC2")
        indices = glb_accessor(document, payload, primitive["indices"], "SCALAR")
        shading = [
            glb_accessor(document, payload, attributes[name], kind)
            for name, kind in (("NORMAL", "VEC3"), ("TANGENT", "VEC4"))
        ]
        mode = primitive.get("mode", 4)
    except UNREADABLE as error:
        raise _invalid(f"cannot be read ({type(error).__name__}: {str(error)[:100]})") from error
    if mode != 4 or indices.size % 3 or indices.dtype.kind != "u":
        raise _invalid("is not made of triangles")
    if vertices.dtype != np.float32 or len(uv) != len(vertices):
        raise _invalid("has other texture coordinates than positions")
    if uv.dtype.kind == "u":
        uv = uv / np.float32(np.iinfo(uv.dtype).max)
    if not (np.isfinite(vertices).all() and np.isfinite(uv).all() and uv.min() >= 0.0 and uv.max() <= 1.0):
        raise _invalid("has coordinates out of range")
    for values in shading:
        if values.dtype != np.float32 or len(values) != len(vertices) or not np.isfinite(values).all():
            raise _invalid("has normals or tangents that do not fit its positions")
    if len(vertices) == 0 or indices.size == 0 or int(indices.max()) >= len(vertices):
        raise _invalid("refers to vertices that are not there")
    faces = np.ascontiguousarray(indices.reshape(-1, 3), np.int32)
    return AtlasMesh(np.ascontiguousarray(vertices), faces, np.ascontiguousarray(uv, np.float32), *shading)


def glb_chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the document and the binary data of a GLB; raises ValueError or struct.error for any other."""
    magic, version, size = struct.unpack_from("<III", data, 0)
    if magic != 0x46546C67 or version != 2 or size > len(data):
        raise ValueError("not a GLB of version 2")
    length, kind = struct.unpack_from("<II", data, 12)
    if kind != 0x4E4F534A or 20 + length > len(data):
        raise ValueError("no JSON chunk")
    document = json.loads(data[20 : 20 + length])
    start = 20 + length
    payload_length, payload_kind = struct.unpack_from("<II", data, start)
    if payload_kind != 0x004E4942 or start + 8 + payload_length > len(data):
        raise ValueError("no binary chunk")
    return document, data[start + 8 : start + 8 + payload_length]


def glb_of(document: dict[str, Any], payload: bytes) -> bytes:
    """Return the GLB with these two chunks, each filled up to a multiple of four bytes."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    payload += b"\0" * (-len(payload) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(payload), 0x004E4942) + payload
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def glb_view(document: dict[str, Any], payload: bytes, index: int) -> bytes:
    """Return the bytes of a buffer view; raises one of `UNREADABLE` for one that is not in the file."""
    view = document["bufferViews"][index]
    start, size = view.get("byteOffset", 0), view["byteLength"]
    if not all(isinstance(n, int) and n >= 0 for n in (start, size)) or start + size > len(payload):
        raise ValueError(f"part {index} leaves the file")
    return payload[start : start + size]


def glb_accessor(document: dict[str, Any], payload: bytes, index: int, kind: str) -> NDArray[Any]:
    """Return the array [count, component] of an accessor of the type `kind`.

    Raises KeyError, IndexError, TypeError or ValueError for one that is not there, or has another form.
    """
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype, components, count = (
        np.dtype(_TYPES[accessor["componentType"]]),
        _COMPONENTS[kind],
        accessor["count"],
    )
    if accessor["type"] != kind or "sparse" in accessor or view.get("buffer", 0) != 0:
        raise ValueError(f"accessor {index} has another form")
    stride = view.get("byteStride", dtype.itemsize * components)
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    numbers = (stride, start, count, view["byteLength"])
    if not all(isinstance(n, int) and n >= 0 for n in numbers) or stride < dtype.itemsize * components:
        raise ValueError(f"accessor {index} has a size that is not a whole number")
    if count and start + (count - 1) * stride + dtype.itemsize * components > len(payload):
        raise ValueError(f"accessor {index} leaves the file")
    shape, strides = (count, components), (stride, dtype.itemsize)
    return np.ndarray(shape, dtype, payload, start if count else 0, strides).copy()


def _invalid(what: str) -> BundleError:
    return BundleError("bundle.mesh_invalid", f"mesh/asset.glb {what}", "export the bundle again")
