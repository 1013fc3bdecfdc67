"""Careful reading of what a capture folder says about itself: JSON files, paths, poses, lens angles."""

import json
import math
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float64
from numpy import ndarray

from lambent_worker.scenes.problems import Problems

MAX_JSON_BYTES = 64 * 2**20
MAX_NAME_BYTES, MAX_PATH_BYTES = 240, 1000
"""Of a file and of a path inside the folder; file systems take 255 and 4096, and suffixes are tried."""
RIGID_TOLERANCE = 1e-3
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Multiplied from the right: from camera axes x right, y down, z forward to x right, y up, z backward."""


def read_json_object(folder: Path, name: str, problems: Problems) -> dict[str, Any] | None:
    """Return the object in the JSON file `name` of `folder`, or None after noting why it cannot be had."""
    path = folder / name
    try:
        size = path.stat().st_size
        if size > MAX_JSON_BYTES:
            problems.error(
                "scene.metadata_too_large",
                f"{name} has {size} bytes, the limit is {MAX_JSON_BYTES}; remove what is not about cameras",
                name,
            )
            return None
        twice: list[str] = []
        value = json.loads(
            path.read_text(encoding="utf-8"), object_pairs_hook=lambda pairs: _object(pairs, twice)
        )
    except (OSError, UnicodeDecodeError, ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else str(error)
        problems.error(
            "scene.metadata_unreadable", f"{name} is not readable JSON ({reason}); write it again", name
        )
        return None
    if twice:
        problems.error(
            "scene.key_duplicate",
            f'{name} names "{twice[0][:100]}" twice where only one can be meant; remove or rename one',
            name,
        )
        return None
    if not isinstance(value, dict):
        problems.error(
            "scene.metadata_unreadable",
            f"{name} must hold a JSON object, found a {type(value).__name__}",
            name,
        )
        return None
    return value


def _object(pairs: list[tuple[str, Any]], twice: list[str]) -> dict[str, Any]:
    made = dict(pairs)
    if len(made) < len(pairs):
        names = [key for key, _ in pairs]
        twice.extend(key for key in made if names.count(key) > 1)
    return made


def finite_number(value: object) -> float | None:
    """Return `value` as a float, or None where it is not a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def finite_numbers(value: object, count: int) -> list[float] | None:
    """Return a list of `count` finite numbers, or None where `value` is anything else."""
    if not isinstance(value, list) or len(value) != count:
        return None
    numbers = [finite_number(item) for item in value]
    found = [number for number in numbers if number is not None]
    return found if len(found) == count else None


def inside_folder(path: str, subject: str, problems: Problems) -> PurePosixPath | None:
    """Return `path` in normal form, or None after noting that it leads out of the scene folder."""
    if "\\" in path or "\0" in path or not path or not _can_be_a_file_name(path):
        clean = None
    else:
        parts = [part for part in PurePosixPath(path).parts if part != "."]
        clean = None if path.startswith("/") or ".." in parts or not parts else PurePosixPath(*parts)
    if clean is None:
        problems.error(
            "scene.path_unsafe",
            f'{subject}: path "{path[:200]}" leaves the scene folder or is no file name; use a relative path '
            "with forward slashes and no ..",
            subject,
        )
    return clean


def _can_be_a_file_name(path: str) -> bool:
    try:
        parts = [len(part.encode("utf-8")) for part in path.split("/")]
    except UnicodeEncodeError:
        return False
    return max(parts) <= MAX_NAME_BYTES and sum(parts) + len(parts) <= MAX_PATH_BYTES


def focal_from_angle(angle: object, width: int, subject: str, problems: Problems) -> float | None:
    """Return the focal length in pixels of a horizontal field of view in radians, or None if it has none."""
    radians = finite_number(angle)
    if radians is None or not 0.0 < radians < math.pi:
        problems.error(
            "scene.camera_angle_invalid",
            f"{subject}: the horizontal field of view must lie between 0 and pi radians, "
            f"found {_short(angle)}",
            subject,
        )
        return None
    return 0.5 * width / math.tan(0.5 * radians)


def pose_from_numbers(value: object, subject: str, problems: Problems) -> Float64[ndarray, "4 4"] | None:
    """Return a camera-to-world matrix from 16 numbers (flat or 4 x 4), or None after noting what is wrong.

    The rotation part is cleaned of rounding by projecting it on the nearest rotation.
    """
    try:
        matrix = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.zeros(0)
    if matrix.size == 12:
        matrix = np.vstack([matrix.reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
    if matrix.size != 16:
        problems.error(
            "scene.camera_invalid",
            f"{subject}: the camera-to-world matrix must have 4 x 4 numbers, found {_short(value)}",
            subject,
        )
        return None
    matrix = matrix.reshape(4, 4)
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 1e6:
        problems.error(
            "scene.camera_not_finite",
            f"{subject}: the camera-to-world matrix holds NaN, infinity or a number above 1e6; "
            "leave the frame out or solve its pose again",
            subject,
        )
        return None
    return _rigid(matrix, subject, problems)


def pose_from_world_to_camera(
    value: object, subject: str, problems: Problems
) -> Float64[ndarray, "4 4"] | None:
    """Return the camera-to-world matrix with our camera axes of a world-to-camera matrix with OpenCV's.

    `value` has 3 x 4 or 4 x 4 numbers; OpenCV's axes are x right, y down, z forward. None after noting in
    `problems` what is wrong.
    """
    pose = pose_from_numbers(value, subject, problems)
    return None if pose is None else np.linalg.inv(pose) @ OPENGL_FROM_OPENCV


def _rigid(
    matrix: Float64[ndarray, "4 4"], subject: str, problems: Problems
) -> Float64[ndarray, "4 4"] | None:
    rotation = matrix[:3, :3]
    left, scale, right = np.linalg.svd(rotation)
    if scale[-1] < 1e-6:
        reason = "is singular"
    elif np.abs(scale - 1.0).max() > RIGID_TOLERANCE:
        reason = f"scales by {scale[0]:.4g} to {scale[-1]:.4g}"
    elif np.linalg.det(rotation) < 0.0:
        reason = "mirrors space (left-handed axes)"
    elif np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > RIGID_TOLERANCE:
        reason = "does not end with the row 0 0 0 1"
    else:
        clean = np.eye(4)
        clean[:3, :3] = left @ right
        clean[:3, 3] = matrix[:3, 3]
        return clean
    problems.error(
        "scene.camera_not_rigid",
        f"{subject}: the camera-to-world matrix {reason}; it must be a rotation and a translation "
        "(camera axes x right, y up, looking along -z)",
        subject,
    )
    return None


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
