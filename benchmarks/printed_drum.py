"""Photograph a printed drum: slanted edges, bars and small text, in exact light and without noise.

    python -m benchmarks.printed_drum -o FOLDER [--side 1600] [--views 24]

The drum is convex: nothing on it is shadowed or lit by anything else of it, so that radiance is an integral
over the map, taken at every vertex and for every camera (diffuse and GGX, `lambent_relight.brdf`), and
interpolated; only the print has detail. Writes the NeRF-Blender layout. `albedo_at` and `SQUARES` are the
truth behind the figures in docs/benchmarks/asset.md.
"""

import argparse
import json
import math
import sys
from functools import cache
from pathlib import Path

import numpy as np
from lambent_core.colour import srgb_from_linear
from lambent_relight.baked.raster import Fragments, block_means, interpolate, rasterise
from lambent_relight.baked.texture_lookup import bilinear
from lambent_relight.brdf import brdf_cos, materials_from_roughness
from lambent_relight.cameras import Camera
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))
from sample_environments import directions, environment_image

RADIUS, HEIGHT, RIM = 0.73, 1.12, 0.12
"""Of the drum and of its rounded rims, scene units; its middle is the origin."""
DARK, LIGHT, PAPER = 0.10, 0.62, (0.62, 0.60, 0.55)
"""Linear albedo of ink, of the squares around the slanted edges, and elsewhere."""
ROUGHNESS = 0.6
TILT_DEG = 5.0
SQUARES = tuple((azimuth, 0.1) for azimuth in (0.5, 2.07, 3.64, 5.21))
"""Azimuth (radians) and height (scene units) of the middles of tilted squares on the wall."""
SQUARE = 0.13
"""Half their side, scene units along the wall."""
PIXELS = (6144, 1536)
"""Of the print, around and along the wall's straight part."""
WALL = HEIGHT / 2 - RIM
"""Half the height of the straight part."""
DISTANCE, ANGLE = 4.0, 0.5
"""Of the cameras from the origin, and their field of view, radians."""
SUPERSAMPLED = 2
_TEXT = (
    "Lambent reads photographs and writes an asset that takes any light. The quick brown fox jumps over the "
    "lazy dog; pack my box with five dozen liquor jugs. 0123456789 (Aa Bb Cc Dd Ee Ff Gg Hh Ii Jj Kk Ll Mm) "
)


@cache
def picture() -> np.ndarray:
    """Return the print of the wall's straight part [height, width, 3], linear; rows from the top."""
    width, height = PIXELS
    ink, plain = (Image.new("L", (2 * width, 2 * height), 0) for _ in range(2))
    pen, mask = ImageDraw.Draw(ink), ImageDraw.Draw(plain)
    unit = 2 * width / (2 * math.pi * RADIUS)
    rise = 2 * height / (2 * WALL)
    for azimuth, z in SQUARES:
        for side, fills in ((1.6, (255, 0)), (1.0, (None, 255))):
            corners = [
                (unit * RADIUS * azimuth + unit * x, rise * (WALL - z - y)) for x, y in _square(side * SQUARE)
            ]
            for tool, fill in zip((mask, pen), fills, strict=True):
                if fill is not None:
                    tool.polygon(corners, fill=fill)
        left, pitch = unit * RADIUS * (azimuth + 0.36), 0.05 * unit
        while pitch > 8.0:
            for _ in range(3):
                pen.rectangle(
                    [left, rise * (WALL - z - 0.1), left + 0.5 * pitch, rise * (WALL - z + 0.1)], fill=255
                )
                left += pitch
            pitch *= 0.7
    for k, z in enumerate((0.42, 0.37, 0.32, -0.16, -0.21, -0.27, -0.33, -0.4)):
        font = ImageFont.load_default(int(unit * (0.022, 0.028, 0.036, 0.05)[k % 4]))
        pen.text((0.01 * width, rise * (WALL - z)), (_TEXT[13 * k :] + 3 * _TEXT), font=font, fill=255)
    shares = [
        np.asarray(image.resize(PIXELS, Image.Resampling.BOX), np.float32)[..., None] / 255.0
        for image in (ink, plain)
    ]
    paper = np.float32(PAPER) * (1.0 - shares[1]) + LIGHT * shares[1]
    return (paper * (1.0 - shares[0]) + DARK * shares[0]).astype(np.float32)


def _square(half: float) -> list[tuple[float, float]]:
    angles = np.radians(TILT_DEG + 45.0 + 90.0 * np.arange(4))
    return [(half * math.sqrt(2.0) * math.cos(a), half * math.sqrt(2.0) * math.sin(a)) for a in angles]


def on_wall(positions: np.ndarray) -> np.ndarray:
    """Return which positions [n, 3] belong to the wall's straight part."""
    radius = np.hypot(positions[:, 0], positions[:, 1])
    return (np.abs(positions[:, 2]) < WALL) & (radius > 0.8 * RADIUS)


def albedo_at(positions: np.ndarray) -> np.ndarray:
    """Return the drum's albedo [n, 3] at positions near its surface; its flat ends and rims are plain."""
    azimuth = np.arctan2(positions[:, 1], positions[:, 0]) % (2.0 * np.pi)
    uv = np.stack([azimuth / (2.0 * np.pi), (WALL - positions[:, 2]) / (2.0 * WALL)], axis=-1)
    found = bilinear(picture(), uv)
    return np.where(on_wall(positions)[:, None], found, np.float32(PAPER))


def drum(segments: int = 200) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices, outward unit normals and faces."""
    turn = np.linspace(0.0, 0.5 * np.pi, 9)
    arc = np.stack([RADIUS - RIM + RIM * np.cos(turn), WALL + RIM * np.sin(turn)], axis=-1)
    out = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    wall = np.linspace(-WALL, WALL, 21)[1:-1]
    ring = [(RADIUS, z, 1.0, 0.0) for z in wall] + [(*p, *n) for p, n in zip(arc, out, strict=True)]
    ring += [(r, HEIGHT / 2, 0.0, 1.0) for r in np.linspace(RADIUS - RIM, 1e-3, 8)[1:]]
    below = [(r, -z, nr, -nz) for r, z, nr, nz in reversed(ring) if z >= WALL - 1e-9]
    profile = np.array(below + ring)
    angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    def revolved(radius: np.ndarray, z: np.ndarray) -> np.ndarray:
        flat = radius[:, None, None] * circle
        return np.concatenate([flat, np.broadcast_to(z[:, None, None], (*flat.shape[:2], 1))], -1).reshape(
            -1, 3
        )

    rows, columns = np.meshgrid(np.arange(len(profile) - 1), np.arange(segments), indexing="ij")
    a, b = rows * segments + columns, rows * segments + (columns + 1) % segments
    faces = np.stack([a, b, a + segments, b, b + segments, a + segments], axis=-1).reshape(-1, 3)
    return (
        revolved(profile[:, 0], profile[:, 1]),
        revolved(profile[:, 2], profile[:, 3]),
        faces.astype(np.int32),
    )


def camera_of(direction: np.ndarray, side: int, name: str) -> Camera:
    """Return a camera that looks from `direction` at the middle."""
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(direction, right), direction, DISTANCE * direction], axis=1)
    focal = 0.5 * side / math.tan(0.5 * ANGLE)
    return Camera(
        name=name, width=side, height=side, focal_x=focal, focal_y=focal,
        centre_x=side / 2, centre_y=side / 2, camera_to_world=pose,
    )  # fmt: skip


def spiral(count: int, phase: float) -> list[np.ndarray]:
    """Return directions around the drum, from a little below its middle to above."""
    height = -0.15 + 0.95 * (np.arange(count) + 0.5) / count
    azimuth = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0)) + phase
    ring = np.sqrt(1.0 - height**2)
    return list(np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), height], axis=-1))


class Shading:
    """Outgoing radiance of the drum's vertices under a map: albedo times `diffuse`, plus a reflection."""

    def __init__(self, normals: np.ndarray, radiance: np.ndarray) -> None:
        """Integrate the diffuse part; `radiance` is [rows, columns, 3]."""
        rows, columns = radiance.shape[:2]
        self.way = directions(rows, columns).reshape(-1, 3)
        elevation = np.pi / 2 - np.pi * (np.arange(rows) + 0.5) / rows
        solid = np.repeat(np.cos(elevation) * (np.pi / rows) * (2.0 * np.pi / columns), columns)
        self.light = radiance.reshape(-1, 3) * solid[:, None]
        self.diffuse = np.maximum(normals @ self.way.T, 0.0) @ self.light / np.pi

    def reflected(self, vertices: np.ndarray, normals: np.ndarray, eye: np.ndarray) -> np.ndarray:
        """Return the radiance of the specular lobe towards `eye`, [vertex, 3]."""
        omega_o = eye - vertices
        omega_o /= np.linalg.norm(omega_o, axis=1, keepdims=True)
        result = np.zeros((len(vertices), 3))
        one = np.ones((1, 1))
        material = materials_from_roughness(np.full((1, 3), 0.5), ROUGHNESS * one, 0.0 * one)
        for k in np.flatnonzero((omega_o * normals).sum(-1) > 0.0):
            lobe = brdf_cos(omega_o[None, k], self.way, normals[None, k], material)[1]
            result[k] = (lobe * self.light).sum(axis=0)
        return result


def photograph(camera: Camera, shape: tuple, shading: Shading) -> np.ndarray:
    """Return linear radiance with straight alpha [height, width, 4]."""
    vertices, normals, faces = shape
    # The lobe is smooth, so it is evaluated at every third vertex in space and interpolated there.
    kept = np.arange(0, len(vertices), 3)
    reflected = shading.reflected(vertices[kept], normals[kept], camera.camera_to_world[:3, 3])
    distance, near = cKDTree(vertices[kept]).query(vertices, k=4)
    weight = (
        1.0
        / np.maximum(distance, 1e-4) ** 2
        * np.maximum((normals[:, None] * normals[kept][near]).sum(-1), 0.0) ** 8
    )
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
    mirror = np.einsum("nk,nkc->nc", weight, reflected[near])
    values = np.concatenate([shading.diffuse, mirror, vertices], axis=1).astype(np.float32)
    fine = camera.resized(SUPERSAMPLED * camera.width, SUPERSAMPLED * camera.height)
    found = rasterise(vertices, faces, fine)
    image = np.zeros((camera.height, camera.width, 4), np.float32)
    for first in range(0, fine.height, 256):
        band = slice(first, first + 256)
        part = Fragments(found.face[band], found.barycentric[band], found.depth[band])
        if part.covered.any():
            rows = slice(first // SUPERSAMPLED, (first + 256) // SUPERSAMPLED)
            image[rows] = block_means(_shaded(part, faces, values), SUPERSAMPLED)
    image[..., :3] /= np.maximum(image[..., 3:], 1e-6)
    return image


def _shaded(part: Fragments, faces: np.ndarray, values: np.ndarray) -> np.ndarray:
    seen = interpolate(part, faces, values)
    picture = np.zeros((*part.face.shape, 4), np.float32)
    picture[part.covered, :3] = albedo_at(seen[:, 6:]) * seen[:, :3] + seen[:, 3:6]
    picture[part.covered, 3] = 1.0
    return picture


def write_capture(folder: Path, side: int, views: int, tests: int, light: str = "morning") -> None:
    """Write photographs and cameras into `folder`."""
    shape = drum()
    radiance = environment_image(light)
    if len(radiance) > 32:
        radiance = block_means(radiance, len(radiance) // 32)
    shading = Shading(shape[1], radiance.astype(np.float64))
    for split, count, phase in (("train", views, 0.0), ("test", tests, 1.0)):
        (folder / split).mkdir(parents=True, exist_ok=True)
        frames = []
        for k, direction in enumerate(spiral(count, phase)):
            name = f"{split}/{k:03d}"
            camera = camera_of(direction, side, name)
            picture = photograph(camera, shape, shading)
            levels = np.concatenate([srgb_from_linear(picture[..., :3]), picture[..., 3:]], axis=-1)
            Image.fromarray(np.round(255.0 * np.clip(levels, 0.0, 1.0)).astype(np.uint8)).save(
                folder / f"{name}.png", compress_level=1
            )
            frames.append({"file_path": f"./{name}", "transform_matrix": camera.camera_to_world.tolist()})
            print(name, flush=True)
        text = json.dumps({"camera_angle_x": ANGLE, "frames": frames}, indent=1)
        (folder / f"transforms_{split}.json").write_text(text + "\n", encoding="utf-8")


def main() -> None:
    """Write the capture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--side", type=int, default=1600)
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--tests", type=int, default=2)
    options = parser.parse_args()
    write_capture(options.output, options.side, options.views, options.tests)


if __name__ == "__main__":
    main()
