"""Closed triangle meshes, and what they are painted with.

Texture coordinates (u, v) of a picture [H, W, 3]: u along its columns, v along its rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi
import numpy as np
from tabletop.distance import Distance, surface

Colour = tuple[float, float, float]
THINNEST = 1e-6
"""Least height of a triangle that comes from a distance, in scene units."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Surface:
    """The material of one object."""

    base_colour: Colour | np.ndarray
    """Linear base colour: one for the whole object, or an image [H, W, 3] over its texture coordinates."""
    perceptual_roughness: float
    metallic: float = 0.0

    @property
    def is_uniform(self) -> bool:
        """Return whether the object has one base colour all over."""
        return not isinstance(self.base_colour, np.ndarray)

    def as_mitsuba(self) -> dict[str, Any]:
        """Return the material as Mitsuba's dictionary."""
        if isinstance(self.base_colour, np.ndarray):
            colour = {
                "type": "bitmap",
                "bitmap": mi.Bitmap(self.base_colour.astype(np.float32)),
                "raw": True,
                "wrap_mode": "clamp",
            }
        else:
            colour = {"type": "rgb", "value": list(self.base_colour)}
        return {
            "type": "principled",
            "base_color": colour,
            "roughness": self.perceptual_roughness,
            "metallic": self.metallic,
            "specular": 0.5,
        }


@dataclass(frozen=True, kw_only=True, slots=True)
class Triangles:
    """A closed surface: positions, outward unit normals and texture coordinates of vertices, and faces."""

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    faces: np.ndarray

    def placed(self, at: Sequence[float], turn: np.ndarray | None = None) -> "Triangles":
        """Return the surface turned by the rotation `turn` [3, 3], then moved by `at`."""
        turn = np.eye(3) if turn is None else turn
        return replace(
            self, positions=self.positions @ turn.T + np.asarray(at), normals=self.normals @ turn.T
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class Paint:
    """What covers the vertices of a mesh, where a picture has no place: [n, 3], [n] and [n]."""

    base_colour: np.ndarray
    perceptual_roughness: np.ndarray
    metallic: np.ndarray


def rotation(axis: int, angle_deg: float) -> np.ndarray:
    """Return the rotation [3, 3] about a coordinate axis."""
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    first, second = [(1, 2), (2, 0), (0, 1)][axis]
    turn = np.eye(3)
    turn[first, first], turn[first, second] = cos, -sin
    turn[second, first], turn[second, second] = sin, cos
    return turn


def lathe(profile: np.ndarray, segments: int = 128) -> Triangles:
    """Return the surface of revolution of `profile` [n, 2] (radius, z) about z, smooth along the profile.

    The profile must run so that the outside lies to its right. Texture coordinates are x and y,
    from -1.25 to 1.25.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    tangent = np.gradient(profile, axis=0)
    outward = np.stack([tangent[:, 1], -tangent[:, 0]], axis=-1)
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    def revolve(pairs: np.ndarray) -> np.ndarray:
        flat = pairs[:, None, :1] * circle[None]
        up = np.broadcast_to(pairs[:, None, 1:], (*flat.shape[:2], 1))
        return np.concatenate([flat, up], axis=-1).reshape(-1, 3)

    positions, normals = revolve(profile), revolve(outward)
    rows, columns = np.meshgrid(np.arange(len(profile) - 1), np.arange(segments), indexing="ij")
    a = rows * segments + columns
    b = rows * segments + (columns + 1) % segments
    faces = np.concatenate(
        [np.stack([a, b, a + segments], -1), np.stack([b, b + segments, a + segments], -1)]
    ).reshape(-1, 3)
    return Triangles(positions=positions, normals=normals, uv=positions[:, :2] / 2.5 + 0.5, faces=faces)


def wound(profile: np.ndarray, segments: int = 160) -> Triangles:
    """Return the surface of `lathe` with texture coordinates (around from +x, along the profile)."""
    bare = lathe(profile, segments)
    rows = np.arange(len(profile))[:, None] * segments + np.arange(segments + 1)[None] % segments
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=-1))])
    u, v = np.meshgrid(np.linspace(0.0, 1.0, segments + 1), length / length[-1])
    r, c = np.meshgrid(np.arange(len(profile) - 1), np.arange(segments), indexing="ij")
    a = r * (segments + 1) + c
    b = a + segments + 1
    faces = np.concatenate([np.stack([a, a + 1, b], -1), np.stack([a + 1, b + 1, b], -1)]).reshape(-1, 3)
    flat = rows.ravel()
    return Triangles(
        positions=bare.positions[flat],
        normals=bare.normals[flat],
        uv=np.stack([u, v], axis=-1).reshape(-1, 2),
        faces=faces,
    )


def ring(major: float, minor: float, rows: int = 96, columns: int = 48) -> Triangles:
    """Return a torus about z with texture coordinates (along, around)."""
    along, around = np.meshgrid(
        np.linspace(0, 2 * np.pi, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij"
    )
    normals = np.stack([np.cos(along) * np.cos(around), np.sin(along) * np.cos(around), np.sin(around)], -1)
    positions = minor * normals + major * np.stack([np.cos(along), np.sin(along), 0 * along], -1)
    r, c = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a = r * (columns + 1) + c
    b = a + columns + 1
    faces = np.concatenate([np.stack([a, b, a + 1], -1), np.stack([b, b + 1, a + 1], -1)]).reshape(-1, 3)
    uv = np.stack([along, around], -1).reshape(-1, 2) / (2 * np.pi)
    return Triangles(positions=positions.reshape(-1, 3), normals=normals.reshape(-1, 3), uv=uv, faces=faces)


def solid(distance: Distance, low: Sequence[float], high: Sequence[float], cells: int) -> Triangles:
    """Return the surface of a signed distance between `low` and `high`; texture coordinates are zero."""
    whole = surface(distance, low, high, cells)
    a, b, c = (whole.positions[whole.faces[:, k]] for k in range(3))
    longest = np.max([np.linalg.norm(edge, axis=-1) for edge in (b - a, c - b, a - c)], axis=0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1)
    return Triangles(
        positions=whole.positions,
        normals=whole.normals,
        uv=np.zeros((len(whole.positions), 2)),
        # A ray that meets a triangle without height gets coordinates on it that are not numbers.
        faces=whole.faces[area > THINNEST * longest],
    )


def rounded(knots: Sequence[Sequence[float]], steps: int = 12) -> np.ndarray:
    """Return a smooth profile [n, 2] through `knots` (radius, z): a centripetal Catmull-Rom curve.

    A knot given twice stays a corner.
    """
    points = np.asarray(knots, float)
    parts = []
    for k in range(len(points) - 1):
        p1, p2 = points[k], points[k + 1]
        if np.allclose(p1, p2):
            continue
        p0 = points[k - 1] if k > 0 and not np.allclose(points[k - 1], p1) else 2 * p1 - p2
        p3 = points[k + 2] if k + 2 < len(points) and not np.allclose(points[k + 2], p2) else 2 * p2 - p1
        knot = np.cumsum([0.0, *(np.linalg.norm(b - a) ** 0.5 for a, b in ((p0, p1), (p1, p2), (p2, p3)))])
        t = np.linspace(knot[1], knot[2], steps, endpoint=False)[:, None]

        def between(a: Any, b: Any, i: int, j: int, t: np.ndarray = t, knot: np.ndarray = knot) -> Any:
            return (knot[j] - t) / (knot[j] - knot[i]) * a + (t - knot[i]) / (knot[j] - knot[i]) * b

        a1, a2, a3 = between(p0, p1, 0, 1), between(p1, p2, 1, 2), between(p2, p3, 2, 3)
        parts.append(between(between(a1, a2, 0, 2), between(a2, a3, 1, 3), 1, 2))
    curve = np.concatenate([*parts, points[-1:]])
    curve[:, 0] = np.maximum(curve[:, 0], 1e-4)
    return curve


def mesh(name: str, matter: Surface | Paint, triangles: Triangles) -> "mi.Mesh":
    """Return the mesh in Mitsuba's terms."""
    if isinstance(matter, Surface):
        bsdf = matter.as_mitsuba()
    else:
        names = (("base_color", "colour"), ("roughness", "rough"), ("metallic", "metal"))
        attribute = {key: {"type": "mesh_attribute", "name": f"vertex_{name}"} for key, name in names}
        bsdf = {"type": "principled", "specular": 0.5, **attribute}
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    made = mi.Mesh(
        name,
        len(triangles.positions),
        len(triangles.faces),
        props=properties,
        has_vertex_normals=True,
        has_vertex_texcoords=True,
    )
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = triangles.positions.astype(np.float32).ravel()
    parameters["vertex_normals"] = triangles.normals.astype(np.float32).ravel()
    parameters["vertex_texcoords"] = triangles.uv.astype(np.float32).ravel()
    parameters["faces"] = triangles.faces.astype(np.uint32).ravel()
    parameters.update()
    if isinstance(matter, Paint):
        made.add_attribute("vertex_colour", 3, np.asarray(matter.base_colour, np.float32).ravel())
        made.add_attribute("vertex_rough", 1, np.asarray(matter.perceptual_roughness, np.float32).ravel())
        made.add_attribute("vertex_metal", 1, np.asarray(matter.metallic, np.float32).ravel())
    return made


def block(centre: Sequence[float], half: Sequence[float], turn_deg: float = 0.0) -> dict[str, Any]:
    """Return a box turned about z, in Mitsuba's terms; each face has texture coordinates of its own."""
    place = mi.ScalarTransform4f().translate(list(centre)).rotate([0, 0, 1], turn_deg).scale(list(half))
    return {"type": "cube", "to_world": place}


def ball(centre: Sequence[float], radius: float) -> dict[str, Any]:
    """Return a sphere in Mitsuba's terms."""
    return {"type": "sphere", "center": list(centre), "radius": radius}
