"""Views of a sphere with true maps, means over pixels: distance, normal, albedo of two halves, materials."""

import numpy as np
from lambent_core.scene import View
from support.lit_sphere import BOTTOM, RADIUS, TOP, camera

ROUGHNESS, METALNESS = 0.4, 0.25
FINE = 4
"""Rays along the side of a pixel."""


def measured_view(name: str, azimuth: float, elevation: float, side: int) -> View:
    """Return a view with photograph and truth, straight alpha."""
    cam = camera(azimuth, elevation, side)
    places = (np.arange(side * FINE) + 0.5) / FINE - side / 2
    x, y = np.meshgrid(places / cam.focal_x, -places / cam.focal_y)
    directions = np.stack([x, y, -np.ones_like(x)], axis=-1) @ cam.camera_to_world[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    b = directions @ cam.position
    discriminant = b * b - (cam.position @ cam.position - RADIUS**2)
    hit = (discriminant > 0.0)[..., None].astype(float)
    distance = (-b - np.sqrt(np.maximum(discriminant, 0.0)))[..., None]
    normal = (cam.position + distance * directions) / RADIUS
    albedo = np.where(normal[..., 2:] > 0.0, TOP, BOTTOM)

    def pixels(values: np.ndarray) -> np.ndarray:
        return (values * hit).reshape(side, FINE, side, FINE, -1).mean(axis=(1, 3))

    alpha = pixels(hit)

    def mean(values: np.ndarray) -> np.ndarray:
        return pixels(values) / np.maximum(alpha, 1e-9)

    upright = mean(normal)
    upright /= np.maximum(np.linalg.norm(upright, axis=-1, keepdims=True), 1e-9)
    maps = {
        "albedo": np.concatenate([mean(albedo), alpha], axis=-1),
        "normal": np.concatenate([upright, alpha], axis=-1),
        "roughness": ROUGHNESS * (alpha > 0.0),
        "metallic": METALNESS * (alpha > 0.0),
        "distance": mean(distance),
    }
    truth = {kind: values.astype(np.float32) for kind, values in maps.items()}
    return View(name=name, camera=cam, images={"sky": truth["albedo"]}, truth=truth)


def measured_views(count: int = 8, side: int = 48) -> list[View]:
    """Return views from all sides, above and below."""
    golden = np.pi * (3.0 - np.sqrt(5.0))
    heights = np.arcsin(np.linspace(-0.8, 0.8, count))
    return [measured_view(f"test_{k:03d}", k * golden, float(heights[k]), side) for k in range(count)]
