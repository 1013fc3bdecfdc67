"""Lenses of transforms files: in pixels or by angle, of the file or of a frame.

Every figure has one precedence: that of a frame goes before that of the file. Where one of them gives a
focal length in several ways, `fl_x` goes before `camera_angle_x` (radians), and that before `x_fov`
(degrees); `fl_y`, `camera_angle_y` and `y_fov` likewise, and a matrix `K` where there is none of these.
Where only one of two focal lengths is given, pixels are square. The principal point (`cx`, `cy`) and the
distortion hold however the focal length is given. Pixels are those of a picture of `w` x `h`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lambent_capture.pictures.lens import LensFigures
from lambent_capture.problems import Problems
from lambent_capture.scenes.reading import finite_number, focal_from_angle

AXES = ("x", "y")
_FOCAL = {axis: (f"fl_{axis}", f"camera_angle_{axis}", f"{axis}_fov") for axis in AXES}
FOCAL_KEYS = (*_FOCAL["x"], *_FOCAL["y"])
MATRIX = "K"
"""A lens as three rows of three numbers, as OpenCV and many scripts have it."""
LENS_KEYS = (*FOCAL_KEYS, MATRIX, "cx", "cy", "w", "h")
"""A frame that has one of them has a lens of its own."""

_PERSPECTIVE = (
    "",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "PERSPECTIVE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "FULL_OPENCV",
)
_OTHER_LENSES = {
    "is_fisheye": "fisheye",
    "is_orthographic": "orthographic",
    "latlong": "panorama",
    "equirectangular": "panorama",
    "ftheta_p1": "f-theta",
}
"""Keys of instant-ngp's other lenses."""
_DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


class _FaultyError(Exception):
    """A figure cannot be used; `problems` says why."""


def read_lens(
    shared: Mapping[str, Any],
    own: Mapping[str, Any],
    size: tuple[int, int],
    picture: str,
    subject: str,
    problems: Problems,
) -> LensFigures | None:
    """Return the lens of a picture, for the size that is stated, or None after noting what is wrong.

    `shared` are the settings of the file, `own` those of the frame; the picture has `size` pixels.
    """
    shared, own = _with_matrix(shared), _with_matrix(own)
    distortion = _distortion({**shared, **own}, picture, subject, problems)
    if not any(key in settings for settings in (own, shared) for key in FOCAL_KEYS):
        problems.error(
            "scene.camera_missing", f'{subject} has no lens; add "camera_angle_x" or "fl_x"', subject
        )
        return None
    if distortion is None:
        return None
    try:
        return _Reading(shared, own, size, picture, subject, problems).lens(distortion)
    except _FaultyError:
        return None


def _with_matrix(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return settings with the figures of a lens matrix, where they state no focal length otherwise."""
    rows = settings.get(MATRIX)
    if any(key in settings for key in FOCAL_KEYS) or not isinstance(rows, list):
        return settings
    if [len(row) if isinstance(row, list) else 0 for row in rows] != [3, 3, 3]:
        return settings
    return {"cx": rows[0][2], "cy": rows[1][2], **settings, "fl_x": rows[0][0], "fl_y": rows[1][1]}


@dataclass
class _Reading:
    """The figures of one frame."""

    shared: Mapping[str, Any]
    own: Mapping[str, Any]
    size: tuple[float, float]
    picture: str
    subject: str
    problems: Problems

    def __post_init__(self) -> None:
        self.size = self._stated_size({**self.shared, **self.own}, self.size)
        # What the file says in pixels is of the size that the file states.
        self._shared_size = (
            self.size if not {"w", "h"} & set(self.shared) else self._stated_size(self.shared, self.size)
        )

    def lens(self, distortion: tuple[float, ...]) -> LensFigures:
        focal = self._focal_lengths()
        centre = [self._centre(axis, f"c{name}") for axis, name in enumerate(AXES)]
        return LensFigures(
            width=round(self.size[0]),
            height=round(self.size[1]),
            focal_x=focal[0],
            focal_y=focal[1],
            centre_x=centre[0],
            centre_y=centre[1],
            distortion=distortion,
        )

    def _focal_lengths(self) -> tuple[float, float]:
        own, shared = self.own, self.shared
        from_x = own if _gives(own, 0) else shared
        from_y = shared
        if _gives(own, 1):
            from_y = own
        elif from_x is own and _gives(shared, 0):
            # A frame with one focal length (a zoom) replaces the whole lens of the file.
            from_y = own
        x, y = self._focal(from_x, 0), self._focal(from_y, 1)
        x, y = y if x is None else x, x if y is None else y
        assert x is not None
        assert y is not None
        return x, y

    def _focal(self, settings: Mapping[str, Any], axis: int) -> float | None:
        """Return the focal length along an axis, in pixels of the stated size, or None if not given."""
        pixels, radians, degrees = _FOCAL[AXES[axis]]
        if pixels in settings:
            return self._in_pixels(settings, pixels, axis, positive=True)
        key = radians if radians in settings else degrees
        if key not in settings:
            return None
        angle = finite_number(settings[key])
        if key == degrees and angle is not None:
            angle = math.radians(angle)
        direction = ("horizontal", "vertical")[axis]
        shown = settings[key] if angle is None else angle
        focal = focal_from_angle(shown, self.size[axis], self.subject, self.problems, direction)
        if focal is None:
            raise _FaultyError
        return focal

    def _centre(self, axis: int, key: str) -> float:
        settings = next((each for each in (self.own, self.shared) if key in each), None)
        return 0.5 * self.size[axis] if settings is None else self._in_pixels(settings, key, axis)

    def _in_pixels(
        self, settings: Mapping[str, Any], key: str, axis: int, *, positive: bool = False
    ) -> float:
        number = finite_number(settings[key])
        if number is None or (positive and number <= 0.0):
            self._refuse()
        assert number is not None
        if settings is self.own or self._shared_size == self.size:
            return number
        self._require_same_shape()
        return number * self.size[axis] / self._shared_size[axis]

    def _require_same_shape(self) -> None:
        (width, height), (file_width, file_height) = self.size, self._shared_size
        if abs(width * file_height - height * file_width) > max(width, file_width, height, file_height):
            self.problems.error(
                "scene.image_size",
                f"{self.subject} is stated to have {width:g} x {height:g} pixels, and takes a figure of its "
                f"lens from the file, which states {file_width:g} x {file_height:g}; give the frame a lens "
                "of its own",
                self.picture,
            )
            raise _FaultyError

    def _stated_size(self, settings: Mapping[str, Any], default: tuple[float, float]) -> tuple[float, float]:
        """Return the width and height that `settings` state; where one is missing, pixels stay square."""
        stated = [finite_number(settings[key]) if key in settings else 0.0 for key in ("w", "h")]
        if any(
            value is None or (value < 1.0 and key in settings)
            for key, value in zip("wh", stated, strict=True)
        ):
            self._refuse()
        width, height = (value or 0.0 for value in stated)
        if not width and not height:
            return default
        return (
            width or height * default[0] / default[1],
            height or width * default[1] / default[0],
        )

    def _refuse(self) -> None:
        self.problems.error(
            "scene.lens_invalid",
            f"{self.subject}: w, h, fl_x, fl_y must be positive numbers and cx, cy finite ones, in pixels",
            self.subject,
        )
        raise _FaultyError


def _gives(settings: Mapping[str, Any], axis: int) -> bool:
    """Return whether `settings` have a focal length along an axis."""
    return any(key in settings for key in _FOCAL[AXES[axis]])


def _distortion(
    settings: Mapping[str, Any], picture: str, subject: str, problems: Problems
) -> tuple[float, ...] | None:
    """Return the coefficients in OpenCV's order, or None after noting a lens that is not understood."""
    model = str(settings.get("camera_model", "")).upper()
    other = next((name for key, name in _OTHER_LENSES.items() if settings.get(key)), None)
    if model not in _PERSPECTIVE or other is not None:
        problems.error(
            "scene.lens_unsupported",
            f"{subject} has the camera model {model[:40] if model not in _PERSPECTIVE else other}, which "
            "no pinhole can stand in for; undistort the photographs to a pinhole with the program that "
            "solved them",
            picture,
        )
        return None
    values = [finite_number(settings.get(key, 0.0)) for key in _DISTORTION]
    numbers = [value for value in values if value is not None]
    if len(numbers) < len(_DISTORTION):
        bad = next(key for key, value in zip(_DISTORTION, values, strict=True) if value is None)
        problems.error(
            "scene.lens_invalid",
            f"{subject}: the distortion coefficient {bad} is not a finite number; write 0 where there is "
            "none",
            subject,
        )
        return None
    if any(numbers[5:]) and model != "FULL_OPENCV":
        problems.error(
            "scene.lens_unsupported",
            f"{subject} has k4, k5 or k6 without the camera model FULL_OPENCV; programs mean different "
            "things by them, so name the model or undistort the photographs",
            picture,
        )
        return None
    return tuple(numbers)
