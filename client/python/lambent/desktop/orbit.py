"""A camera that circles a point, steered by hand: around, nearer, sideways."""

import math
from dataclasses import dataclass, replace

import numpy as np
from lambent_relight import Bundle, Camera, look_at
from lambent_relight.cameras import position_around
from lambent_relight.object_cameras import around_object

MAX_ELEVATION_DEG = 89.0
_NEAREST, _FARTHEST = 0.2, 5.0
"""Limits of the distance, as shares of the first one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Orbit:
    """Where the camera stands; z is up, azimuth 0 is +x and grows towards +y."""

    target: tuple[float, float, float]
    """Point that the camera looks at, scene units."""
    azimuth_deg: float
    elevation_deg: float
    distance: float
    """From the target, scene units."""
    field_of_view_deg: float
    """Along the shorter side of the picture."""
    first_distance: float

    def camera(self, width: int, height: int) -> Camera:
        """Return the camera of a picture with `width` x `height` pixels."""
        position = position_around(self.target, self.distance, self.azimuth_deg, self.elevation_deg)
        pose = look_at(position, self.target)
        return Camera.centred("orbit", width, height, self._focal(width, height), pose)

    def turned(self, azimuth_deg: float, elevation_deg: float) -> "Orbit":
        """Return the camera further around by `azimuth_deg` and higher by `elevation_deg`."""
        elevation = min(max(self.elevation_deg + elevation_deg, -MAX_ELEVATION_DEG), MAX_ELEVATION_DEG)
        azimuth = (self.azimuth_deg + azimuth_deg + 180.0) % 360.0 - 180.0
        return replace(self, azimuth_deg=azimuth, elevation_deg=elevation)

    def nearer(self, factor: float) -> "Orbit":
        """Return the camera at its distance over `factor`, within limits."""
        limits = (_NEAREST * self.first_distance, _FARTHEST * self.first_distance)
        return replace(self, distance=min(max(self.distance / factor, limits[0]), limits[1]))

    def moved(self, right_px: float, down_px: float, width: int, height: int) -> "Orbit":
        """Return the camera moved so that the picture follows the mouse by so many pixels."""
        axes = self.camera(width, height).camera_to_world[:3, :2]
        scale = self.distance / self._focal(width, height)
        shift = axes @ np.array([-right_px * scale, down_px * scale])
        return replace(self, target=tuple((np.array(self.target) + shift).tolist()))

    def _focal(self, width: int, height: int) -> float:
        return 0.5 * min(width, height) / math.tan(math.radians(self.field_of_view_deg) / 2.0)


def orbit_around(bundle: Bundle) -> Orbit:
    """Return a camera at the distance, height and field of view of the bundle's own cameras."""
    (camera,) = around_object(bundle, 1, size=2)
    pose = camera.camera_to_world
    bounds = bundle.manifest.bounds
    target = (np.array(bounds.minimum) + np.array(bounds.maximum)) / 2.0
    offset = pose[:3, 3] - target
    distance = float(np.linalg.norm(offset))
    return Orbit(
        target=tuple(target.tolist()),
        azimuth_deg=math.degrees(math.atan2(offset[1], offset[0])),
        elevation_deg=math.degrees(math.asin(offset[2] / distance)),
        distance=distance,
        field_of_view_deg=math.degrees(2.0 * math.atan(0.5 * camera.width / camera.focal_x)),
        first_distance=distance,
    )
