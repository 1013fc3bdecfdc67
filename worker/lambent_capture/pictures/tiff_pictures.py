"""Opens TIFF photographs with more than 8 bits in a channel; Pillow reads the others."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from lambent_capture.arrays import Levels, Plane
from lambent_capture.pictures.picture_error import PictureError, reason_of, undecodable

_ASSOCIATED = 1
"""ExtraSamples: alpha that colours are multiplied by. Source: TIFF 6.0, section 18."""
_GREY, _COLOURS = (0, 1), (2,)
"""PhotometricInterpretation; 0 is grey where 0 is white."""
_ORIENTATION, _MIRRORED = 274, (2, 4, 5, 7)
_RAW_KINDS, _DNG_VERSION = (32803, 34892), 50706


def tiff_size(path: Path) -> tuple[int, int]:
    """Return width and height of the stored pixels; raises `PictureError` for a file that cannot be read."""
    page = _page(path)
    return page.imagewidth, page.imagelength


def is_deep_tiff(path: Path) -> bool:
    """Return whether a channel has 16 or 32 bits. Raises `PictureError` as `tiff_size` does."""
    bits: Any = _page(path).bitspersample
    return max(bits if isinstance(bits, tuple) else (bits,)) > 8


def deep_tiff_has_alpha(path: Path) -> bool:
    """Return whether a fourth channel, or a second one beside grey, is alpha."""
    return bool(_page(path).extrasamples)


def deep_tiff_pixels(path: Path) -> tuple[Levels, Plane | None, bytes]:
    """Return levels (uint16 or float32; one or three channels), straight alpha, and the ICC profile or b"".

    Colours that are multiplied by alpha are divided by it. Raises `PictureError`.
    """
    page = _page(path)
    kind = np.dtype(page.dtype) if page.dtype is not None else np.dtype(object)
    if page.photometric not in (*_GREY, *_COLOURS) or kind not in (np.uint16, np.float16, np.float32):
        raise PictureError(
            "scene.image_format",
            f"is a TIFF with {kind.name} pixels of kind {page.photometric}, which are not read; export it "
            "as RGB with 8 or 16 bits",
        )
    try:
        with tifffile.TiffFile(path) as file:
            pixels = file.pages[0].asarray()
    except Exception as error:  # decoders of many compressions raise many kinds
        raise undecodable(error) from error
    if page.planarconfig == 2 and pixels.ndim == 3:
        pixels = np.moveaxis(pixels, 0, -1)
    pixels = pixels.astype(np.float32) if kind.kind == "f" else pixels
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    colours = 1 if page.photometric in _GREY else 3
    if pixels.shape != (page.imagelength, page.imagewidth, pixels.shape[-1]) or pixels.shape[-1] < colours:
        raise PictureError("scene.image_broken", "has pixels of an unexpected shape; export it again")
    if page.tags.valueof(_ORIENTATION) in _MIRRORED:
        pixels = pixels[:, ::-1]
    levels = pixels[..., :colours]
    if page.photometric == 0:
        levels = (1.0 if kind.kind == "f" else np.iinfo(kind.str).max) - levels
    extra = [int(sample) for sample in page.extrasamples]
    if not extra or pixels.shape[-1] == colours or extra[0] not in (_ASSOCIATED, 2):
        return np.ascontiguousarray(levels), None, bytes(page.iccprofile or b"")
    alpha = pixels[..., colours]
    if extra[0] == _ASSOCIATED:
        levels = _divided(levels, alpha)
    return np.ascontiguousarray(levels), np.ascontiguousarray(alpha), bytes(page.iccprofile or b"")


def _divided(levels: Levels, alpha: Plane) -> Levels:
    full = 1.0 if levels.dtype.kind == "f" else float(np.iinfo(levels.dtype).max)
    share = np.maximum(alpha.astype(np.float64) / full, 1e-6)[..., None]
    divided = levels / share
    return (divided if levels.dtype.kind == "f" else np.round(divided.clip(0.0, full))).astype(levels.dtype)


def _page(path: Path) -> tifffile.TiffPage:
    """Return the first picture of a file with its header read."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with tifffile.TiffFile(path) as file:
                page = file.pages.first
                if not isinstance(page, tifffile.TiffPage):
                    raise ValueError("its first picture has no header")
                _refuse_raw(page)
                # Read now, while the file is open.
                _ = page.iccprofile, page.extrasamples, page.bitspersample
                return page
    except PictureError:
        raise
    except Exception as error:  # the library raises many kinds for damaged headers
        raise PictureError(
            "scene.image_not_a_picture",
            f"is not a TIFF picture ({reason_of(error)}); export or copy it again",
        ) from error


def _refuse_raw(page: tifffile.TiffPage) -> None:
    """Raise `PictureError` for a camera's raw file, whose first picture is a preview or the sensor's mosaic.

    Source: DNG 1.7 (DNGVersion, CFA); NEF and ARW begin with a picture of reduced resolution.
    """
    if _DNG_VERSION in page.tags or page.photometric in _RAW_KINDS or page.subfiletype & 1:
        raise PictureError(
            "scene.image_not_a_picture",
            "is a camera's raw file under another suffix, or begins with a thumbnail; give it the suffix of "
            "its format, or export it as JPEG",
        )
