"""GLB files of a few triangles, as other programs could write them."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lambent_asset.given_mesh.glb_file import GivenMesh
from PIL import Image

SQUARE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]], np.float32)
SQUARE_UV = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]], np.float32)
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]], np.uint16)
_COMPONENT = {"f": 5126, "H": 5123, "I": 5125}
_KIND = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}


def given_mesh(
    vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray | None = None, **changes: Any
) -> GivenMesh:
    """Return triangles as they are read from a file, with normals along +z and no material."""
    vertices = np.asarray(vertices, np.float32)
    given = {
        "normals": np.broadcast_to(np.float32([0.0, 0.0, 1.0]), vertices.shape).copy(),
        "uv": np.zeros((len(vertices), 2), np.float32) if uv is None else np.asarray(uv, np.float32),
        "part_of_face": np.zeros(len(faces), np.int32),
        "maps": (None,),
        "has_uv": (uv is not None,),
        "ignored": (),
    }
    return GivenMesh(vertices=vertices, faces=np.asarray(faces, np.int32), **{**given, **changes})


class GlbWriter:
    """A document that grows."""

    def __init__(self) -> None:
        self.document: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
        }
        self._data = bytearray()

    def view(self, data: bytes) -> int:
        """Append bytes and return the number of their view."""
        views = self.document["bufferViews"]
        views.append({"buffer": 0, "byteOffset": len(self._data), "byteLength": len(data)})
        self._data += data + b"\0" * (-len(data) % 4)
        return len(views) - 1

    def accessor(self, values: np.ndarray) -> int:
        """Append an array and return the number of its accessor."""
        values = np.ascontiguousarray(values)
        width = values.shape[1] if values.ndim == 2 else 1
        accessors = self.document["accessors"]
        accessors.append(
            {
                "bufferView": self.view(values.tobytes()),
                "componentType": _COMPONENT[values.dtype.char],
                "count": len(values),
                "type": _KIND[width],
            }
        )
        return len(accessors) - 1

    def material(self, pictures: dict[str, np.ndarray], **factors: Any) -> int:
        """Append a material with pictures (bytes [height, width, 3]) and factors; return its number."""
        slots = {}
        for slot, pixels in pictures.items():
            file = io.BytesIO()
            Image.fromarray(pixels).save(file, format="PNG")
            images = self.document.setdefault("images", [])
            images.append({"mimeType": "image/png", "bufferView": self.view(file.getvalue())})
            self.document.setdefault("textures", []).append({"source": len(images) - 1})
            slots[slot] = {"index": len(images) - 1}
        material = {"pbrMetallicRoughness": factors}
        for slot, found in slots.items():
            (material if slot == "normalTexture" else material["pbrMetallicRoughness"])[slot] = found
        materials = self.document.setdefault("materials", [])
        materials.append(material)
        return len(materials) - 1

    def mesh(
        self,
        vertices: np.ndarray = SQUARE,
        faces: np.ndarray | None = SQUARE_FACES,
        uv: np.ndarray | None = SQUARE_UV,
        normals: np.ndarray | None = None,
        *,
        node: dict[str, Any] | None = None,
        **primitive: Any,
    ) -> None:
        """Append a mesh of one primitive, with a node of its own in the scene."""
        arrays = {"POSITION": vertices, "TEXCOORD_0": uv, "NORMAL": normals}
        attributes = {
            name: self.accessor(np.asarray(values, np.float32))
            for name, values in arrays.items()
            if values is not None
        }
        indices = {} if faces is None else {"indices": self.accessor(np.asarray(faces).reshape(-1))}
        self.document["meshes"].append({"primitives": [{"attributes": attributes, **indices, **primitive}]})
        self.document["nodes"].append({"mesh": len(self.document["meshes"]) - 1, **(node or {})})
        self.document["scenes"][0]["nodes"].append(len(self.document["nodes"]) - 1)

    def data(self) -> bytes:
        """Return the file."""
        document = self.document | {"buffers": [{"byteLength": len(self._data)}]}
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(self._data), 0x004E4942) + bytes(self._data)
        return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def glb_file(path: Path, *changes: Callable[[GlbWriter], object]) -> Path:
    """Write the file that `changes` make of an empty document to `path`, and return it."""
    writer = GlbWriter()
    for change in changes:
        change(writer)
    path.write_bytes(writer.data())
    return path


def y_up(points: Sequence[Sequence[float]] | np.ndarray) -> np.ndarray:
    """Return points of our world (z up) in glTF's axes."""
    return np.asarray(points)[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
