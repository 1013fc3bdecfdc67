"""Reads a GLB of any program as one mesh in world axes, with the maps of its materials.

glTF is y up and in metres, which are scene units; the mesh is turned to z up. All meshes of the scene are
joined, with the transforms of their nodes. Whatever cannot be taken over as it is meant is refused, but for
what `GivenMesh.ignored` names; a mesh library would read it (decision 0034).
Source: glTF 2.0 specification, sections 3.5 (scenes), 3.7 (meshes), 3.9 (materials).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from lambent_core.errors import ExportError, UsageError
from lambent_relight.asset.draco import DRACO, unpacked
from lambent_relight.asset.glb import WEBP
from lambent_relight.baked.mesh import UNREADABLE, glb_accessor, glb_chunks
from numpy.typing import NDArray
from trimesh.transformations import quaternion_matrix

from lambent_asset.given_mesh.glb_maps import Maps, maps_of
from lambent_asset.mesh.mesh import crosses_of

MAX_BYTES = 1 << 30
MAX_FACES = 2_000_000
MAX_PIXELS = 1 << 28
"""Of all pictures together."""
MAX_VERTICES = 3 * MAX_FACES
"""As many as such a mesh has if no two triangles share one."""
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_SHAPES = {0: "points", 1: "lines", 2: "lines", 3: "lines"}
_UNDERSTOOD = {DRACO, WEBP}
Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GivenMesh:
    """Triangles of all parts, world axes (z up), scene units."""

    vertices: NDArray[np.float32]
    """[vertex, 3]."""
    normals: NDArray[np.float32]
    """[vertex, 3], unit; zero where the file has none."""
    uv: NDArray[np.float32]
    """[vertex, 2], u right and v down; zero where the part has none."""
    faces: NDArray[np.int32]
    """[face, 3], counter-clockwise seen from outside."""
    part_of_face: NDArray[np.int32]
    """A part is all triangles of one material that have texture coordinates, or have none."""
    maps: tuple[Maps | None, ...]
    """By part; None where the materials have to come from the trained model."""
    has_uv: tuple[bool, ...]
    """By part."""
    ignored: tuple[str, ...]
    """What of the file has no counterpart here, in words."""


def read_glb(path: Path) -> GivenMesh:
    """Return the mesh in the file at `path`.

    Raises UsageError: `mesh_file.unreadable` for an incomplete GLB, `mesh_file.unsupported` for one with
    skins, shape keys or other extensions, and `mesh_file.no_triangles`, `mesh_file.empty`,
    `mesh_file.not_finite`, `mesh_file.too_large`.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise _refused(
                "mesh_file.too_large", path, f"is above {MAX_BYTES >> 30} GiB", "reduce its mesh or textures"
            )
        data = path.read_bytes()
    except OSError as error:
        raise _refused(
            "mesh_file.unreadable", path, f"cannot be opened ({error.strerror})", "check the path"
        ) from error
    try:
        document, payload = glb_chunks(data)
        _check_extensions(path, document)
        # Numbers beyond the range of floats become infinite, and are refused as such.
        with np.errstate(all="ignore"):
            _check_size(path, document)
            source = _Source(path, document, payload)
            parts = [part for node, matrix in _nodes(document) for part in _parts(source, node, matrix)]
            return _joined(path, parts, _ignored(document))
    except ExportError as error:
        raise UsageError(error.code, f"{error.message}; {error.advice}") from error
    except UNREADABLE as error:
        raise _refused(
            "mesh_file.unreadable",
            path,
            f"is not a whole GLB ({type(error).__name__}: {str(error)[:100]})",
            'export it again as "glTF Binary (.glb)", with everything inside the file',
        ) from error


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    vertices: NDArray[np.float64]
    normals: NDArray[np.float64]
    uv: NDArray[np.float32] | None
    faces: NDArray[np.int64]
    maps: Maps | None


@dataclass(slots=True, eq=False)
class _Source:
    """A file, with what was unpacked of it: many nodes may show one mesh, and many meshes one material."""

    path: Path
    document: dict[str, Any]
    payload: bytes
    _maps: dict[tuple[int, bool], Maps | None] = field(default_factory=dict)
    _packed: dict[int, tuple[dict[str, NDArray[Any]], NDArray[np.int64]]] = field(default_factory=dict)

    def maps(self, number: int, *, has_uv: bool) -> Maps | None:
        """Return a material; the same object each time."""
        key = (number, has_uv)
        if key not in self._maps:
            self._maps[key] = maps_of(self.document, self.payload, number, has_uv=has_uv)
            if sum(maps.num_pixels for maps in self._maps.values() if maps is not None) > MAX_PIXELS:
                raise _refused(
                    "mesh_file.too_large",
                    self.path,
                    f"has pictures of more than {MAX_PIXELS} pixels in all",
                    "make them smaller",
                )
        return self._maps[key]

    def arrays(self, primitive: dict[str, Any]) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
        """Return attributes by name, and the indices of all corners; unpacked once where they are packed."""
        if DRACO not in primitive.get("extensions", {}):
            return _arrays(self.document, self.payload, primitive)
        if id(primitive) not in self._packed:
            self._packed[id(primitive)] = _arrays(self.document, self.payload, primitive)
        return self._packed[id(primitive)]


def _check_size(path: Path, document: dict[str, Any]) -> None:
    """Raise UsageError `mesh_file.too_large` by what the file states, before anything is copied."""
    faces = vertices = 0
    for node, _ in _nodes(document):
        for primitive in document["meshes"][node["mesh"]]["primitives"]:
            stated = document["accessors"][primitive["attributes"]["POSITION"]]["count"]
            corners = (
                document["accessors"][primitive["indices"]]["count"] if "indices" in primitive else stated
            )
            if not (isinstance(stated, int) and isinstance(corners, int)):
                raise ValueError("an accessor has a count that is not a number")
            listed = primitive.get("mode", _TRIANGLES) == _TRIANGLES
            faces += max(0, corners // 3 if listed else corners - 2)
            vertices += max(0, stated)
        if faces > MAX_FACES or vertices > MAX_VERTICES:
            raise _too_large(path, faces, vertices)


def _too_large(path: Path, faces: int, vertices: int) -> UsageError:
    return _refused(
        "mesh_file.too_large",
        path,
        f"has {faces} triangles and {vertices} vertices, or more",
        f"decimate it below {MAX_FACES} triangles, and {MAX_VERTICES} vertices",
    )


def _check_extensions(path: Path, document: dict[str, Any]) -> None:
    unknown = sorted(set(document.get("extensionsRequired", ())) - _UNDERSTOOD)
    if unknown:
        raise _refused(
            "mesh_file.unsupported",
            path,
            f"needs the glTF extensions {', '.join(unknown)[:200]}",
            "export it without them: no quantization, no meshopt, no KTX2 textures",
        )


def _nodes(document: dict[str, Any]) -> Iterator[tuple[dict[str, Any], NDArray[np.float64]]]:
    """Yield the nodes of the scene that have a mesh, with their transforms to glTF's world."""
    nodes = document.get("nodes", [])
    scenes = document.get("scenes", [])
    roots = scenes[document.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
    waiting = [(index, np.eye(4)) for index in roots]
    visited = 0
    while waiting:
        index, parent = waiting.pop()
        visited += 1
        if visited > len(nodes):
            raise ValueError("its nodes form a loop")
        node = nodes[index]
        matrix = parent @ _matrix(node)
        if "mesh" in node:
            yield node, matrix
        waiting.extend((child, matrix) for child in node.get("children", ()))


def _matrix(node: dict[str, Any]) -> NDArray[np.float64]:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    matrix = quaternion_matrix([w, x, y, z])
    matrix[:3, :3] *= np.array(node.get("scale", (1.0, 1.0, 1.0)), np.float64)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _parts(source: _Source, node: dict[str, Any], matrix: NDArray[np.float64]) -> Iterator[_Part]:
    """Yield the primitives of a node's mesh."""
    if "skin" in node:
        raise _refused(
            "mesh_file.unsupported",
            source.path,
            "has a mesh with an armature (skin)",
            "apply the armature modifier, and export without skinning",
        )
    for primitive in source.document["meshes"][node["mesh"]]["primitives"]:
        if primitive.get("targets"):
            raise _refused(
                "mesh_file.unsupported",
                source.path,
                "has a mesh with shape keys (morph targets)",
                "apply them, and export again",
            )
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            raise _refused(
                "mesh_file.no_triangles",
                source.path,
                f"has {_SHAPES.get(mode, 'something')} where triangles are expected",
                "leave loose edges and points out of the export, and triangulate the rest",
            )
        yield _part(source, primitive, mode, matrix)


def _part(source: _Source, primitive: dict[str, Any], mode: int, matrix: NDArray[np.float64]) -> _Part:
    arrays, corners = source.arrays(primitive)
    faces = _triangles(corners, mode)
    positions = arrays["POSITION"]
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(positions):
        raise ValueError("triangles refer to vertices that are not there")
    linear = Y_UP_TO_Z_UP @ matrix[:3, :3]
    vertices = positions.astype(np.float64) @ linear.T + Y_UP_TO_Z_UP @ matrix[:3, 3]
    normals = np.zeros_like(vertices)
    if "NORMAL" in arrays:
        # The transform of normals is the inverse transpose; the adjugate is that up to a factor.
        normals = arrays["NORMAL"].astype(np.float64) @ _adjugate(linear)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    if np.linalg.det(linear) < 0.0:
        faces, normals = faces[:, ::-1], -normals
    uv = arrays.get("TEXCOORD_0")
    number = primitive.get("material")
    maps = source.maps(number, has_uv=uv is not None) if number is not None else None
    return _Part(vertices, normals, uv, faces, maps)


def _adjugate(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the transpose of the cofactors: the inverse times the determinant, also of a flat transform."""
    a, b, c = matrix
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)


def _arrays(
    document: dict[str, Any], payload: bytes, primitive: dict[str, Any]
) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
    """Return attributes by name, texture coordinates as floats, and the indices of all corners."""
    wanted = {"POSITION": "VEC3", "NORMAL": "VEC3", "TEXCOORD_0": "VEC2"}
    if DRACO in primitive.get("extensions", {}):
        arrays, corners = unpacked(document, payload, primitive)
        accessors = document["accessors"]
        stated = [accessors[n]["count"] for n in (primitive["attributes"]["POSITION"], primitive["indices"])]
        if len(arrays["POSITION"]) > stated[0] or len(corners) > stated[1]:
            raise ValueError("a packed mesh has more in it than the file states")
        return {name: values for name, values in arrays.items() if name in wanted}, corners
    arrays = {
        name: glb_accessor(document, payload, primitive["attributes"][name], kind)
        for name, kind in wanted.items()
        if name in primitive["attributes"]
    }
    uv = arrays.get("TEXCOORD_0")
    if uv is not None and uv.dtype.kind == "u":
        arrays["TEXCOORD_0"] = uv / np.float32(np.iinfo(uv.dtype).max)
    count = len(arrays["POSITION"])
    if any(len(values) != count for values in arrays.values()):
        raise ValueError("vertices have different numbers of attributes")
    if "indices" not in primitive:
        return arrays, np.arange(count)
    return arrays, glb_accessor(document, payload, primitive["indices"], "SCALAR").astype(np.int64).ravel()


def _triangles(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    if mode == _TRIANGLES:
        return corners[: len(corners) - len(corners) % 3].reshape(-1, 3)
    count = max(0, len(corners) - 2)
    first = np.arange(count)
    if mode == _FAN:
        return corners[np.stack([first + 1, first + 2, np.zeros_like(first)], axis=1)]
    odd = first % 2
    return corners[np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)]


def _joined(path: Path, parts: list[_Part], ignored: tuple[str, ...]) -> GivenMesh:
    parts = [part for part in parts if len(part.faces)]
    if not parts:
        raise _refused("mesh_file.empty", path, "has no triangles", "select the object, and export again")
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([part.vertices for part in parts]).astype(np.float32)
    normals = np.concatenate([part.normals for part in parts]).astype(np.float32)
    uv = np.concatenate(
        [
            np.zeros((len(p.vertices), 2), np.float32) if p.uv is None else np.asarray(p.uv, np.float32)
            for p in parts
        ]
    )
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)])
    # Parts of one material, with or without coordinates, are looked up together.
    kinds: dict[tuple[int, bool], tuple[int, _Part]] = {}
    for part in parts:
        kinds.setdefault((id(part.maps), part.uv is not None), (len(kinds), part))
    places = [kinds[id(part.maps), part.uv is not None][0] for part in parts]
    number = np.repeat(np.array(places, np.int32), [len(part.faces) for part in parts])
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    for name, values in (("positions", vertices), ("texture coordinates", uv), ("normals", normals)):
        bad = int((~np.isfinite(values[used]).all(axis=1)).sum())
        if bad:
            raise _refused(
                "mesh_file.not_finite",
                path,
                f"has {bad} vertices whose {name} are not numbers",
                "repair the mesh",
            )
    area = np.linalg.norm(crosses_of(vertices, faces), axis=1)
    extent = float(np.linalg.norm(np.ptp(vertices[used], axis=0)))
    kept = area > 1e-14 * extent * extent
    if not kept.any():
        raise _refused(
            "mesh_file.empty", path, "has no triangles with an area", "select the object, and export again"
        )
    order, again = np.unique(faces[kept], return_inverse=True)
    return GivenMesh(
        vertices=vertices[order],
        normals=normals[order],
        uv=uv[order],
        faces=again.reshape(-1, 3).astype(np.int32),
        part_of_face=number[kept],
        maps=tuple(part.maps for _, part in kinds.values()),
        has_uv=tuple(part.uv is not None for _, part in kinds.values()),
        ignored=ignored,
    )


def _ignored(document: dict[str, Any]) -> tuple[str, ...]:
    """Return what changes how the file looks elsewhere and has no counterpart in a bundle."""
    materials = document.get("materials", [])
    primitives = [p for mesh in document.get("meshes", []) for p in mesh["primitives"]]
    present = {
        "vertex colours": any("COLOR_0" in p["attributes"] for p in primitives),
        "emission": any(any(m.get("emissiveFactor", ())) for m in materials),
        "transparency": any(m.get("alphaMode", "OPAQUE") != "OPAQUE" for m in materials),
        "animations": bool(document.get("animations")),
        "material extensions": any(m.get("extensions") for m in materials),
    }
    return tuple(name for name, there in present.items() if there)


def _refused(code: str, path: Path, what: str, advice: str) -> UsageError:
    return UsageError(code, f'"{path.name}" {what}; {advice}')
