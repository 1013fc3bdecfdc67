"""A phone's camera, and how a person carries it around an object."""

from dataclasses import dataclass

import numpy as np

FOCAL_35MM = 26.0
FILM_DIAGONAL_MM = 43.2666


@dataclass(frozen=True, kw_only=True, slots=True)
class Camera:
    """A pinhole with radial distortion; pixel (0, 0) has its centre at (0.5, 0.5)."""

    width: int
    height: int
    focal: float
    camera_to_world: np.ndarray
    k1: float = 0.0
    k2: float = 0.0
    """Distorted = undistorted (1 + k1 r^2 + k2 r^4), r in units of the focal length (OpenCV's model)."""

    def undistorted(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return undistorted coordinates on the plane z = 1 of distorted ones, also Dr.Jit arrays."""
        u, v = x, y
        for _ in range(8 if self.k1 or self.k2 else 0):
            square = u * u + v * v
            scale = 1.0 / (1.0 + self.k1 * square + self.k2 * square * square)
            u, v = x * scale, y * scale
        return u, v

    def resized(self, width: int) -> "Camera":
        """Return the same camera with fewer pixels; the height follows."""
        ratio = width / self.width
        return Camera(
            width=width,
            height=round(self.height * ratio),
            focal=self.focal * ratio,
            camera_to_world=self.camera_to_world,
            k1=self.k1,
            k2=self.k2,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class Shot:
    """A photograph to be taken."""

    camera: Camera
    orientation: int = 1
    """EXIF's; 6 and 8 are upright photographs that are stored lying down."""
    turn_deg: float = 0.0
    """How far the object is turned about +z, for a turntable; the camera is that of the room."""


def look_at(eye: np.ndarray, target: np.ndarray, roll_deg: float) -> np.ndarray:
    """Return camera-to-world [4, 4] of a camera at `eye`, turned by `roll_deg` about its axis."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    cos, sin = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    pose = np.eye(4)
    pose[:3] = np.stack([cos * right + sin * up, cos * up - sin * right, back, eye], axis=1)
    return pose


def phone(size: int, pose: np.ndarray, *, upright: bool, k1: float = 0.0, k2: float = 0.0) -> Camera:
    """Return the phone's camera, 4:3 with `size` pixels on the longer side."""
    width, height = (round(size * 3 / 4), size) if upright else (size, round(size * 3 / 4))
    focal = FOCAL_35MM / FILM_DIAGONAL_MM * float(np.hypot(width, height))
    return Camera(width=width, height=height, focal=focal, camera_to_world=pose, k1=k1, k2=k2)


def rounds(num_views: int) -> list[tuple[int, float]]:
    """Return the rounds of a walk: how many photographs each has, and its elevation in degrees.

    Few photographs make one round, and two from above: steps wider than 30 degrees have too little in common.
    """
    if num_views < 24:
        return [(num_views - 2, 38.0), (2, 62.0)]
    low, mid = round(0.5 * num_views), round(0.35 * num_views)
    return [(low, 24.0), (mid, 45.0), (num_views - low - mid, 66.0)]


def sixteen(num_views: int) -> list[int]:
    """Return which of a walk's photographs would do alone: a middle round, and some from above."""
    if num_views < 24:
        return np.linspace(0, num_views, min(num_views, 16), endpoint=False).astype(int).tolist()
    (low, _), (mid, _), (top, _) = rounds(num_views)
    round_of = np.linspace(low, low + mid, min(mid, 14), endpoint=False).astype(int)
    above = np.linspace(low + mid, num_views, min(16 - len(round_of), top), endpoint=False).astype(int)
    return sorted({*round_of.tolist(), *above.tolist()})


def around(num_views: int, middle: np.ndarray, distance: float, seed: int) -> list[np.ndarray]:
    """Return poses of a walk around `middle`: a low round, a higher one, and a few from above.

    The hand drifts in height and distance, the object is not quite in the picture's middle, and the horizon
    is not quite level.
    """
    rng = np.random.default_rng(seed)
    poses = []
    for count, elevation in rounds(num_views):
        start = rng.uniform(0.0, 360.0)
        drift = np.cumsum(rng.normal(0.0, 1.0, count + 1))
        drift -= np.linspace(0.0, drift[-1], count + 1)
        for k in range(count):
            azimuth = np.radians(start + 360.0 * (k + rng.uniform(-0.25, 0.25)) / count)
            high = np.radians(np.clip(elevation + 2.0 * drift[k] + rng.normal(0.0, 2.0), 15.0, 76.0))
            far = distance * (1.0 + np.clip(0.06 * rng.normal(), -0.12, 0.15))
            back = np.array([np.cos(high) * np.cos(azimuth), np.cos(high) * np.sin(azimuth), np.sin(high)])
            target = middle + np.clip(rng.normal(0.0, 0.035, 3), -0.07, 0.07) * distance
            poses.append(look_at(middle + far * back, target, float(np.clip(2.0 * rng.normal(), -5, 5))))
    return poses


def between(num_views: int, middle: np.ndarray, distance: float, seed: int) -> list[np.ndarray]:
    """Return poses for held-out views, between the heights and directions of `around`."""
    rng = np.random.default_rng(seed + 1000)
    poses = []
    for k in range(num_views):
        azimuth = 2.0 * np.pi * (k + rng.uniform(0.2, 0.8)) / num_views
        high = np.radians((32.0, 55.0)[k % 2] + rng.uniform(-3.0, 3.0))
        back = np.array([np.cos(high) * np.cos(azimuth), np.cos(high) * np.sin(azimuth), np.sin(high)])
        poses.append(look_at(middle + distance * back, middle, 0.0))
    return poses


def turned_about_z(pose: np.ndarray, angle_deg: float) -> np.ndarray:
    """Return a camera-to-world matrix turned by `angle_deg` about the z axis."""
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    turn = np.eye(4)
    turn[:2, :2] = [[cos, -sin], [sin, cos]]
    return turn @ pose
