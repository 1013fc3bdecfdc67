"""Writes a textured surface as a binary glTF file for any viewer.

Written here and not with a mesh library: decision 0034. Source: glTF 2.0 specification, sections 3.7.2
(meshes) and 3.9 (materials).
"""

import io
from typing import Any

import numpy as np
import trimesh
from lambent_core.errors import WorkerError
from lambent_relight.baked.mesh import glb_of
from numpy.typing import NDArray

from lambent_asset.mesh.atlas import tangents
from lambent_asset.textures import textures as baked
from lambent_asset.textures.surface import AtlasSurface
from lambent_asset.textures.textures import TextureSet

Json = dict[str, Any]
_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125
_VERTICES, _INDICES = 34962, 34963
_LINEAR, _LINEAR_MIPMAP_LINEAR, _CLAMP = 9729, 9987, 33071
_RESTART = 0xFFFF
"""16-bit index that some programs interpret as the end of a strip."""


def write_glb(surface: AtlasSurface, textures: TextureSet, *, unit: str) -> bytes:
    """Return a GLB with positions, normals, tangents and texture coordinates, and three embedded PNG files.

    Coordinates are the world's (z up, in scene units); one node turns them to glTF's y up. `unit` says what
    a scene unit is; glTF readers will take it for a metre.
    """
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    frame = tangents(surface.vertices, surface.faces, surface.uv, surface.normals)
    small = len(surface.vertices) < _RESTART
    file = _File()
    attributes = {
        "POSITION": file.accessor(surface.vertices, "VEC3", min=low.tolist(), max=high.tolist()),
        "NORMAL": file.accessor(surface.normals, "VEC3"),
        "TANGENT": file.accessor(frame, "VEC4"),
        "TEXCOORD_0": file.accessor(surface.uv, "VEC2"),
    }
    indices = file.accessor(
        surface.faces.astype("<u2" if small else "<u4").reshape(-1),
        "SCALAR",
        component=_UINT16 if small else _UINT32,
        target=_INDICES,
    )
    images = [
        file.image("base colour", baked.base_colour_png(textures)),
        file.image("occlusion, roughness, metalness", baked.occlusion_roughness_metalness_png(textures)),
        file.image("normal", baked.normal_png(textures)),
    ]
    primitive = {"attributes": attributes, "indices": indices, "material": 0}
    return glb_of(_document(file, primitive, images, unit), bytes(file.data))


def _document(file: "_File", primitive: Json, images: list[Json], unit: str) -> Json:
    """Return the description of what is in `file`: one node with one mesh and its material."""
    half = float(np.sqrt(0.5))
    return {
        "asset": {
            "version": "2.0",
            "generator": "lambent",
            "extras": {"unit": unit, "up_axis": "y", "mesh_up_axis": "z", "colour": "linear-rec709"},
        },
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        # A quarter turn about x brings +z to +y.
        "nodes": [{"name": "asset", "mesh": 0, "rotation": [-half, 0.0, 0.0, half]}],
        "meshes": [{"name": "asset", "primitives": [primitive]}],
        "materials": [
            {
                "name": "surface",
                "pbrMetallicRoughness": {
                    "baseColorTexture": {"index": 0},
                    "metallicRoughnessTexture": {"index": 1},
                    # Both default to 1; written explicitly, because some readers assume 0.
                    "metallicFactor": 1.0,
                    "roughnessFactor": 1.0,
                },
                "occlusionTexture": {"index": 1},
                "normalTexture": {"index": 2},
                "doubleSided": True,
            }
        ],
        "textures": [{"sampler": 0, "source": source} for source in range(len(images))],
        "images": images,
        "samplers": [
            {"magFilter": _LINEAR, "minFilter": _LINEAR_MIPMAP_LINEAR, "wrapS": _CLAMP, "wrapT": _CLAMP}
        ],
        "buffers": [{"byteLength": len(file.data)}],
        "bufferViews": file.views,
        "accessors": file.accessors,
    }


class _File:
    """The binary chunk of a file, growing."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[Json] = []
        self.accessors: list[Json] = []

    def accessor(
        self,
        values: NDArray,
        kind: str,
        *,
        component: int = _FLOAT,
        target: int = _VERTICES,
        **more: list[float],
    ) -> int:
        """Append an array and return the number of its accessor."""
        view = self._view(values.astype("<f4").tobytes() if component == _FLOAT else values.tobytes())
        self.views[view]["target"] = target
        self.accessors.append(
            {"bufferView": view, "componentType": component, "count": len(values), "type": kind, **more}
        )
        return len(self.accessors) - 1

    def image(self, name: str, png: bytes) -> Json:
        """Append a PNG file and return the entry of its image."""
        return {"name": name, "mimeType": "image/png", "bufferView": self._view(png)}

    def _view(self, data: bytes) -> int:
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        self.data += data + b"\0" * (-len(data) % 4)
        return len(self.views) - 1


def check_glb(data: bytes, surface: AtlasSurface) -> None:
    """Raise `WorkerError` unless another library reads back the same surface, turned to y up."""
    mesh = trimesh.load_scene(io.BytesIO(data), file_type="glb").to_mesh()
    turned = surface.vertices[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0], np.float32)
    same = mesh.vertices.shape == turned.shape and np.array_equal(mesh.faces, surface.faces)
    # trimesh counts v from the bottom.
    if not (
        same
        and np.allclose(mesh.vertices, turned, atol=1e-5)
        and np.allclose(mesh.visual.uv, surface.uv * [1.0, -1.0] + [0.0, 1.0], atol=1e-6)
    ):
        raise WorkerError(
            "export.mesh",
            f"the mesh file was read back as {len(mesh.vertices)} vertices and {len(mesh.faces)} faces "
            f"instead of {len(surface.vertices)} and {len(surface.faces)}, or moved; please report this with "
            f"the run's log",
        )
