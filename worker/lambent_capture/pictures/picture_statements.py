"""Statements of an encoded picture about itself: its colour space, and whether it is a mirror image."""

import warnings
from pathlib import Path

from PIL import Image

from lambent_capture.pictures.colour_space import (
    ADOBE_RGB,
    SRGB,
    ColourSpace,
    of_code_points,
    of_gamma,
    of_profile,
)
from lambent_capture.pictures.heif_boxes import nclx_of
from lambent_capture.pictures.png_header import PngHeader

_EXIF_FOLDER, _INTEROPERABILITY, _COLOUR_SPACE, _INDEX = 0x8769, 0xA005, 0xA001, 1
_ADOBE_RGB, _UNCALIBRATED = 2, 0xFFFF
_ORIENTATION, MIRRORED = 0x0112, frozenset({2, 4, 5, 7})
"""EXIF orientations of pictures that are stored as a mirror image, whichever way up."""


def orientation_of(image: Image.Image) -> int:
    """Return the EXIF orientation of an opened picture, 1 to 8."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            orientation = image.getexif().get(_ORIENTATION, 1)
    except Exception:  # as in `_exif_space`
        return 1
    return orientation if orientation in range(1, 9) else 1


def stated_space(
    path: Path,
    known: str,
    image: Image.Image,
    png: PngHeader | None,
    channels: int,
) -> tuple[ColourSpace, str]:
    """Return the space that a file states, in the order of its standard, and why to doubt it, or "".

    PNG: cICP, iCCP, sRGB, gAMA with cHRM (W3C PNG 3rd edition, 4.3). HEIC and AVIF: profile, nclx. All
    others: profile. EXIF counts where nothing else is stated, and sRGB where EXIF is silent too.
    """
    profile = b"" if image.mode == "CMYK" else bytes(image.info.get("icc_profile") or b"")
    if png is not None and png.code_points:
        return of_code_points(*png.code_points[:2]), ""
    if profile:
        return of_profile(profile, channels)
    if png is not None and png.is_srgb:
        return SRGB, ""
    if png is not None and png.gamma:
        return of_gamma(png.gamma, png.chromaticities), ""
    if known in ("HEIF", "AVIF"):
        nclx = nclx_of(path)
        if nclx is not None:
            return of_code_points(*nclx), ""
    return _exif_space(image)


def _exif_space(image: Image.Image) -> tuple[ColourSpace, str]:
    """Return Adobe RGB where EXIF names it, as cameras do that write no profile, else sRGB; and any doubt.

    Source: DCF 2.0 (CIPA DC-009), 3.4: ColorSpace "uncalibrated" with interoperability index R03. Some write
    ColorSpace 2, and programs that copy EXIF lose the index.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            exif = image.getexif()
            tags = exif.get_ifd(_EXIF_FOLDER)
            index = str(exif.get_ifd(_INTEROPERABILITY).get(_INDEX, "")).strip("\0 ")
    except Exception:  # damaged EXIF says nothing, and the picture is still a picture
        return SRGB, ""
    space = tags.get(_COLOUR_SPACE)
    if space == _ADOBE_RGB or (space == _UNCALIBRATED and index == "R03"):
        return ADOBE_RGB, ""
    if space == _UNCALIBRATED and not index:
        return ADOBE_RGB, (
            "has no colour profile, and its EXIF says that its colours are not sRGB, so they are taken for "
            "Adobe RGB"
        )
    return SRGB, ""
