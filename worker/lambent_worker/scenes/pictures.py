"""Opens picture files: header first, then pixels, with a limit on how many there may be."""

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Shaped
from numpy import ndarray
from PIL import Image

MAX_PIXELS = 64 * 2**20
"""Pixels a single picture may have: 8192 x 8192."""

MAX_EXR_PIXELS = 16 * 2**20
"""The same for EXR, whose pixels are up to four times as large in memory."""

PILLOW_FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP"}
PICTURE_SUFFIXES = (*PILLOW_FORMATS, ".exr")


class PictureError(Exception):
    """A picture cannot be used; `code` is stable, the text says why."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code


def picture_size(path: Path) -> tuple[int, int]:
    """Return width and height in pixels from the header of the file, without decoding it.

    Raises `PictureError` for a missing file, something that is no picture, or more than `MAX_PIXELS` pixels.
    """
    if path.suffix.lower() == ".exr":
        width, height = _exr_size(path)
        limit = MAX_EXR_PIXELS
    else:
        with _opened(path) as image:
            width, height = image.size
        limit = MAX_PIXELS
    if width * height > limit:
        raise PictureError(
            "scene.image_too_large",
            f"has {width} x {height} pixels; the limit is {limit} pixels, so reduce it",
        )
    if not width or not height:
        raise PictureError("scene.image_broken", "has no pixels; export it again")
    return width, height


@dataclass(frozen=True, slots=True)
class PictureFacts:
    """What a check needs to know about the pixels of a picture."""

    is_finite: bool
    is_empty: bool
    """Nothing but transparent pixels."""
    has_background: bool
    """At least one pixel is transparent."""


def picture_facts(path: Path) -> PictureFacts:
    """Return facts about a picture after decoding all of it, in as little memory as that takes.

    Raises `PictureError` as `read_pixels` does.
    """
    if path.suffix.lower() == ".exr":
        pixels = read_pixels(path)
        alpha = pixels[..., 3] if pixels.shape[-1] == 4 else np.ones(1)
        return PictureFacts(
            is_finite=bool(np.isfinite(pixels).all()),
            is_empty=bool(alpha.max() <= 0.0),
            has_background=bool(alpha.min() < 1.0),
        )
    picture_size(path)
    with _opened(path) as image:
        _decode(image)
        bands = image.getextrema() if len(image.getbands()) > 1 else (image.getextrema(),)
        alpha = dict(zip(image.getbands(), bands, strict=True)).get("A", (255, 255))
    return PictureFacts(is_finite=True, is_empty=alpha[1] == 0, has_background=alpha[0] < 255)


def read_pixels(path: Path) -> Shaped[ndarray, "height width channels"]:
    """Return the pixels of a picture: 8-bit RGB(A) or grey(+alpha) as stored, or float32 for EXR.

    Raises `PictureError` as `picture_size` does, and for files that end too early or hold broken data.
    """
    width, height = picture_size(path)
    if path.suffix.lower() == ".exr":
        return _exr_pixels(path, height, width)
    with _opened(path) as image:
        _decode(image)
        plain = image if image.mode in ("RGB", "RGBA", "L", "LA") else image.convert("RGBA")
        pixels = np.asarray(plain)
    return pixels[..., None] if pixels.ndim == 2 else pixels


def read_coverage(path: Path) -> Float32[ndarray, "height width"]:
    """Return how much of each pixel the object covers, from 0 to 1, as a mask file says it.

    That is the grey level, or the alpha where any pixel of the file is transparent. Raises `PictureError` as
    `read_pixels` does.
    """
    pixels = read_pixels(path)
    scale = np.float32(1.0 / 255.0 if pixels.dtype == np.uint8 else 1.0)
    opaque = 255 if pixels.dtype == np.uint8 else 1.0
    channels = pixels.shape[-1]
    if channels in (2, 4) and (pixels[..., -1] < opaque).any():
        return pixels[..., -1].astype(np.float32) * scale
    grey = pixels[..., : 3 if channels >= 3 else 1].astype(np.float32).mean(axis=-1)
    return np.clip(grey * scale, 0.0, 1.0)


def _opened(path: Path) -> Image.Image:
    if not path.is_file():
        raise PictureError("scene.file_missing", "does not exist; add it or remove the frame")
    suffix = path.suffix.lower()
    if suffix not in PILLOW_FORMATS:
        raise PictureError(
            "scene.image_format", f"has the unsupported suffix {suffix!r}; use PNG, JPEG, WebP or EXR"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return Image.open(path, formats=[PILLOW_FORMATS[suffix]])
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise PictureError(
            "scene.image_too_large", f"has too many pixels; the limit is {MAX_PIXELS}, so reduce it"
        ) from error
    except Exception as error:
        raise PictureError(
            "scene.image_not_a_picture",
            f"is not a {PILLOW_FORMATS[suffix]} picture ({_reason(error)}); export or copy it again",
        ) from error


def _decode(image: Image.Image) -> None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            image.load()
    except Exception as error:  # Pillow's decoders raise many kinds; each means the same to the owner
        raise PictureError(
            "scene.image_broken", f"cannot be decoded ({_reason(error)}); export or copy it again"
        ) from error


def _exr_size(path: Path) -> tuple[int, int]:
    """Read the data window from the attributes at the start of an EXR file, without its library.

    The library allocates what the header asks for, and a file of a few hundred bytes can ask for gigabytes.
    """
    if not path.is_file():
        raise PictureError("scene.file_missing", "does not exist; add it or remove the frame")
    with path.open("rb") as file:
        head = file.read(65536)
    if head[:4] != b"\x76\x2f\x31\x01":
        raise PictureError("scene.image_not_a_picture", "is not an EXR picture; export or copy it again")
    at = head.find(b"dataWindow\0box2i\0\x10\0\0\0")
    window = head[at + 21 : at + 37]
    if at < 0 or len(window) < 16:
        raise PictureError("scene.image_broken", "has no data window in its header; export it again")
    x0, y0, x1, y1 = (int(v) for v in np.frombuffer(window, dtype="<i4"))
    return max(x1 - x0 + 1, 0), max(y1 - y0 + 1, 0)


def _exr_pixels(path: Path, height: int, width: int) -> Float32[ndarray, "height width channels"]:
    import OpenEXR

    try:
        with OpenEXR.File(str(path)) as file:
            channels = (
                {name: channel.pixels for name, channel in file.channels().items()} if file.parts else {}
            )
    except Exception as error:
        raise PictureError(
            "scene.image_broken", f"cannot be decoded ({_reason(error)}); export it again"
        ) from error
    for names in (("RGBA",), ("RGB",), ("R", "G", "B", "A"), ("R", "G", "B"), ("Y",)):
        if set(names) <= set(channels):
            planes = [np.asarray(channels[name], dtype=np.float32) for name in names]
            pixels = np.concatenate([p[..., None] if p.ndim == 2 else p for p in planes], axis=-1)
            if pixels.shape[:2] != (height, width):
                break
            return pixels
    raise PictureError(
        "scene.image_broken",
        f"has channels {sorted(channels)}, expected R, G, B (and A) or Y; export it again",
    )


def _reason(error: Exception) -> str:
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    return text.replace("\\", "/").rsplit("/", maxsplit=1)[-1][:120]
