"""A printed box without anything around it, its exact light transport, and photographs of it.

Nothing of a box can be hidden by itself, so its transport is that of an open sky.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from lambent_asset.textures.photo_shading import SurfaceUnderLight
from lambent_asset.textures.surface import AtlasSurface
from lambent_core.directions import pixel_directions
from lambent_core.scene import Camera, View
from lambent_relight import cameras as relight_cameras
from lambent_relight.baked.mesh import AtlasMesh
from lambent_relight.baked.raster import block_means, interpolate, rasterise
from lambent_relight.baked.scene import BakedScene, baked_scene
from lambent_relight.baked.transport import Transport, coarse_blocks
from lambent_relight.environment import harmonics

Print = Callable[[np.ndarray], np.ndarray]
"""Albedo [n, 3] at positions [n, 3]."""
PAPER, INK = np.float32([0.7, 0.6, 0.5]), np.float32([0.1, 0.15, 0.2])
SUPERSAMPLED = 3


def stripes(positions: np.ndarray) -> np.ndarray:
    """Return slanted stripes of ink, about a fifth of a unit wide."""
    phase = positions @ np.float32([0.9, 0.5, 0.33]) * 2.5
    return np.where((phase % 1.0 < 0.5)[:, None], INK, PAPER)


def sky() -> np.ndarray:
    """Return a map that is bright above and to one side."""
    directions = pixel_directions(32, 64)
    level = 0.4 + 0.5 * np.maximum(directions[..., 2], 0.0) + 0.6 * np.maximum(directions[..., 0], 0.0) ** 4
    return (level[..., None] * np.array([1.0, 0.95, 0.9])).astype(np.float32)


def open_scene(
    surface: AtlasSurface, albedo: np.ndarray, *, roughness: float = 0.6, metal: float = 0.0
) -> BakedScene:
    """Return `surface` with nothing around it; `albedo` [texel, 3] is what the model knows."""
    normals, count = surface.texel_normals, len(surface.texel_index)
    direct = harmonics.basis(normals, 7) * harmonics.cosine_factors(7)
    visibility = np.zeros((9, count), np.float32)
    visibility[0] = np.sqrt(4.0 * np.pi)
    blocks = len(coarse_blocks(surface.size, surface.texel_index)[0])
    rest = np.broadcast_to(np.float32([roughness, metal]), (count, 2))
    transport = Transport(
        surface.size,
        surface.texel_index,
        np.ascontiguousarray(direct.T, np.float32),
        visibility,
        np.zeros((9, 3, blocks), np.float32),
        None,
        np.ascontiguousarray(np.concatenate([albedo, rest, normals], axis=1).T, np.float32),
    )
    return baked_scene(AtlasMesh(surface.vertices, surface.faces, surface.uv), transport)


def photograph(
    surface: AtlasSurface,
    scene: BakedScene,
    camera: relight_cameras.Camera,
    paint: Print,
    radiance: np.ndarray,
    turn: np.ndarray | None = None,
) -> View:
    """Return the view of `camera` under the light "sky", painted with `paint`; materials are the scene's."""
    fine = camera.resized(SUPERSAMPLED * camera.width, SUPERSAMPLED * camera.height)
    found = rasterise(surface.vertices, surface.faces, fine)
    positions = interpolate(found, surface.faces, surface.vertices)
    texel = scene.texels_at(interpolate(found, surface.faces, surface.uv))
    omega_o = -fine.rays()[1][np.flatnonzero(found.covered)]
    gain, offset = SurfaceUnderLight(scene, radiance).turned(turn).linear_in_albedo(texel, omega_o)
    picture = np.zeros((fine.height, fine.width, 4), np.float32)
    picture[found.covered, :3] = gain * paint(positions) + offset
    picture[found.covered, 3] = 1.0
    image = block_means(picture, SUPERSAMPLED)
    image[..., :3] /= np.maximum(image[..., 3:], 1e-6)
    names = ("width", "height", "focal_x", "focal_y", "centre_x", "centre_y", "camera_to_world")
    own = Camera(**{name: getattr(camera, name) for name in names})
    return View(name=camera.name, camera=own, images={"sky": image}, light_turn=turn)


def around(count: int, side: int) -> list[relight_cameras.Camera]:
    """Return cameras above and below the box."""
    half = -(-count // 2)
    common = {"radius": 7.0, "width": side, "height": side, "field_of_view_deg": 34.0}
    high = relight_cameras.turntable(half, elevation_deg=40.0, **common)
    low = relight_cameras.turntable(count - half, elevation_deg=-35.0, **common)
    return [*high, *low]
