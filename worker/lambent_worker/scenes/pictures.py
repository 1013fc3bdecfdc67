"""Opens picture files: header first, then pixels, with a limit on how many there may be."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Shaped, UInt16
from numpy import ndarray
from PIL import Image

from lambent_worker.scenes.colour_profile import in_srgb, profile_fault
from lambent_worker.scenes.float_pictures import (
    FLOAT_SUFFIXES,
    MAX_FLOAT_PIXELS,
    float_picture_size,
    float_pixels,
)
from lambent_worker.scenes.picture_bytes import description_of_bytes, format_of_bytes
from lambent_worker.scenes.picture_error import PictureError, reason_of
from lambent_worker.scenes.raw_pictures import RAW_SUFFIXES, raw_picture_size, raw_pixels

MAX_PIXELS = 64 * 2**20
"""Pixels a single picture may have: 8192 x 8192."""

HEIF_SUFFIXES = (".heic", ".heif")
PILLOW_FORMATS = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".webp": "WEBP",
    **dict.fromkeys(HEIF_SUFFIXES, "HEIF"),
}
LINEAR_SUFFIXES = (*FLOAT_SUFFIXES, *RAW_SUFFIXES)
PICTURE_SUFFIXES = (*PILLOW_FORMATS, *LINEAR_SUFFIXES)
NERO_DEPTH = "nero_depth"
"""Encoding of a mask that is a depth picture of Glossy Synthetic: 65535 stands for 15 scene units."""
NERO_BACKGROUND = 14.5
"""Depth from which on nothing was hit, scene units."""


def encoding_of(path: str) -> str:
    """Return the encoding of a picture's colours, as in `Image.encoding`."""
    return "linear" if path.lower().endswith(LINEAR_SUFFIXES) else "srgb"


def is_linear(path: Path) -> bool:
    """Return whether a file holds linear radiance as floats (EXR, HDR, raw) instead of 8-bit sRGB."""
    return path.suffix.lower() in LINEAR_SUFFIXES


def picture_size(path: Path) -> tuple[int, int]:
    """Return width and height in pixels from the header of the file, without decoding it.

    Raises `PictureError` for a missing file, something that is no picture, or more than `MAX_PIXELS` pixels.
    """
    if is_linear(path):
        is_raw = path.suffix.lower() in RAW_SUFFIXES
        width, height = raw_picture_size(path) if is_raw else float_picture_size(path)
        limit = MAX_FLOAT_PIXELS
    else:
        with opened(path) as image:
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
    """Facts about the pixels of a picture for a check."""

    is_finite: bool
    is_empty: bool
    """Nothing but transparent pixels."""
    has_background: bool
    """At least one pixel is transparent."""
    profile_fault: str = ""
    """Why its colour profile cannot be used."""


def picture_facts(path: Path) -> PictureFacts:
    """Return facts about a picture after decoding all of it, in as little memory as that takes.

    Raises `PictureError` as `read_pixels` does.
    """
    if is_linear(path):
        pixels = read_pixels(path)
        alpha = pixels[..., 3] if pixels.shape[-1] == 4 else np.ones(1)
        return PictureFacts(
            is_finite=bool(np.isfinite(pixels).all()),
            is_empty=bool(alpha.max() <= 0.0),
            has_background=bool(alpha.min() < 1.0),
        )
    picture_size(path)
    with opened(path) as image:
        decode(image)
        bands = image.getextrema() if len(image.getbands()) > 1 else (image.getextrema(),)
        alpha = dict(zip(image.getbands(), bands, strict=True)).get("A", (255, 255))
        fault = profile_fault(image)
    return PictureFacts(
        is_finite=True, is_empty=alpha[1] == 0, has_background=alpha[0] < 255, profile_fault=fault
    )


def read_pixels(path: Path) -> Shaped[ndarray, "height width channels"]:
    """Return the pixels of a photograph: 8-bit sRGB(A) or grey(+alpha), or float32 for EXR, HDR and raw
    files.

    Rows and columns are those of the file: no EXIF orientation is applied. Colours in another profile than
    sRGB are converted, 16-bit grey is reduced to 8 bit. Raises `PictureError` as `picture_size` does, and for
    files that end too early or hold broken data.
    """
    if path.suffix.lower() in RAW_SUFFIXES:
        picture_size(path)
        return raw_pixels(path)
    if path.suffix.lower() in FLOAT_SUFFIXES:
        picture_size(path)
        return float_pixels(path)
    picture_size(path)
    with opened(path) as image:
        decode(image)
        if image.mode.startswith("I"):
            return (_sixteen_bit(image) >> 8).astype(np.uint8)
        pixels = np.asarray(in_srgb(image))
    return pixels[..., None] if pixels.ndim == 2 else pixels


def has_alpha(path: Path) -> bool:
    """Return whether a picture has a channel for transparency; from the header, but for EXR.

    Raises `PictureError` as `picture_size` does.
    """
    if is_linear(path):
        return path.suffix.lower() == ".exr" and read_pixels(path).shape[-1] == 4
    with opened(path) as image:
        return image.has_transparency_data


def read_coverage(path: Path, encoding: str = "") -> Float32[ndarray, "height width"]:
    """Return the object's coverage of each pixel, from 0 to 1, from a mask file.

    That is the grey level, or the alpha where any pixel of the file is transparent; with the encoding
    `NERO_DEPTH` it is 1 where something nearer than the background is. Raises `PictureError` as `read_pixels`
    does. Colour profiles are ignored: the numbers are shares.
    """
    if is_linear(path):
        pixels, full = read_pixels(path), 1.0
    else:
        pixels = _stored_pixels(path)
        full = float(np.iinfo(pixels.dtype).max)
    if encoding == NERO_DEPTH:
        return (pixels[..., 0] * (15.0 / full) < NERO_BACKGROUND).astype(np.float32)
    channels = pixels.shape[-1]
    if channels in (2, 4) and (pixels[..., -1] < full).any():
        grey = pixels[..., -1].astype(np.float32)
    else:
        grey = pixels[..., : 3 if channels >= 3 else 1].mean(axis=-1, dtype=np.float32)
    return np.clip(grey / np.float32(full), 0.0, 1.0)


def picture_format(path: Path) -> str:
    """Return what an 8-bit picture is by its first bytes: JPEG, PNG, WEBP or HEIF, whatever its suffix says.

    Programs that copy photographs from telephones name HEIC files .jpg. Raises `PictureError` for anything
    else.
    """
    if not path.is_file():
        raise PictureError("scene.file_missing", "does not exist; add it or remove the frame")
    suffix = path.suffix.lower()
    if suffix not in PILLOW_FORMATS:
        raise PictureError(
            "scene.image_format",
            f"has the unsupported suffix {suffix!r}; use JPEG, HEIC, PNG, WebP, EXR, HDR or a camera's raw "
            f"format",
        )
    with path.open("rb") as file:
        start = file.read(16)
    known = format_of_bytes(start)
    if known is None:
        raise PictureError(
            "scene.image_not_a_picture",
            f"is not a {PILLOW_FORMATS[suffix]} picture ({description_of_bytes(start)}); export or copy it "
            f"again",
        )
    return known


def opened(path: Path) -> Image.Image:
    """Return an 8-bit picture with its header read; raises `PictureError` where that cannot be done."""
    known = picture_format(path)
    if known == "HEIF":
        _learn_heif()
    try:
        with _only_bombs_are_errors():
            return Image.open(path, formats=[known])
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise PictureError(
            "scene.image_too_large", f"has too many pixels; the limit is {MAX_PIXELS}, so reduce it"
        ) from error
    except Exception as error:
        raise PictureError(
            "scene.image_not_a_picture",
            f"is not a {known} picture ({reason_of(error)}); export or copy it again",
        ) from error


@contextmanager
def _only_bombs_are_errors() -> Iterator[None]:
    """Raise Pillow's warning of too many pixels, and drop those of damaged extras, such as EXIF or a gain
    map."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        yield


def _learn_heif() -> None:
    from pillow_heif import register_heif_opener

    register_heif_opener()


def _stored_pixels(path: Path) -> Shaped[ndarray, "height width channels"]:
    """Return 8-bit pixels as they are stored, or 16-bit ones where the file is grey with 16 bits."""
    picture_size(path)
    with opened(path) as image:
        decode(image)
        if image.mode.startswith("I"):
            return _sixteen_bit(image)
        plain = image if image.mode in ("RGB", "RGBA", "L", "LA") else image.convert("RGBA")
        pixels = np.asarray(plain)
    return pixels[..., None] if pixels.ndim == 2 else pixels


def _sixteen_bit(image: Image.Image) -> UInt16[ndarray, "height width 1"]:
    return np.clip(np.asarray(image), 0, 65535).astype(np.uint16)[..., None]


def decode(image: Image.Image) -> None:
    """Decode a picture whose header was read; raises `PictureError` for broken data or another size."""
    size = image.size
    try:
        with _only_bombs_are_errors():
            image.load()
    except Exception as error:  # Pillow's decoders raise many kinds; each means the same to the owner
        raise PictureError(
            "scene.image_broken", f"cannot be decoded ({reason_of(error)}); export or copy it again"
        ) from error
    if image.size != size:
        raise PictureError(
            "scene.image_broken",
            f"has {image.width} x {image.height} pixels, and its header says {size[0]} x {size[1]}; export "
            "or copy it again",
        )
