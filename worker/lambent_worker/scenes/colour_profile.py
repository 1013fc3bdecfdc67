"""Brings the colours of 8-bit photographs from the profile in their file to sRGB.

Telephones save Display P3. Taken for sRGB its colours would be paler than the object's: a pure red of Display
P3 reads (255, 0, 0) in both, and is a redder light.
"""

import io
from functools import lru_cache

import numpy as np
from PIL import Image, ImageCms

SAME_LEVELS = 2
"""Greatest difference of an 8-bit value up to which a profile counts as sRGB; writers round its curve."""
_SPACES = {"RGB": "RGB ", "RGBA": "RGB ", "L": "GRAY", "CMYK": "CMYK"}
_PROBE_STEPS = 9


def in_srgb(image: Image.Image) -> Image.Image:
    """Return an 8-bit picture with sRGB colours: mode RGB, RGBA, L or LA.

    Colours beyond sRGB are clipped to it. Alpha stays as it is. A picture without a profile, with one that
    cannot be read (see `profile_fault`), or of grey levels with alpha is taken for sRGB; CMYK without a
    profile is converted by Pillow's plain formula.
    """
    plain = _plain(image)
    profile = image.info.get("icc_profile")
    if profile and plain.mode in _SPACES:
        transform = _transform(bytes(profile), plain.mode)
        if isinstance(transform, ImageCms.ImageCmsTransform):
            return transform.apply(plain)
    return plain.convert("RGB") if plain.mode == "CMYK" else plain


def profile_fault(image: Image.Image) -> str:
    """Return why the colour profile of a picture cannot be used, or "" where it can or there is none."""
    profile, mode = image.info.get("icc_profile"), _plain_mode(image)
    if not profile or mode not in _SPACES:
        return ""
    transform = _transform(bytes(profile), mode)
    return transform if isinstance(transform, str) else ""


def _plain_mode(image: Image.Image) -> str:
    if image.mode in (*_SPACES, "LA"):
        return image.mode
    return "RGBA"


def _plain(image: Image.Image) -> Image.Image:
    mode = _plain_mode(image)
    return image if image.mode == mode else image.convert(mode)


@lru_cache(maxsize=16)
def _transform(profile: bytes, mode: str) -> ImageCms.ImageCmsTransform | str | None:
    """Return the conversion to sRGB, None where nothing is to be converted, or why there is none."""
    try:
        given = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        space = given.profile.xcolor_space
        if space != _SPACES[mode]:
            return f"it describes {space.strip() or 'unknown'} colours, the picture is {mode}"
        transform = ImageCms.buildTransform(
            given,
            ImageCms.createProfile("sRGB"),
            mode,
            "RGBA" if mode == "RGBA" else "RGB",
            renderingIntent=ImageCms.Intent.RELATIVE_COLORIMETRIC,
        )
    except (ImageCms.PyCMSError, OSError, TypeError, ValueError) as error:
        return str(error)[:120] or type(error).__name__
    if mode == "CMYK":
        return transform
    probe = _probe(mode)
    before = np.asarray(probe.convert("RGB"), dtype=np.int16)
    after = np.asarray(transform.apply(probe).convert("RGB"), dtype=np.int16)
    return None if np.abs(after - before).max() <= SAME_LEVELS else transform


def _probe(mode: str) -> Image.Image:
    """Return a picture that holds a lattice of all colours of `mode`."""
    levels = np.linspace(0, 255, _PROBE_STEPS).round().astype(np.uint8)
    lattice = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1)
    return Image.fromarray(lattice.reshape(_PROBE_STEPS, -1, 3)).convert(mode)
