"""The still life of the sample scene: our own shapes on a plate, with their ground-truth materials.

Scene units, z up; everything lies inside a sphere of radius 1.3. Materials are Mitsuba's `principled` model:
GGX width alpha = perceptual_roughness^2, dielectric reflectance 0.04 at normal incidence.
"""

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

TABLE_TOP = -0.50
RADIUS = 1.3


@dataclass(frozen=True, kw_only=True, slots=True)
class Surface:
    """The material of one object."""

    base_colour: tuple[float, float, float] | np.ndarray
    """Linear base colour: one for the whole object, or an image [H, W, 3] over its texture coordinates."""
    perceptual_roughness: float
    metallic: float = 0.0

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


def lathe(name: str, profile: np.ndarray, centre: np.ndarray, segments: int = 128) -> "mi.Mesh":
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
    return _mesh(name, positions + centre, normals, positions[:, :2] / 2.5 + 0.5, faces)


def ring(
    name: str,
    major: float,
    minor: float,
    centre: np.ndarray,
    lean_deg: float,
    rows: int = 96,
    columns: int = 48,
) -> "mi.Mesh":
    """Return a torus turned by `lean_deg` about +x, with texture coordinates (along, around)."""
    cos, sin = np.cos(np.radians(lean_deg)), np.sin(np.radians(lean_deg))
    lean = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
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
    return _mesh(name, positions.reshape(-1, 3) @ lean.T + centre, normals.reshape(-1, 3) @ lean.T, uv, faces)


def _mesh(
    name: str, positions: np.ndarray, normals: np.ndarray, uv: np.ndarray, faces: np.ndarray
) -> "mi.Mesh":
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(SURFACES[name].as_mitsuba())
    mesh = mi.Mesh(
        name,
        len(positions),
        len(faces),
        props=properties,
        has_vertex_normals=True,
        has_vertex_texcoords=True,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = positions.astype(np.float32).ravel()
    parameters["vertex_normals"] = normals.astype(np.float32).ravel()
    parameters["vertex_texcoords"] = uv.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def plate_picture(side: int = 512) -> np.ndarray:
    """Return the plate's glaze: cream with a ring of teal and white squares and a thin brown line."""
    y, x = np.meshgrid(np.linspace(-1.25, 1.25, side), np.linspace(-1.25, 1.25, side), indexing="ij")
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    picture = np.broadcast_to(np.array([0.72, 0.66, 0.54]), (side, side, 3)).copy()
    squares = (np.floor(angle / (2 * np.pi) * 28) + np.floor((radius - 0.70) / 0.13)) % 2 == 0
    band = (radius > 0.70) & (radius < 0.96)
    picture[band & squares] = (0.04, 0.30, 0.30)
    picture[band & ~squares] = (0.80, 0.80, 0.78)
    picture[np.abs(radius - 1.04) < 0.025] = (0.25, 0.10, 0.04)
    return picture


def ring_picture(side: int = 256) -> np.ndarray:
    """Return the torus' paint: yellow and green squares with a slow change of brightness."""
    v, u = np.meshgrid(np.arange(side) / side, np.arange(side) / side, indexing="ij")
    squares = (np.floor(u * 12) + np.floor(v * 4)) % 2 == 0
    picture = np.where(squares[..., None], np.array([0.75, 0.55, 0.08]), np.array([0.08, 0.34, 0.10]))
    return picture * (0.8 + 0.2 * np.cos(2 * np.pi * u))[..., None]


# (radius, z) from the axis below, around the outside, to the axis above.
# fmt: off
PLATE_PROFILE = np.array([
    (1e-4, -0.60), (0.50, -0.60), (0.92, -0.60), (0.98, -0.59), (1.08, -0.53), (1.14, -0.475),
    (1.155, -0.455), (1.15, -0.435), (1.13, -0.43), (1.06, -0.47), (1.00, -0.493),
    (0.94, -0.50), (0.50, -0.50), (1e-4, -0.50),
])
VASE_PROFILE = np.array([
    (1e-4, -0.500), (0.12, -0.500), (0.155, -0.495), (0.17, -0.475), (0.21, -0.40), (0.25, -0.30),
    (0.268, -0.20), (0.262, -0.10), (0.23, 0.00), (0.18, 0.09), (0.13, 0.18), (0.105, 0.27), (0.105, 0.34),
    (0.125, 0.41), (0.16, 0.46), (0.168, 0.475), (0.155, 0.48), (0.12, 0.44), (0.08, 0.36), (0.07, 0.30),
    (0.03, 0.285), (1e-4, 0.28),
])
# fmt: on

SURFACES = {
    "plate": Surface(base_colour=plate_picture(), perceptual_roughness=0.45),
    "gold": Surface(base_colour=(0.95, 0.66, 0.30), perceptual_roughness=0.28, metallic=1.0),
    "red": Surface(base_colour=(0.62, 0.05, 0.04), perceptual_roughness=0.85),
    "white": Surface(base_colour=(0.80, 0.79, 0.76), perceptual_roughness=0.65),
    "blue": Surface(base_colour=(0.05, 0.16, 0.55), perceptual_roughness=0.20),
    "ring": Surface(base_colour=ring_picture(), perceptual_roughness=0.40),
}


def objects() -> dict[str, Any]:
    """Return the still life as Mitsuba shapes."""
    place = mi.ScalarTransform4f
    red = place().translate([-0.52, -0.18, TABLE_TOP + 0.25]).rotate([0, 0, 1], 24).scale([0.22, 0.22, 0.25])
    return {
        "plate": lathe("plate", PLATE_PROFILE, np.zeros(3)),
        "white": lathe("white", VASE_PROFILE, np.array([-0.22, 0.34, 0.0])),
        "ring": ring("ring", 0.21, 0.075, np.array([-0.06, -0.60, TABLE_TOP + 0.18]), 34.0),
        "gold": _primitive("gold", type="sphere", center=[0.46, -0.30, TABLE_TOP + 0.34], radius=0.34),
        "blue": _primitive("blue", type="sphere", center=[0.42, 0.47, TABLE_TOP + 0.26], radius=0.26),
        "red": _primitive("red", type="cube", to_world=red),
    }


def _primitive(name: str, **shape: Any) -> dict[str, Any]:
    return shape | {"bsdf": SURFACES[name].as_mitsuba()}
