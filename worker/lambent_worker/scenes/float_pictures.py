"""Opens pictures that hold linear radiance as floats: OpenEXR and Radiance HDR."""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float32
from numpy import ndarray

from lambent_worker.scenes.picture_error import PictureError

FLOAT_SUFFIXES = (".exr", ".hdr")
MAX_FLOAT_PIXELS = 16 * 2**20
"""Pixels of a single picture: 4096 x 4096; they are up to four times as large in memory as 8-bit ones."""

_RESOLUTION = re.compile(rb"\n\n[-+]Y (\d{1,7}) [-+]X (\d{1,7})\n")


def float_picture_size(path: Path) -> tuple[int, int]:
    """Return width and height in pixels as the header says, without the libraries that decode.

    They allocate what the header requests, and a file of a few hundred bytes can request gigabytes.
    """
    if not path.is_file():
        raise PictureError("scene.file_missing", "does not exist; add it or remove the frame")
    with path.open("rb") as file:
        head = file.read(65536)
    return _exr_size(head) if path.suffix.lower() == ".exr" else _hdr_size(head)


def float_pixels(path: Path) -> Float32[ndarray, "height width channels"]:
    """Return the pixels of an EXR (RGB, RGBA or Y) or HDR (RGB) picture; linear.

    Stored values of an HDR picture are divided by its EXPOSURE, as the format demands.
    """
    from lambent_relight.environment.exr import read_exr_parts
    from lambent_relight.environment.rgbe import read_rgbe
    from lambent_relight.errors import EnvironmentFileError

    width, height = float_picture_size(path)
    try:
        if path.suffix.lower() == ".exr":
            channels = read_exr_parts(path, max_pixels=MAX_FLOAT_PIXELS)[0].channels
        else:
            picture = read_rgbe(path, max_pixels=MAX_FLOAT_PIXELS)
            return np.ascontiguousarray(picture.rows(slice(0, picture.height)), dtype=np.float32)
    except EnvironmentFileError as error:
        said = error.message.removeprefix(f'"{path.name}" ')
        raise PictureError("scene.image_broken", f"cannot be decoded ({said}); export it again") from error
    for names in ("RGBA", "RGB", "Y"):
        planes = [channels[name].pixels for name in names if name in channels]
        if len(planes) == len(names) and all(np.shape(plane) == (height, width) for plane in planes):
            return np.stack(planes, axis=-1).astype(np.float32)
    raise PictureError(
        "scene.image_broken",
        f"has channels {sorted(channels)}, expected R, G, B (and A) or Y; export it again",
    )


def _exr_size(head: bytes) -> tuple[int, int]:
    if head[:4] != b"\x76\x2f\x31\x01":
        raise PictureError("scene.image_not_a_picture", "is not an EXR picture; export or copy it again")
    at = head.find(b"dataWindow\0box2i\0\x10\0\0\0")
    window = head[at + 21 : at + 37]
    if at < 0 or len(window) < 16:
        raise PictureError("scene.image_broken", "has no data window in its header; export it again")
    x0, y0, x1, y1 = (int(v) for v in np.frombuffer(window, dtype="<i4"))
    return max(x1 - x0 + 1, 0), max(y1 - y0 + 1, 0)


def _hdr_size(head: bytes) -> tuple[int, int]:
    if not head.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise PictureError("scene.image_not_a_picture", "is not an HDR picture; export or copy it again")
    match = _RESOLUTION.search(head)
    if match is None:
        raise PictureError(
            "scene.image_broken", "has no line -Y <height> +X <width> in its header; export it again"
        )
    return int(match[2]), int(match[1])
