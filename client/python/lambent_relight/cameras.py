"""Pinhole cameras: files of them, turntables, and the rays through their pixels.

Camera axes are OpenGL's: x right, y up, looking along -z. Pixel centres lie at half-integer
coordinates, row 0 at the top. The world is right-handed with z up.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from lambent_core.errors import CameraError
from numpy.typing import NDArray

from lambent_relight.arguments import array, file_path, instance, number, refusal, whole

_MAX_SIDE = 16384
_MAX_CAMERAS = 100_000
_MAX_FILE_BYTES = 64 << 20
_refuse = refusal("camera.argument", CameraError)
Vector = Sequence[float] | NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera; lengths in pixels, pose in scene units.

    Raises CameraError `camera.argument` for values that no camera has.
    """

    name: str
    width: int
    height: int
    focal_x: float
    focal_y: float
    centre_x: float
    centre_y: float
    camera_to_world: NDArray[np.float64]
    """[4, 4], a rotation and a position; anything that numpy makes such an array of."""

    def __post_init__(self) -> None:
        instance(self.name, str, "name", "give a camera a name", refuse=_refuse)
        for name in ("width", "height"):
            object.__setattr__(self, name, whole(getattr(self, name), name, 1, refuse=_refuse))
        for name in ("focal_x", "focal_y"):
            object.__setattr__(self, name, number(getattr(self, name), name, above=0.0, refuse=_refuse))
        for name in ("centre_x", "centre_y"):
            object.__setattr__(self, name, number(getattr(self, name), name, refuse=_refuse))
        pose = array(self.camera_to_world, (4, 4), "camera_to_world", refuse=_refuse)
        if not is_rigid(pose):
            raise _refuse("camera_to_world is not a rotation and a position", NOT_RIGID_ADVICE)
        object.__setattr__(self, "camera_to_world", pose)

    def __repr__(self) -> str:
        """Return name, size, focal length and position in one line."""
        x, y, z = self.camera_to_world[:3, 3]
        return (
            f"Camera({self.name!r}, {self.width} x {self.height} pixels, focal length {self.focal_x:.4g}, "
            f"at ({x:.4g}, {y:.4g}, {z:.4g}))"
        )

    @classmethod
    def centred(
        cls, name: str, width: int, height: int, focal: float, camera_to_world: NDArray[np.float64]
    ) -> "Camera":
        """Return a camera with square pixels that looks through the middle of its picture."""
        return cls(
            name=name,
            width=width,
            height=height,
            focal_x=focal,
            focal_y=focal,
            centre_x=width / 2.0,
            centre_y=height / 2.0,
            camera_to_world=camera_to_world,
        )

    def rays(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return origins and unit directions of the pixel-centre rays, each [height * width, 3], by rows."""
        x = (np.arange(self.width) + 0.5 - self.centre_x) / self.focal_x
        y = (self.centre_y - np.arange(self.height) - 0.5) / self.focal_y
        grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
        local = np.stack([grid_x, grid_y, -np.ones_like(grid_x)], axis=-1).reshape(-1, 3)
        local /= np.linalg.norm(local, axis=-1, keepdims=True)
        directions = local @ self.camera_to_world[:3, :3].T
        origins = np.broadcast_to(self.camera_to_world[:3, 3], directions.shape)
        return origins.astype(np.float32), directions.astype(np.float32)

    def depth_along_axis(self, distance: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the depth along the camera's axis of points at `distance` along the pixel-centre rays.

        Both are [height, width, 1], in scene units.
        """
        x = (np.arange(self.width) + 0.5 - self.centre_x) / self.focal_x
        y = (np.arange(self.height) + 0.5 - self.centre_y) / self.focal_y
        stretch = np.sqrt(1.0 + x[None, :] ** 2 + y[:, None] ** 2)
        return (distance / stretch[..., None]).astype(np.float32)

    def resized(self, width: int, height: int) -> "Camera":
        """Return the same view with other pixel counts; the field of view is kept along each axis."""
        scale_x, scale_y = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            focal_x=self.focal_x * scale_x,
            focal_y=self.focal_y * scale_y,
            centre_x=self.centre_x * scale_x,
            centre_y=self.centre_y * scale_y,
        )

    def finer(self, factor: int) -> "Camera":
        """Return the same view with `factor` x `factor` pixels for each."""
        return self.resized(self.width * factor, self.height * factor)

    def key(self) -> bytes:
        """Return a value that is equal for cameras that see the same rays."""
        numbers = (self.width, self.height, self.focal_x, self.focal_y, self.centre_x, self.centre_y)
        return np.array(numbers, np.float64).tobytes() + np.ascontiguousarray(self.camera_to_world).tobytes()

    def exr_attributes(self) -> Mapping[str, NDArray[np.float32]]:
        """Return `worldToCamera` and `worldToNDC` [4, 4], the camera as attributes of an EXR file.

        Frames are those of OpenEXR's standard attributes, which are Renderman's: points are row vectors
        before a matrix; camera space is left-handed, x right, y up, z forward; NDC is (0, 0) in the upper
        left corner of the picture and (1, 1) in the lower right one. A world point (x, y, z, 1) times
        worldToNDC, divided by its last number, which is the depth along the axis, begins with the place in
        the picture.
        """
        to_camera = np.diag([1.0, 1.0, -1.0, 1.0]) @ np.linalg.inv(self.camera_to_world)
        # Rows of the picture go down. The third row keeps the matrix invertible: depth 1 becomes 0.
        to_ndc = np.array(
            [
                [self.focal_x / self.width, 0.0, self.centre_x / self.width, 0.0],
                [0.0, -self.focal_y / self.height, self.centre_y / self.height, 0.0],
                [0.0, 0.0, 1.0, -1.0],
                [0.0, 0.0, 1.0, 0.0],
            ]
        )
        return {
            "worldToCamera": np.ascontiguousarray(to_camera.T, np.float32),
            "worldToNDC": np.ascontiguousarray((to_ndc @ to_camera).T, np.float32),
        }


NOT_RIGID_ADVICE = "remove scale and mirroring; axes are x right, y up, looking along -z"


def is_rigid(pose: NDArray[np.float64]) -> bool:
    """Return whether a matrix [4, 4] is a rotation (to 1e-3) and a position."""
    rotation = pose[:3, :3]
    orthonormal = np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-3) and np.linalg.det(rotation) > 0
    return bool(orthonormal and np.allclose(pose[3], [0, 0, 0, 1], atol=1e-6))


def cameras_from_arrays(
    camera_to_world: object,
    *,
    width: int,
    height: int,
    focal: float,
    names: Sequence[str] = (),
) -> list[Camera]:
    """Return cameras with square pixels of the poses [n, 4, 4] or [n, 3, 4] that another program has.

    `focal` is in pixels, and the middle of the picture is that of the lens. Without `names` they are called
    camera_000, camera_001 and so on. Raises CameraError `camera.argument`.
    """
    poses = array(camera_to_world, (None, None, 4), "camera_to_world", refuse=_refuse)
    if poses.shape[1] not in (3, 4):
        raise _refuse(f"camera_to_world has shape {list(poses.shape)}", "give [n, 4, 4] or [n, 3, 4]")
    if poses.shape[1] == 3:
        last = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(poses), 1, 4))
        poses = np.concatenate([poses, last], axis=1)
    called = list(names) or [f"camera_{index:03d}" for index in range(len(poses))]
    if len(called) != len(poses):
        raise _refuse(f"there are {len(called)} names for {len(poses)} poses", "give one name for each")
    return [
        Camera.centred(name, width, height, focal, pose) for name, pose in zip(called, poses, strict=True)
    ]


def look_at(position: Vector, target: Vector) -> NDArray[np.float64]:
    """Return the camera-to-world matrix at `position` that looks at `target` with +z upwards.

    Straight up or down, where that leaves the roll open, +y is upwards. Raises CameraError `camera.argument`.
    """
    eye = array(position, (3,), "position", refuse=_refuse)
    goal = array(target, (3,), "target", refuse=_refuse)
    if np.array_equal(eye, goal):
        raise _refuse("position and target are the same point", "move one of them")
    backward = (eye - goal) / np.linalg.norm(eye - goal)
    up = np.array([0.0, 1.0, 0.0]) if abs(backward[2]) > 1.0 - 1e-9 else np.array([0.0, 0.0, 1.0])
    right = np.cross(up, backward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(backward, right), backward, eye
    return pose


def position_around(
    target: Vector, distance: float, azimuth_deg: float, elevation_deg: float
) -> NDArray[np.float64]:
    """Return the point at `distance` from `target`, scene units; azimuth 0 is +x and grows towards +y."""
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    aside = math.cos(elevation)
    away = (aside * math.cos(azimuth), aside * math.sin(azimuth), math.sin(elevation))
    return np.asarray(target, np.float64) + distance * np.array(away)


def turntable(
    num_views: int,
    *,
    radius: float,
    elevation_deg: float = 20.0,
    target: Vector = (0.0, 0.0, 0.0),
    width: int = 512,
    height: int = 512,
    field_of_view_deg: float = 40.0,
    start_deg: float = 0.0,
) -> list[Camera]:
    """Return `num_views` cameras evenly around the z axis through `target`, at `radius` scene units from it.

    View k is at azimuth `start_deg` + k 360 / `num_views` (0 = +x, growing towards +y) and looks at
    `target`. `field_of_view_deg` is horizontal.
    """
    num_views = whole(num_views, "num_views", 1, _MAX_CAMERAS, refuse=refusal("camera.count", CameraError))
    width = whole(width, "width", 1, _MAX_SIDE, refuse=_refuse)
    height = whole(height, "height", 1, _MAX_SIDE, refuse=_refuse)
    target = array(target, (3,), "target", refuse=_refuse).tolist()
    elevation_deg = number(elevation_deg, "elevation_deg", refuse=_refuse)
    start_deg = number(start_deg, "start_deg", refuse=_refuse)
    radius = number(radius, "radius", above=0.0, refuse=refusal("camera.radius", CameraError))
    field_of_view_deg = number(
        field_of_view_deg,
        "field_of_view_deg",
        above=0.0,
        below=180.0,
        refuse=refusal("camera.field_of_view", CameraError),
    )
    focal = 0.5 * width / math.tan(math.radians(field_of_view_deg) / 2.0)
    cameras = []
    for index in range(num_views):
        position = position_around(target, radius, start_deg + 360.0 * index / num_views, elevation_deg)
        pose = look_at(position, target)
        cameras.append(Camera.centred(f"turntable_{index:03d}", width, height, focal, pose))
    return cameras


def load_cameras(path: Path | str) -> list[Camera]:
    """Return the cameras of a cameras.json, in file order.

    Raises CameraError, naming the camera, for missing or impossible values.
    """
    path = file_path(path, "path", refuse=_refuse)
    if not path.is_file():
        raise CameraError("camera.file_missing", f'there is no file "{path}"', "check the path")
    if path.stat().st_size > _MAX_FILE_BYTES:
        raise CameraError("camera.file_too_large", f'"{path.name}" is above 64 MiB', "split the file")
    return parse_cameras(path.read_bytes(), source=path.name)


def parse_cameras(data: bytes, *, source: str = "cameras.json") -> list[Camera]:
    """Return the cameras of the text of a cameras.json; see `load_cameras`."""
    try:
        return parse_camera_list(json.loads(data)["cameras"], source=source)
    except CameraError:
        raise
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise CameraError(
            "camera.file_unreadable",
            f'"{source}" is not {{"cameras": [...]}} ({type(error).__name__})',
            "see docs/reference/bundle-format.md for the fields",
        ) from error


def parse_camera_list(entries: Sequence[Any], *, source: str = "cameras.json") -> list[Camera]:
    """Return the cameras of the entries of a cameras.json; see `load_cameras`."""
    if not 0 < len(entries) <= _MAX_CAMERAS:
        raise CameraError(
            "camera.count", f'"{source}" has {len(entries)} cameras', f"give 1 to {_MAX_CAMERAS}"
        )
    return [_parse_camera(entry, index, source) for index, entry in enumerate(entries)]


def _parse_camera(entry: Any, index: int, source: str) -> Camera:
    def fault(what: str, advice: str) -> CameraError:
        return CameraError("camera.invalid", f'camera {index} of "{source}" {what}', advice)

    try:
        numbers = {
            name: float(entry[name])
            for name in ("width", "height", "focal_x", "focal_y", "centre_x", "centre_y")
        }
        pose = np.array(entry["camera_to_world"], np.float64).reshape(4, 4)
        name = str(entry.get("name", f"camera_{index:03d}"))
    except KeyError as error:
        raise fault(f"has no {error}", "add the field") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise fault(
            "has a field of the wrong kind", "give numbers, and 16 of them in camera_to_world"
        ) from error
    width, height = numbers.pop("width"), numbers.pop("height")
    if not (
        width.is_integer() and height.is_integer() and 1 <= width <= _MAX_SIDE and 1 <= height <= _MAX_SIDE
    ):
        raise fault(f"has the size {width} x {height}", f"give whole numbers from 1 to {_MAX_SIDE}")
    if not (np.isfinite(pose).all() and np.isfinite(list(numbers.values())).all()):
        raise fault("holds NaN or infinite values", "fix the pose")
    if min(numbers["focal_x"], numbers["focal_y"]) <= 0.0:
        raise fault("has a focal length that is not positive", "give focal lengths in pixels")
    if not is_rigid(pose):
        raise fault("has a camera_to_world that is not a rotation and a position", NOT_RIGID_ADVICE)
    return Camera(name=name, width=int(width), height=int(height), camera_to_world=pose, **numbers)


def cameras_json(cameras: Sequence[Camera]) -> str:
    """Return the text of a cameras.json that holds `cameras`; raises CameraError for anything else."""
    instance(cameras, Sequence, "cameras", "give a list of cameras", refuse=_refuse)  # type: ignore[type-abstract]
    for camera in cameras:
        instance(camera, Camera, "an entry of cameras", "use turntable or load_cameras", refuse=_refuse)
    fields = ("name", "width", "height", "focal_x", "focal_y", "centre_x", "centre_y")
    entries = [
        {field: getattr(camera, field) for field in fields}
        | {"camera_to_world": camera.camera_to_world.ravel().tolist()}
        for camera in cameras
    ]
    return json.dumps({"cameras": entries}, indent=1)
