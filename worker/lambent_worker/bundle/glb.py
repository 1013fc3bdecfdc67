"""A mesh as a binary glTF file that any viewer opens.

Written here and not by a mesh library, because base colours need 16 bits (COLOR_0 is linear in glTF, where 8
bits show steps in dark colours), vertex normals and a material of their own.
Source: glTF 2.0 specification, sections 3.9 (materials), 3.7.2 (meshes) and 4 (GLB).
"""

import io
import json
import struct

import numpy as np
import trimesh
from numpy.typing import NDArray

from lambent_worker.bundle.mesh import Mesh
from lambent_worker.errors import WorkerError

_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125
_VERTICES, _INDICES = 34962, 34963


def write_glb(mesh: Mesh) -> bytes:
    """Return a GLB with positions, normals, base colours per vertex, and mean roughness and metalness.

    Coordinates are the world's (z up); one node turns them to glTF's y up.
    """
    colours = np.concatenate([mesh.albedo, np.ones_like(mesh.albedo[:, :1])], axis=1)
    colours = np.round(colours.clip(0.0, 1.0) * 65535.0).astype("<u2")
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    arrays = [
        (mesh.vertices.astype("<f4"), _VERTICES, _FLOAT, "VEC3", {"min": low.tolist(), "max": high.tolist()}),
        (_unit(mesh.normals).astype("<f4"), _VERTICES, _FLOAT, "VEC3", {}),
        (colours, _VERTICES, _UINT16, "VEC4", {"normalized": True}),
        (mesh.faces.astype("<u4").reshape(-1, 1), _INDICES, _UINT32, "SCALAR", {}),
    ]
    data = bytearray()
    views, accessors = [], []
    for index, (array, target, component, kind, more) in enumerate(arrays):
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes, "target": target})
        accessors.append(
            {"bufferView": index, "componentType": component, "count": len(array), "type": kind, **more}
        )
        data += array.tobytes()
    half = float(np.sqrt(0.5))
    document = {
        "asset": {"version": "2.0", "generator": "lambent"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        # A quarter turn about x brings +z to +y.
        "nodes": [{"name": "asset", "mesh": 0, "rotation": [-half, 0.0, 0.0, half]}],
        "meshes": [
            {
                "name": "asset",
                "primitives": [
                    {"attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}, "indices": 3, "material": 0}
                ],
            }
        ],
        "materials": [
            {
                "name": "mean material",
                "pbrMetallicRoughness": {
                    "metallicFactor": round(float(mesh.metalness.mean()), 4),
                    "roughnessFactor": round(float(mesh.perceptual_roughness.mean()), 4),
                },
                "doubleSided": True,
            }
        ],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return _container(json.dumps(document, separators=(",", ":")).encode(), bytes(data))


def check_glb(data: bytes, mesh: Mesh) -> None:
    """Raise `WorkerError` unless another library reads the file back as the same surface, turned to y up."""
    found = trimesh.load_scene(io.BytesIO(data), file_type="glb").to_mesh()
    turned = mesh.vertices[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0], np.float32)
    same = found.vertices.shape == turned.shape and found.faces.shape == mesh.faces.shape
    if not (same and np.allclose(found.vertices, turned, atol=1e-5)):
        raise WorkerError(
            "export.mesh",
            f"the mesh file was read back as {len(found.vertices)} vertices and {len(found.faces)} faces "
            f"instead of {len(mesh.vertices)} and {len(mesh.faces)}, or moved; please report this with the "
            f"run's log",
        )


def _unit(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)


def _container(document: bytes, data: bytes) -> bytes:
    """Return the two chunks of a GLB file, each padded to a multiple of four bytes."""
    document += b" " * (-len(document) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = struct.pack("<II", len(document), 0x4E4F534A) + document
    chunks += struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks
