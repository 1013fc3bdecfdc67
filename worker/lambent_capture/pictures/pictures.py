"""The one reading of picture files: header first, then pixels, with a limit on how many there may be.

Check, cameras, masks, training and textures all take `read_picture`, so that none of them can see another
picture than the others. Rows and columns are those of the file, for the programs that solve cameras ignore
the EXIF orientation too; only a picture that is stored as its mirror image is mirrored back.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import imagecodecs
import numpy as np
from jaxtyping import UInt8
from lambent_core.layouts import RAW_SUFFIXES
from numpy import ndarray
from PIL import Image

from lambent_capture.arrays import Grey8, Levels, Plane
from lambent_capture.pictures.colour_space import LINEAR, SRGB, cmyk_as_rgb, of_profile
from lambent_capture.pictures.exr_pictures import MAX_EXR_PIXELS, exr_has_alpha, exr_pixels, exr_size
from lambent_capture.pictures.float_pictures import hdr_pixels, hdr_size
from lambent_capture.pictures.picture import Picture, turned, undoing
from lambent_capture.pictures.picture_bytes import description_of_bytes, format_of_bytes
from lambent_capture.pictures.picture_error import PictureError, first_bytes, reason_of, undecodable
from lambent_capture.pictures.picture_statements import MIRRORED, orientation_of, stated_space
from lambent_capture.pictures.png_header import PngHeader, png_header
from lambent_capture.pictures.raw_pictures import raw_picture_size, raw_pixels
from lambent_capture.pictures.resample import reduced_size
from lambent_capture.pictures.tiff_pictures import (
    deep_tiff_has_alpha,
    deep_tiff_pixels,
    is_deep_tiff,
    tiff_size,
)

MAX_PIXELS = 64 * 2**20
"""Pixels a single picture may have: 8192 x 8192."""

HEIF_SUFFIXES = (".heic", ".heif")
TIFF_SUFFIXES = (".tif", ".tiff")
PILLOW_FORMATS = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".webp": "WEBP",
    ".avif": "AVIF",
    **dict.fromkeys(TIFF_SUFFIXES, "TIFF"),
    **dict.fromkeys(HEIF_SUFFIXES, "HEIF"),
}
EXR_SUFFIX, HDR_SUFFIX = ".exr", ".hdr"
LINEAR_SUFFIXES = (EXR_SUFFIX, HDR_SUFFIX, *RAW_SUFFIXES)
PICTURE_SUFFIXES = (*PILLOW_FORMATS, *LINEAR_SUFFIXES)
_BOX = Image.Resampling.BOX


def encoding_of(path: str) -> str:
    """Return the encoding of a picture's colours, as in `Image.encoding`."""
    return "linear" if path.lower().endswith(LINEAR_SUFFIXES) else "srgb"


def picture_size(path: Path) -> tuple[int, int]:
    """Return width and height in pixels from the header of the file, without decoding it.

    Raises `PictureError` for a missing file, one that holds no picture, or more than `MAX_PIXELS` pixels.
    """
    suffix, limit = path.suffix.lower(), MAX_PIXELS
    if suffix in LINEAR_SUFFIXES:
        size_of = {EXR_SUFFIX: exr_size, HDR_SUFFIX: hdr_size}.get(suffix, raw_picture_size)
        width, height = size_of(path)
        limit = MAX_EXR_PIXELS
    elif picture_format(path) == "TIFF":
        width, height = tiff_size(path)
    else:
        with opened(path) as image:
            width, height = image.size
    if width * height > limit:
        raise PictureError(
            "scene.image_too_large",
            f"has {width} x {height} pixels; the limit is {limit} pixels, so reduce it",
        )
    if not width or not height:
        raise PictureError("scene.image_broken", "has no pixels; export it again")
    return width, height


def read_picture(path: Path, *, side: int | None = None) -> Picture:
    """Return a decoded picture; with `side`, one whose longer side has about that many pixels, at most.

    Raises `PictureError` as `picture_size` does, for files that end too early or hold broken data, and for
    colours that cannot be brought to linear Rec. 709.
    """
    suffix = path.suffix.lower()
    size = picture_size(path)
    if suffix == EXR_SUFFIX:
        levels, alpha, space, doubt = exr_pixels(path)
        picture = Picture(levels=levels, alpha=alpha, space=space, colour_doubt=doubt)
    elif suffix == HDR_SUFFIX:
        picture = Picture(levels=hdr_pixels(path), alpha=None, space=LINEAR)
    elif suffix in RAW_SUFFIXES:
        picture = Picture(levels=raw_pixels(path), alpha=None, space=LINEAR)
    else:
        picture = _encoded_picture(path, size if side is None else reduced_size(*size, side))
    return picture if side is None else picture.resized(reduced_size(*size, side))


def read_levels(path: Path) -> Levels:
    """Return the numbers of a picture that holds no colours (normals, materials), alpha as its last channel.

    8- or 16-bit integers or float32, as they are stored. Raises `PictureError` as `read_picture` does.
    """
    picture = read_picture(path)
    if picture.alpha is None:
        return picture.levels
    return np.concatenate([picture.levels, picture.alpha[..., None].astype(picture.levels.dtype)], axis=-1)


@dataclass(frozen=True, slots=True)
class PictureFacts:
    """Facts about the pixels of a picture for a check."""

    is_finite: bool
    is_empty: bool
    """Nothing but transparent pixels."""
    has_background: bool
    """At least one pixel is transparent."""
    colour_doubt: str = ""
    """As in `Picture.colour_doubt`."""


def picture_facts(path: Path) -> PictureFacts:
    """Return facts about a picture after decoding all of it. Raises `PictureError` as `read_picture` does."""
    picture = read_picture(path)
    low, high = 1.0, 1.0
    if picture.alpha is not None:
        full = 1.0 if picture.alpha.dtype.kind == "f" else float(np.iinfo(picture.alpha.dtype).max)
        low, high = float(picture.alpha.min()) / full, float(picture.alpha.max()) / full
    return PictureFacts(
        is_finite=not picture.is_linear or bool(np.isfinite(picture.levels).all()),
        is_empty=high <= 0.0,
        has_background=low < 1.0,
        colour_doubt=picture.colour_doubt,
    )


def has_alpha(path: Path) -> bool:
    """Return whether a picture states transparency, from its header.

    Raises `PictureError` as `picture_size` does.
    """
    suffix = path.suffix.lower()
    if suffix in LINEAR_SUFFIXES:
        return suffix == EXR_SUFFIX and exr_has_alpha(path)
    if picture_format(path) == "TIFF" and is_deep_tiff(path):
        return deep_tiff_has_alpha(path)
    with opened(path) as image:
        return image.has_transparency_data


def picture_format(path: Path) -> str:
    """Return what an encoded picture is by its first bytes (`PILLOW_FORMATS`), whatever its suffix says.

    Programs that copy photographs from telephones name HEIC files .jpg. Raises `PictureError` for anything
    else.
    """
    start, suffix = first_bytes(path, 32), path.suffix.lower()
    if suffix not in PILLOW_FORMATS:
        raise PictureError(
            "scene.image_format",
            f"has the unsupported suffix {suffix!r}; use JPEG, HEIC, PNG, WebP, AVIF, TIFF, EXR, HDR or a "
            f"camera's raw format",
        )
    known = format_of_bytes(start)
    if known is None:
        raise PictureError(
            "scene.image_not_a_picture",
            f"is not a {PILLOW_FORMATS[suffix]} picture ({description_of_bytes(start)}); export or copy it "
            f"again",
        )
    return known


def opened(path: Path) -> Image.Image:
    """Return an encoded picture with its header read; raises `PictureError` where that cannot be done."""
    known = picture_format(path)
    if known == "HEIF":
        _learn_heif()
    try:
        with _only_bombs_are_errors():
            image = Image.open(path, formats=[known])
        if known == "TIFF":
            # Without a name Pillow maps no file, which garbles rows where an orientation turns the picture.
            image.filename = ""
        return image
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise PictureError(
            "scene.image_too_large", f"has too many pixels; the limit is {MAX_PIXELS}, so reduce it"
        ) from error
    except Exception as error:
        raise PictureError(
            "scene.image_not_a_picture",
            f"is not a {known} picture ({reason_of(error)}); export or copy it again",
        ) from error


def decode(image: Image.Image) -> None:
    """Decode a picture whose header was read; raises `PictureError` for broken data or another size."""
    size = image.size
    try:
        with _only_bombs_are_errors():
            image.load()
    except Exception as error:
        raise undecodable(error) from error
    if image.size != size:
        raise PictureError(
            "scene.image_broken",
            f"has {image.width} x {image.height} pixels, and its header says {size[0]} x {size[1]}; export "
            "or copy it again",
        )


def _encoded_picture(path: Path, size: tuple[int, int]) -> Picture:
    """Return a picture of 8 or 16 bits with the space that the file states; no smaller than `size`."""
    known = picture_format(path)
    if known == "TIFF" and is_deep_tiff(path):
        levels, alpha, profile = deep_tiff_pixels(path)
        if levels.dtype.kind == "f" and not profile:
            return Picture(levels=levels, alpha=alpha, space=LINEAR)
        space, doubt = of_profile(profile, levels.shape[-1]) if profile else (SRGB, "")
        return Picture(levels=levels, alpha=alpha, space=space, colour_doubt=doubt)
    with opened(path) as image:
        png = _png_header(path, image) if known == "PNG" else None
        orientation = 1
        if png is not None and png.bit_depth == 16:
            levels, alpha = _sixteen_bit(path, png)
        else:
            if known == "JPEG" and size != image.size:
                # A JPEG is decoded at a half, a quarter or an eighth where that is enough.
                image.draft(None, size)
            # Pillow turns TIFF, and nothing else, by the orientation that the file states.
            orientation = orientation_of(image) if known == "TIFF" else 1
            decode(image)
            turned_size = size if orientation < 5 else size[::-1]
            levels, alpha = _eight_bit(image, png, turned_size)
            levels = turned(levels, undoing(orientation))
            alpha = None if alpha is None else turned(alpha, undoing(orientation))
        # After the pixels: PNG may have its EXIF there.
        space, doubt = stated_space(path, known, image, png, levels.shape[-1])
        # PNG may have its EXIF after the pixels.
        mirrored = (orientation if orientation > 1 else orientation_of(image)) in MIRRORED
    picture = Picture(levels=levels, alpha=alpha, space=space, colour_doubt=doubt)
    return picture.mirrored() if mirrored else picture


def _eight_bit(
    image: Image.Image, png: PngHeader | None, size: tuple[int, int]
) -> tuple[UInt8[ndarray, "height width channels"], Grey8 | None]:
    """Return 8-bit levels, one or three channels, and alpha of a decoded picture, reduced to `size`.

    Not where a level is a key: those are told apart before anything is averaged.
    """
    if image.mode == "CMYK":
        return np.asarray(cmyk_as_rgb(image)), None
    if image.mode in ("LAB", "HSV", "I", "F") or image.mode.startswith("I;"):
        raise PictureError(
            "scene.image_format",
            f"stores pixels as {image.mode}, which photographs are not read from; export it as RGB",
        )
    key = png.key if png is not None else ()
    if key:
        plain = np.asarray(image.convert("L" if len(key) == 1 else "RGB"))
        plain = plain.reshape(*plain.shape[:2], -1)
        # Grey of 1, 2 or 4 bits is spread over 0..255, and so is the key.
        scaled = np.array(key) * (255 // (2**png.bit_depth - 1) if png is not None else 1)
        return plain, np.where((plain == scaled).all(axis=-1), np.uint8(0), np.uint8(255))
    mode = image.mode
    if mode not in ("L", "LA", "RGB", "RGBA"):
        usual = "RGBA" if image.has_transparency_data else "RGB"
        mode = {"1": "L", "La": "LA", "RGBa": "RGBA"}.get(mode, usual)
    converted = image if mode == image.mode else image.convert(mode)
    # Here, and not once the pixels are an array: a large picture would be in memory twice.
    pixels = np.asarray(
        converted if converted.size == size else converted.resize(size, _BOX, reducing_gap=2.0)
    )
    if mode == "L":
        return pixels[..., None], None
    if mode == "RGB":
        return pixels, None
    return np.ascontiguousarray(pixels[..., :-1]), np.ascontiguousarray(pixels[..., -1])


def _sixteen_bit(path: Path, png: PngHeader) -> tuple[Levels, Plane | None]:
    """Return levels and alpha of a PNG with 16 bits, which Pillow would cut to 8."""
    try:
        pixels = np.asarray(imagecodecs.png_decode(path.read_bytes()))
    except Exception as error:
        raise undecodable(error) from error
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    colours = 1 if png.colour_type in (0, 4) else 3
    alpha = np.ascontiguousarray(pixels[..., colours]) if pixels.shape[-1] > colours else None
    return np.ascontiguousarray(pixels[..., :colours]), alpha


def _png_header(path: Path, image: Image.Image) -> PngHeader:
    try:
        return png_header(path)
    except ValueError as error:
        raise undecodable(error) from error


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
