"""Careful reading of what a capture folder says about itself: JSON files, paths, poses, lens angles."""

import codecs
import json
import math
import re
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from lambent_capture.arrays import Pose64
from lambent_capture.problems import Problems
from lambent_capture.scenes.links import link_out, note_links

MAX_JSON_BYTES = 64 * 2**20
MAX_NAME_BYTES, MAX_PATH_BYTES = 240, 1000
"""Of a file and of a path inside the folder; file systems take 255 and 4096, and suffixes are tried."""
ROOT = PurePosixPath()
"""The capture's own folder, seen from there."""
RIGID_TOLERANCE = 1e-3
MAX_COORDINATE = 1e9
"""Of a camera's position: coordinates of maps, in any unit, have up to eight digits before the point."""
_DRIVE = re.compile(r"[A-Za-z]:")
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Multiplied from the right: from camera axes x right, y down, z forward to x right, y up, z backward."""


def read_json_object(folder: Path, name: str, problems: Problems) -> dict[str, Any] | None:
    """Return the object in the JSON file `name` of `folder`, or None after noting why it cannot be had."""
    path = folder / name
    if link_out(folder, PurePosixPath(name)) is not None:
        note_links([path], folder, problems, needed=True)
        return None
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
        value = json.loads(decoded(path.read_bytes()), object_pairs_hook=lambda pairs: _object(pairs, twice))
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


def decoded(data: bytes) -> str:
    """Return the text of a file; see `text_encoding`. Raises `UnicodeDecodeError`."""
    return data.decode(text_encoding(data))


def text_encoding(start: bytes) -> str:
    """Return how a text that begins like this is encoded: UTF-8, or what its byte order mark says.

    Editors on Windows write a mark before UTF-8, and shells there UTF-16.
    """
    marks = {
        codecs.BOM_UTF32_LE: "utf-32",  # begins like the mark of UTF-16
        codecs.BOM_UTF32_BE: "utf-32",
        codecs.BOM_UTF16_LE: "utf-16",
        codecs.BOM_UTF16_BE: "utf-16",
    }
    return next((name for mark, name in marks.items() if start.startswith(mark)), "utf-8-sig")


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
    finite = [number for number in numbers if number is not None]
    return finite if len(finite) == count else None


def inside_folder(
    path: str, subject: str, problems: Problems, at: PurePosixPath = ROOT
) -> PurePosixPath | None:
    """Return the path below the scene folder that `path` names, seen from the folder `at` inside of it.

    Backslashes are those of Windows. None after noting in `problems` that it leads out of the scene folder.
    """
    clean = None
    given = path.replace("\\", "/")
    if "\0" not in given and _can_be_a_file_name(given) and not given.startswith("/"):
        clean = _normal(at, given)
    if clean is None or _DRIVE.match(given):
        problems.error(
            "scene.path_unsafe",
            f'{subject}: path "{path[:200]}" leaves the scene folder or is not a file name; use a path from '
            "the folder of this file on, for example images/0001.jpg",
            subject,
        )
        return None
    return clean


def _normal(at: PurePosixPath, path: str) -> PurePosixPath | None:
    """Return `path` seen from `at` without `.` and `..`, or None where it leads out or nowhere."""
    parts = list(at.parts)
    for part in PurePosixPath(path).parts:
        if part == "..":
            if not parts:
                return None
            parts.pop()
        elif part != ".":
            parts.append(part)
    return PurePosixPath(*parts) if parts != list(at.parts) else None


def _can_be_a_file_name(path: str) -> bool:
    try:
        parts = [len(part.encode("utf-8")) for part in path.split("/")]
    except UnicodeEncodeError:
        return False
    return max(parts) <= MAX_NAME_BYTES and sum(parts) + len(parts) <= MAX_PATH_BYTES


def focal_from_angle(
    angle: object, width: float, subject: str, problems: Problems, direction: str = "horizontal"
) -> float | None:
    """Return the focal length in pixels of a field of view in radians, or None if it has none.

    `width` is the size of the picture in pixels in the `direction` of the field of view.
    """
    radians = finite_number(angle)
    if radians is None or not 0.0 < radians < math.pi:
        problems.error(
            "scene.camera_angle_invalid",
            f"{subject}: the {direction} field of view must lie between 0 and pi radians, "
            f"found {_short(angle)}",
            subject,
        )
        return None
    return 0.5 * width / math.tan(0.5 * radians)


def pose_from_numbers(value: object, subject: str, problems: Problems) -> Pose64 | None:
    """Return a camera-to-world matrix from 4 x 4 or 3 x 4 numbers, or None after noting what is wrong.

    The rotation part is cleaned of rounding by projecting it on the nearest rotation.
    """
    try:
        matrix = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape in ((3, 4), (12,)):
        matrix = np.vstack([matrix.reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
    if matrix.shape not in ((4, 4), (16,)):
        problems.error(
            "scene.camera_invalid",
            f"{subject}: the camera-to-world matrix must have 4 x 4 or 3 x 4 numbers, found {_short(value)}",
            subject,
        )
        return None
    matrix = _normalized(matrix.reshape(4, 4))
    largest = np.abs(matrix).max() if np.isfinite(matrix).all() else np.inf
    if largest > MAX_COORDINATE or np.abs(matrix[:3, :3]).max() > 1e6:
        problems.error(
            "scene.camera_not_finite",
            f"{subject}: the camera-to-world matrix holds NaN, infinity or a number above "
            f"{MAX_COORDINATE:g}; leave the frame out or solve its pose again",
            subject,
        )
        return None
    return _rigid(matrix, subject, problems)


def _normalized(matrix: Pose64) -> Pose64:
    """Return a matrix of homogeneous coordinates with 1 at its end: some programs scale all of it."""
    end = matrix[3, 3]
    is_scaled = np.isfinite(matrix).all() and not matrix[3, :3].any() and 1e-9 < end < 1e9
    return matrix / end if is_scaled and end != 1.0 else matrix


def pose_from_world_to_camera(value: object, subject: str, problems: Problems) -> Pose64 | None:
    """Return the camera-to-world matrix with our camera axes of a world-to-camera matrix with OpenCV's.

    `value` has 3 x 4 or 4 x 4 numbers; OpenCV's axes are x right, y down, z forward. None after noting in
    `problems` what is wrong.
    """
    pose = pose_from_numbers(value, subject, problems)
    return None if pose is None else np.linalg.inv(pose) @ OPENGL_FROM_OPENCV


def _rigid(matrix: Pose64, subject: str, problems: Problems) -> Pose64 | None:
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
