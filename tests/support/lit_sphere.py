"""A scene with an exact solution: a two-coloured Lambertian sphere under a uniform white sky.

Its radiance is its albedo, whatever the direction, since nothing occludes anything.
"""

import numpy as np
from flashcache.physical.model import Domain
from lambent_core.scene import Camera, Scene, View

RADIUS = 0.6
SIDE = 24
TOP, BOTTOM = np.array([0.7, 0.2, 0.1], np.float32), np.array([0.1, 0.3, 0.6], np.float32)


def look_at(position: np.ndarray) -> np.ndarray:
    """Return the pose of a camera at `position` that looks at the origin with z up."""
    back = position / np.linalg.norm(position)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(back, right), back, position
    return pose


def camera(azimuth: float, elevation: float, side: int = SIDE) -> Camera:
    """Return a camera at distance 3 from the origin; angles in radians."""
    horizontal = np.cos(elevation)
    position = 3.0 * np.array([horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), np.sin(elevation)])
    return Camera(
        width=side,
        height=side,
        focal_x=1.6 * side,
        focal_y=1.6 * side,
        centre_x=side / 2,
        centre_y=side / 2,
        camera_to_world=look_at(position),
    )


def photograph(cam: Camera) -> np.ndarray:
    """Return the exact picture [H, W, 4] at pixel centres, linear radiance and coverage."""
    columns, rows = np.meshgrid(np.arange(cam.width) + 0.5, np.arange(cam.height) + 0.5)
    local = np.stack(
        [
            (columns - cam.centre_x) / cam.focal_x,
            -(rows - cam.centre_y) / cam.focal_y,
            -np.ones_like(rows),
        ],
        axis=-1,
    )
    directions = local @ cam.camera_to_world[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    origin = cam.position
    b = directions @ origin
    discriminant = b * b - (origin @ origin - RADIUS**2)
    hit = discriminant > 0.0
    distance = -b - np.sqrt(np.maximum(discriminant, 0.0))
    upper = (origin + distance[..., None] * directions)[..., 2] > 0.0
    picture = np.zeros((cam.height, cam.width, 4), np.float32)
    picture[..., :3] = np.where(upper[..., None], TOP, BOTTOM) * hit[..., None]
    picture[..., 3] = hit
    return picture


def lit_sphere(num_views: int = 10, side: int = SIDE) -> Scene:
    """Return the scene with `num_views` training views and two test views of `side` pixels squared."""

    def view(name: str, azimuth: float, elevation: float) -> View:
        cam = camera(azimuth, elevation, side)
        return View(name=name, camera=cam, images={"sky": photograph(cam)})

    golden = np.pi * (3.0 - np.sqrt(5.0))
    heights = np.linspace(-0.8, 0.8, num_views)
    return Scene(
        name="lit_sphere",
        lights=("sky",),
        train=tuple(
            view(f"train_{i:03d}", i * golden, float(np.arcsin(height))) for i, height in enumerate(heights)
        ),
        test=(view("test_000", 0.3, 0.4), view("test_001", 2.3, -0.3)),
        bounds_min=(-0.8, -0.8, -0.8),
        bounds_max=(0.8, 0.8, 0.8),
        primary=(1.5, 4.5),
        secondary=(0.05, 1.6),
        contraction_radius=0.8,
    )


def lit_domain(scene: Scene) -> Domain:
    """Return the space of the scene, as a model must know it."""
    return Domain(
        bounds_min=scene.bounds_min,
        bounds_max=scene.bounds_max,
        primary=scene.primary,
        secondary=scene.secondary,
        contraction_radius=scene.contraction_radius,
        lights=scene.lights,
    )
