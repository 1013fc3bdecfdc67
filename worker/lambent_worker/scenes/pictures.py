"""Opens picture files: header first, then pixels, with a limit on how many there may be."""

import importlib
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Shaped
from numpy import ndarray
from PIL import Image

from lambent_worker.scenes.float_pictures import (
    FLOAT_SUFFIXES,
    MAX_FLOAT_PIXELS,
    float_picture_size,
    float_pixels,
)
from lambent_worker.scenes.picture_error import PictureError, reason_of

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
PICTURE_SUFFIXES = (*PILLOW_FORMATS, *FLOAT_SUFFIXES)
NERO_DEPTH = "nero_depth"
"""Encoding of a mask that is a depth picture of Glossy Synthetic: 65535 stands for 15 scene units."""
NERO_BACKGROUND = 14.5
"""Depth from which on nothing was hit, scene units."""


def encoding_of(path: str) -> str:
    """Return the encoding of a picture's colours, as in `Image.encoding`."""
    return "linear" if path.lower().endswith(FLOAT_SUFFIXES) else "srgb"


def picture_size(path: Path) -> tuple[int, int]:
    """Return width and height in pixels from the header of the file, without decoding it.

    Raises `PictureError` for a missing file, something that is no picture, or more than `MAX_PIXELS` pixels.
    """
    if path.suffix.lower() in FLOAT_SUFFIXES:
        width, height = float_picture_size(path)
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


def picture_facts(path: Path) -> PictureFacts:
    """Return facts about a picture after decoding all of it, in as little memory as that takes.

    Raises `PictureError` as `read_pixels` does.
    """
    if path.suffix.lower() in FLOAT_SUFFIXES:
        pixels = read_pixels(path)
        alpha = pixels[..., 3] if pixels.shape[-1] == 4 else np.ones(1)
        return PictureFacts(
            is_finite=bool(np.isfinite(pixels).all()),
            is_empty=bool(alpha.max() <= 0.0),
            has_background=bool(alpha.min() < 1.0),
        )
    picture_size(path)
    with opened(path) as image:
        _decode(image)
        bands = image.getextrema() if len(image.getbands()) > 1 else (image.getextrema(),)
        alpha = dict(zip(image.getbands(), bands, strict=True)).get("A", (255, 255))
    return PictureFacts(is_finite=True, is_empty=alpha[1] == 0, has_background=alpha[0] < 255)


def read_pixels(path: Path) -> Shaped[ndarray, "height width channels"]:
    """Return the pixels of a picture: 8-bit RGB(A) or grey(+alpha), or float32 for EXR and HDR.

    16-bit grey is reduced to 8 bit. Raises `PictureError` as `picture_size` does, and for files that end too
    early or hold broken data.
    """
    if path.suffix.lower() in FLOAT_SUFFIXES:
        picture_size(path)
        return float_pixels(path)
    pixels = _stored_pixels(path)
    return (pixels >> 8).astype(np.uint8) if pixels.dtype == np.uint16 else pixels


def has_alpha(path: Path) -> bool:
    """Return whether a picture has a channel for transparency; from the header, but for EXR.

    Raises `PictureError` as `picture_size` does.
    """
    if path.suffix.lower() in FLOAT_SUFFIXES:
        return path.suffix.lower() == ".exr" and read_pixels(path).shape[-1] == 4
    with opened(path) as image:
        return image.has_transparency_data


def read_coverage(path: Path, encoding: str = "") -> Float32[ndarray, "height width"]:
    """Return the object's coverage of each pixel, from 0 to 1, from a mask file.

    That is the grey level, or the alpha where any pixel of the file is transparent; with the encoding
    `NERO_DEPTH` it is 1 where something nearer than the background is. Raises `PictureError` as `read_pixels`
    does.
    """
    if path.suffix.lower() in FLOAT_SUFFIXES:
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


def opened(path: Path) -> Image.Image:
    """Return an 8-bit picture with its header read; raises `PictureError` where that cannot be done."""
    if not path.is_file():
        raise PictureError("scene.file_missing", "does not exist; add it or remove the frame")
    suffix = path.suffix.lower()
    if suffix not in PILLOW_FORMATS:
        raise PictureError(
            "scene.image_format",
            f"has the unsupported suffix {suffix!r}; use PNG, JPEG, WebP, HEIC, EXR or HDR",
        )
    if suffix in HEIF_SUFFIXES:
        _learn_heif()
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
            f"is not a {PILLOW_FORMATS[suffix]} picture ({reason_of(error)}); export or copy it again",
        ) from error


def _learn_heif() -> None:
    try:
        plugin = importlib.import_module("pillow_heif")
    except ImportError as error:
        raise PictureError(
            "scene.heic_unsupported",
            "is a HEIC picture, and pillow-heif, which reads them, is not installed; run pip install "
            "'lambent[heic]' or export the photographs as JPEG",
        ) from error
    plugin.register_heif_opener()


def _stored_pixels(path: Path) -> Shaped[ndarray, "height width channels"]:
    """Return 8-bit pixels, or 16-bit ones where the file is grey with 16 bits."""
    picture_size(path)
    with opened(path) as image:
        _decode(image)
        if image.mode.startswith("I"):
            pixels = np.clip(np.asarray(image), 0, 65535).astype(np.uint16)
        else:
            plain = image if image.mode in ("RGB", "RGBA", "L", "LA") else image.convert("RGBA")
            pixels = np.asarray(plain)
    return pixels[..., None] if pixels.ndim == 2 else pixels


def _decode(image: Image.Image) -> None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            image.load()
    except Exception as error:  # Pillow's decoders raise many kinds; each means the same to the owner
        raise PictureError(
            "scene.image_broken", f"cannot be decoded ({reason_of(error)}); export or copy it again"
        ) from error
