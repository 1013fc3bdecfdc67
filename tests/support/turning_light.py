"""A lamp and a sky that stand still with the camera, so that they turn around the object."""

import math

import numpy as np
import torch
from flashcache.encoding.turns import IDENTITY
from flashcache.geometry.directions import environment_directions
from lambent_core.scene import Scene, View
from support.lit_sphere import camera
from support.sphere import sphere_quadrature
from support.sphere_model import RADIUS

ALBEDO = (0.6, 0.3, 0.15)
LAMP = np.array([0.8, 0.1, 0.6]) / np.linalg.norm([0.8, 0.1, 0.6])
"""Where the lamp shines from in the light's frame."""


def about(axis: tuple[float, float, float], degrees: float) -> np.ndarray:
    """Return the rotation by an angle about an axis (Rodrigues)."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = math.radians(degrees)
    return np.eye(3) + math.sin(angle) * skew + (1.0 - math.cos(angle)) * skew @ skew


def flat(rotations: list[np.ndarray]) -> tuple[tuple[float, ...], ...]:
    """Return turns as a domain has them, after the identity."""
    return (IDENTITY, *(tuple(rotation.ravel().tolist()) for rotation in rotations))


TURNS = [about((0.0, 0.0, 1.0), 70.0), about((0.2, 1.0, 0.3), 40.0)]
"""One on the circle, and one with the object tilted."""


def sky(directions: torch.Tensor) -> torch.Tensor:
    """Return the radiance of the light's own directions: a coloured lamp in a dim sky."""
    toward = directions @ torch.from_numpy(LAMP).to(directions)
    lamp = 3.0 * torch.exp(6.0 * (toward - 1.0))[:, None] * directions.new_tensor([1.0, 0.8, 0.5])
    return 0.2 + 0.1 * directions[:, 2:3] + lamp


def sky_map(height: int) -> torch.Tensor:
    """Return `sky` as a latitude-longitude picture."""
    directions = environment_directions(height, 2 * height).reshape(-1, 3)
    return sky(directions).reshape(height, 2 * height, 3)


def irradiance(normals: np.ndarray) -> np.ndarray:
    """Return irradiance over pi from `sky` for normals [n, 3] in the light's frame, by quadrature."""
    directions, weight = sphere_quadrature(24, 48)
    cosine = (torch.from_numpy(normals) @ directions.T).clamp_min(0.0)
    return ((cosine * weight) @ sky(directions) / math.pi).numpy()


def turntable(num_views: int = 8, side: int = 16, *, told: bool = True) -> Scene:
    """Return a Lambertian ball on a turntable; its views know their turns if they are `told`."""
    views = []
    for number in range(num_views):
        azimuth = 2.0 * np.pi * number / num_views
        cam = camera(azimuth, (0.2, -0.3, 0.6)[number % 3], side)
        turn = about((0.0, 0.0, 1.0), -math.degrees(azimuth))
        picture = photograph(cam, turn)
        views.append(
            View(
                name=f"train_{number}", camera=cam, images={"sky": picture}, light_turn=turn if told else None
            )
        )
    return Scene(
        name="turntable",
        lights=("sky",),
        train=tuple(views),
        test=(),
        bounds_min=(-1.2, -1.2, -1.2),
        bounds_max=(1.2, 1.2, 1.2),
        primary=(1.5, 4.5),
        secondary=(0.05, 1.6),
        contraction_radius=1.0,
    )


def photograph(cam, turn: np.ndarray, radius: float = RADIUS) -> np.ndarray:
    """Return the picture [H, W, 4] of the ball with its light at `turn`, linear radiance and coverage."""
    columns, rows = np.meshgrid(np.arange(cam.width) + 0.5, np.arange(cam.height) + 0.5)
    local = np.stack(
        [(columns - cam.centre_x) / cam.focal_x, -(rows - cam.centre_y) / cam.focal_y, -np.ones_like(rows)],
        -1,
    )
    directions = local @ cam.camera_to_world[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    b = directions @ cam.position
    discriminant = b * b - (cam.position @ cam.position - radius**2)
    hit = discriminant > 0.0
    distance = -b - np.sqrt(np.maximum(discriminant, 0.0))
    normals = (cam.position + distance[..., None] * directions)[hit] / radius
    picture = np.zeros((cam.height, cam.width, 4), np.float32)
    picture[hit, :3] = np.array(ALBEDO) * irradiance(normals @ turn.T)
    picture[..., 3] = hit
    return picture
