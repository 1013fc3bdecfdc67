"""Reads the files of a COLMAP sparse model, text and binary: cameras and registered images.

Formats: https://colmap.github.io/format.html. The points are not needed.
"""

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TextIO

from lambent_capture.scenes.reading import text_encoding

UNDISTORT = "run colmap image_undistorter and give its result"
"""What to do about a camera that is not a pinhole."""
MAX_ENTRIES = 100_000
MAX_NAME_BYTES = 4096


@dataclass(frozen=True, kw_only=True, slots=True)
class ColmapCamera:
    """A lens: model name and parameters as COLMAP orders them."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class ColmapImage:
    """A registered photograph: world-to-camera rotation (w, x, y, z) and translation, OpenCV axes."""

    name: str
    camera: int
    rotation: tuple[float, ...]
    translation: tuple[float, ...]
    number: int
    """By which points name it."""

    @property
    def position(self) -> tuple[float, float, float]:
        """Return where the camera stands, in the model's world."""
        w, x, y, z = (value / math.hypot(*self.rotation) for value in self.rotation)
        a, b, c = self.translation
        return (
            -((1.0 - 2.0 * (y * y + z * z)) * a + 2.0 * (x * y + w * z) * b + 2.0 * (x * z - w * y) * c),
            -(2.0 * (x * y - w * z) * a + (1.0 - 2.0 * (x * x + z * z)) * b + 2.0 * (y * z + w * x) * c),
            -(2.0 * (x * z + w * y) * a + 2.0 * (y * z - w * x) * b + (1.0 - 2.0 * (x * x + y * y)) * c),
        )


class ModelError(Exception):
    """A file of the model cannot be understood; the text says why, `code` and `advice` what to do."""

    def __init__(
        self,
        reason: str,
        code: str = "scene.metadata_unreadable",
        advice: str = "export the model again",
    ) -> None:
        super().__init__(reason)
        self.code, self.advice = code, advice


# Name and number of parameters, by the number that stands for the model in binary files.
MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4),
    13: ("DIVISION", 5),
    14: ("SIMPLE_FISHEYE", 3),
    15: ("FISHEYE", 4),
    16: ("EUCM", 6),
    17: ("EQUIRECTANGULAR", 2),
}
_COUNTS = dict(MODELS.values())


def read_cameras(path: Path) -> dict[int, ColmapCamera]:
    """Return the cameras in cameras.txt or cameras.bin by their number; raises `ModelError`."""
    return _cameras_from_text(path) if path.suffix == ".txt" else _cameras_from_binary(path)


def read_images(path: Path) -> list[ColmapImage]:
    """Return the registered images in images.txt or images.bin; raises `ModelError`."""
    return _images_from_text(path) if path.suffix == ".txt" else _images_from_binary(path)


def _checked(number: int, camera: ColmapCamera) -> ColmapCamera:
    wanted = _COUNTS.get(camera.model)
    if wanted is not None and len(camera.parameters) != wanted:
        raise ModelError(
            f"camera {number} ({camera.model}) has {len(camera.parameters)} parameters, {wanted} are needed"
        )
    if camera.width < 1 or camera.height < 1:
        raise ModelError(f"camera {number} has a picture of {camera.width} x {camera.height} pixels")
    return camera


def _cameras_from_text(path: Path) -> dict[int, ColmapCamera]:
    cameras: dict[int, ColmapCamera] = {}
    stated = None
    for line_number, line in _lines(path):
        if line.startswith("#"):
            stated = _stated_count(line, "Number of cameras:", stated)
            continue
        if not line:
            continue
        words = line.split()
        try:
            number = int(words[0])
            camera = ColmapCamera(
                model=words[1],
                width=int(words[2]),
                height=int(words[3]),
                parameters=tuple(float(word) for word in words[4:]),
            )
        except (ValueError, IndexError) as error:
            raise ModelError(
                f"line {line_number} is not a camera (number, model, width, height, ...)"
            ) from error
        if number in cameras:
            raise ModelError(f"line {line_number} describes camera {number} again")
        cameras[number] = _checked(number, camera)
    _compare_count(stated, len(cameras), "cameras")
    return cameras


def _images_from_text(path: Path) -> list[ColmapImage]:
    images: list[ColmapImage] = []
    stated = None
    points_follow = False
    for line_number, line in _lines(path):
        if points_follow:
            points_follow = False
            continue
        if line.startswith("#"):
            stated = _stated_count(line, "Number of images:", stated)
            continue
        if not line:
            continue
        words = line.split(maxsplit=9)
        try:
            numbers = [float(word) for word in words[1:8]]
            rotation, translation = tuple(numbers[:4]), tuple(numbers[4:])
            images.append(ColmapImage(words[9].strip(), int(words[8]), rotation, translation, int(words[0])))
        except (ValueError, IndexError) as error:
            raise ModelError(
                f"line {line_number} is not an image (number, 4 of rotation, 3 of translation, camera, "
                "name); every image takes two lines, the second of which may be empty"
            ) from error
        if len(images) > MAX_ENTRIES:
            raise ModelError(f"has more than {MAX_ENTRIES} images")
        points_follow = True
    _compare_count(stated, len(images), "images")
    return images


def open_text(path: Path, errors: str = "strict") -> TextIO:
    """Return a file of the model that is opened as text, whatever system wrote it."""
    with path.open("rb") as file:
        encoding = text_encoding(file.read(4))
    return path.open(encoding=encoding, errors=errors)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    try:
        with open_text(path) as file:
            for number, line in enumerate(file, start=1):
                yield number, line.strip()
    except UnicodeDecodeError as error:
        raise ModelError("is not text") from error


def _stated_count(line: str, key: str, before: int | None) -> int | None:
    _, announced, rest = line.partition(key)
    digits = rest.split(",")[0].strip()
    return int(digits) if announced and digits.isdigit() and len(digits) < 10 else before


def _compare_count(stated: int | None, count: int, what: str) -> None:
    if stated is not None and stated != count:
        raise ModelError(f"announces {stated} {what} and holds {count}")


def _cameras_from_binary(path: Path) -> dict[int, ColmapCamera]:
    cameras: dict[int, ColmapCamera] = {}
    with path.open("rb") as file:
        for index in range(_entries(file, path, 24, "cameras")):
            number, model, width, height = _unpack(file, "<iiQQ", f"camera {index}")
            if model not in MODELS:
                raise ModelError(
                    f"camera {number} has the unknown model number {model}",
                    "scene.lens_unsupported",
                    UNDISTORT,
                )
            name, count = MODELS[model]
            parameters = _unpack(file, f"<{count}d", f"camera {index}")
            if number in cameras:
                raise ModelError(f"describes camera {number} twice")
            cameras[number] = _checked(
                number, ColmapCamera(model=name, width=width, height=height, parameters=parameters)
            )
        _at_end(file)
    return cameras


def _images_from_binary(path: Path) -> list[ColmapImage]:
    images: list[ColmapImage] = []
    size = path.stat().st_size
    with path.open("rb") as file:
        for index in range(_entries(file, path, 73, "images")):
            what = f"image {index}"
            number, *numbers, camera = _unpack(file, "<i7di", what)
            name = _name(file, what)
            (num_points,) = _unpack(file, "<Q", what)
            if file.tell() + 24 * num_points > size:
                raise ModelError(f'ends in {what} ("{name}"), after {index} whole images')
            file.seek(24 * num_points, 1)
            images.append(ColmapImage(name, camera, tuple(numbers[:4]), tuple(numbers[4:]), number))
        _at_end(file)
    return images


def _entries(file: BinaryIO, path: Path, least_bytes: int, what: str) -> int:
    """Return the number of entries that the file announces, after making sure that it may hold so many."""
    (count,) = _unpack(file, "<Q", "its first number")
    size = path.stat().st_size
    if count > MAX_ENTRIES or 8 + count * least_bytes > size:
        raise ModelError(f"announces {count} {what}, more than {size} bytes can hold")
    return int(count)


def _unpack(file: BinaryIO, layout: str, what: str) -> tuple[Any, ...]:
    data = file.read(struct.calcsize(layout))
    if len(data) < struct.calcsize(layout):
        raise ModelError(f"ends in {what}")
    return struct.unpack(layout, data)


def _name(file: BinaryIO, what: str) -> str:
    data = bytearray()
    while (byte := file.read(1)) != b"\0":
        data += byte
        if not byte or len(data) > MAX_NAME_BYTES:
            raise ModelError(f"has no end of the name of {what}")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ModelError(f"has a name that is not text in {what}") from error


def _at_end(file: BinaryIO) -> None:
    if file.read(1):
        raise ModelError("continues after the entries it announces")
