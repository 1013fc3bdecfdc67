"""Opens Radiance HDR photographs: linear, divided by their EXPOSURE."""

import re
from pathlib import Path

import numpy as np

from lambent_capture.arrays import Colours32
from lambent_capture.pictures.exr_pictures import MAX_EXR_PIXELS
from lambent_capture.pictures.picture_error import PictureError, first_bytes

MAX_HDR_PIXELS = MAX_EXR_PIXELS
_RESOLUTION = re.compile(rb"\n\n[-+]([XY]) (\d{1,7}) [-+][XY] (\d{1,7})\n")


def hdr_size(path: Path) -> tuple[int, int]:
    """Return width and height in pixels as the header says, without the code that decodes.

    That allocates what the header requests, and a file of a few hundred bytes can request gigabytes.
    """
    head = first_bytes(path, 65536)
    if not head.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise PictureError("scene.image_not_a_picture", "is not an HDR picture; export or copy it again")
    match = _RESOLUTION.search(head)
    if match is None:
        raise PictureError(
            "scene.image_broken", "has no line -Y <height> +X <width> in its header; export it again"
        )
    first, second = int(match[2]), int(match[3])
    return (second, first) if match[1] == b"Y" else (first, second)


def hdr_pixels(path: Path) -> Colours32:
    """Return linear Rec. 709 colours of an HDR picture. Raises `PictureError`."""
    from lambent_core.errors import EnvironmentFileError
    from lambent_core.rgbe import read_rgbe

    try:
        picture = read_rgbe(path, max_pixels=MAX_HDR_PIXELS)
        return np.ascontiguousarray(picture.rows(slice(0, picture.height)), dtype=np.float32)
    except EnvironmentFileError as error:
        said = error.message.removeprefix(f'"{path.name}" ')
        raise PictureError("scene.image_broken", f"cannot be decoded ({said}); export it again") from error
