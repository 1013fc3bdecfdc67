"""The meaning of a mask file's levels: grey levels, alpha, 0 and 1, labels, and their inverse.

Programs write masks in a dozen ways. Each is read as its author meant it, and where that cannot be known the
file is refused: training against a black mask gives nothing, and says nothing.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Shaped
from numpy import ndarray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from lambent_capture.arrays import Grey32, Plane
from lambent_capture.pictures.picture import Picture, shares, turned, undoing
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.picture_statements import MIRRORED, orientation_of
from lambent_capture.pictures.pictures import (
    LINEAR_SUFFIXES,
    decode,
    opened,
    picture_format,
    picture_size,
    read_levels,
    read_picture,
)
from lambent_capture.pictures.png_header import png_header

NERO_DEPTH = "nero_depth"
"""Encoding of a mask that is a depth picture of Glossy Synthetic: 65535 stands for 15 scene units."""
NERO_BACKGROUND = 14.5
"""Depth from which on nothing was hit, scene units."""
MOST_LABELS = 32
"""A picture with more different levels, or higher ones, holds no labels."""
GREY_NOISE = 8
"""8-bit levels by which the channels of a grey picture may differ after lossy compression."""
BORDER_COVERED = 0.95
"""Share of a mask's border from which on it is the surroundings that are white."""
LEAST_SHOWN = 0.002
"""Share of the picture that an object has at least, for its mask to count as inverted."""
_LOSSY = frozenset({"JPEG", "WEBP", "HEIF", "AVIF"})
_SENSOR_RANGES = (255, 1023, 4095, 16383)
"""Full scale of 8, 10, 12 and 14 bits, stored in 16."""
_TEXT, _AS_STORED = "Orientation", "rows and columns of the photograph's file"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Mask:
    """A mask file, understood."""

    coverage: Grey32
    """The object's share of each pixel, 0..1."""
    full: int
    """The level that stands for the object; 0 where none does, or levels do not count."""
    is_inverted: bool = False
    """Whether the file has the object black on white; `coverage` is right already."""
    is_as_stored: bool = False
    """Whether the file says that its rows and columns are those of the photograph's file."""


def read_mask(path: Path, encoding: str = "") -> Mask:
    """Return what a mask file says, in its own rows and columns.

    Alpha counts where it leaves something out; else grey levels. Two levels are background and object,
    whichever they are (0 and 1, 0 and 255, 1 and 2). A few low levels, and the colours of a palette, are
    labels, of which 0 is the background. With the encoding `NERO_DEPTH` the object is what is nearer than the
    background. Raises `PictureError` as `read_picture` does, and `scene.mask_levels` for levels that could
    mean anything.
    """
    if encoding == NERO_DEPTH:
        levels = read_levels(path)
        full = 1.0 if levels.dtype.kind == "f" else float(np.iinfo(levels.dtype).max)
        nearer = levels[..., 0] * (15.0 / full) < NERO_BACKGROUND
        return Mask(coverage=nearer.astype(np.float32), full=0)
    labels = _palette_labels(path)
    if labels is not None:
        coverage, full = (labels > 0).astype(np.float32), 1
    else:
        picture = read_picture(path)
        if not np.isfinite(picture.levels).all():
            raise PictureError("scene.image_not_finite", "holds NaN or infinity; export it again without")
        coverage, full = _few_bits(path, picture) or _covered(picture, lossy=_is_lossy(path))
    inverted = _is_inverted(coverage)
    return Mask(
        coverage=1.0 - coverage if inverted else coverage,
        full=full,
        is_inverted=inverted,
        is_as_stored=_is_as_stored(path),
    )


def write_mask(path: Path, coverage: Plane, **options: int) -> None:
    """Write a mask (0..1, or 8-bit levels) in a photograph's stored rows and columns as PNG, saying so.

    `options` are those of Pillow's PNG writer.
    """
    levels = coverage if coverage.dtype == np.uint8 else np.round(255.0 * coverage).astype(np.uint8)
    text = PngInfo()
    text.add_text(_TEXT, _AS_STORED)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(levels).save(path, "PNG", pnginfo=text, **options)


def _covered(picture: Picture, *, lossy: bool) -> tuple[Grey32, int]:
    """Return coverage, and the level that stands for the object."""
    if picture.alpha is not None:
        alpha = shares(picture.alpha)
        if alpha.min() < 0.5:
            return alpha, 0
    levels = picture.levels
    if levels.shape[-1] == 3:
        spread = levels.max(axis=-1).astype(np.float32) - levels.min(axis=-1)
        noise = GREY_NOISE / 255.0 * (1.0 if picture.is_linear else np.iinfo(levels.dtype).max)
        if (spread > noise).mean() > 0.001:
            return _coloured(levels, lossy=lossy), 0
        # The mean of three equal levels is that level, exactly.
        grey = levels.mean(axis=-1, dtype=np.float64)
        levels = (grey if picture.is_linear else np.round(grey)).astype(levels.dtype)[..., None]
    grey = levels[..., 0]
    return _of_floats(grey) if picture.is_linear else _of_levels(grey, lossy=lossy)


def _few_bits(path: Path, picture: Picture) -> tuple[Grey32, int] | None:
    """Return the labels of a grey PNG with 2 or 4 bits that does not use its whole scale; None for others.

    Decoded, they are spread over 0..255, and look like greys.
    """
    if path.suffix.lower() in LINEAR_SUFFIXES or picture_format(path) != "PNG":
        return None
    header = png_header(path)
    if header.colour_type != 0 or header.bit_depth not in (2, 4) or picture.alpha is not None:
        return None
    if not 0 < picture.levels.max() < 255:
        return None
    return (picture.levels[..., 0] > 0).astype(np.float32), 1


def _of_levels(grey: Plane, *, lossy: bool) -> tuple[Grey32, int]:
    top, limit = int(grey.max()), int(np.iinfo(grey.dtype).max)
    if top == 0:
        return np.zeros(grey.shape, dtype=np.float32), 0
    if not lossy:
        values = np.flatnonzero(np.bincount(grey.ravel(), minlength=1))
        if len(values) == 1:
            return np.ones(grey.shape, dtype=np.float32), top
        if len(values) == 2:
            return (grey == top).astype(np.float32), top
        if values[0] == 0 and len(values) <= MOST_LABELS and top <= MOST_LABELS:
            return (grey > 0).astype(np.float32), 1
        if grey.dtype == np.uint16 and top in _SENSOR_RANGES:
            limit = top
    if top < limit // 2:
        raise _unclear(f"its brightest level is {top} of {limit}")
    return grey.astype(np.float32) / np.float32(limit), limit


def _of_floats(grey: Plane) -> tuple[Grey32, int]:
    low, top = float(grey.min()), float(grey.max())
    if top <= 0.0:
        return np.zeros(grey.shape, dtype=np.float32), 0
    if ((grey == low) | (grey == top)).all():
        return (grey == top).astype(np.float32), 1
    if top < 0.5 or top > 1.01:
        raise _unclear(f"its brightest level is {top:.4g}, of 1")
    return np.clip(grey, 0.0, 1.0).astype(np.float32), 1


def _coloured(levels: Shaped[ndarray, "height width 3"], *, lossy: bool) -> Grey32:
    """Return the coverage of an object painted in colour: everything but the colour of the background.

    That is black where there is black. One colour over black may have soft edges.
    """
    if lossy:
        raise _unclear("it is a colour picture with lossy compression")
    flat = levels.reshape(-1, 3).astype(np.float64)
    brightest = flat[flat.sum(axis=-1).argmax()]
    share = flat @ brightest / (brightest @ brightest)
    full = 1.0 if levels.dtype.kind == "f" else float(np.iinfo(levels.dtype).max)
    if np.abs(flat - share[:, None] * brightest).max() <= GREY_NOISE / 255.0 * full:
        return np.clip(share, 0.0, 1.0).reshape(levels.shape[:2]).astype(np.float32)
    colours, number = np.unique(levels.reshape(-1, 3), axis=0, return_inverse=True)
    number = number.reshape(levels.shape[:2])
    if len(colours) > 2 * MOST_LABELS:
        raise _unclear(f"it has {len(colours)} colours")
    black = np.flatnonzero((colours == 0).all(axis=-1))
    background = int(black[0]) if len(black) else int(np.bincount(_border(number)).argmax())
    return (number != background).astype(np.float32)


def _palette_labels(path: Path) -> Plane | None:
    """Return the indices of a picture with a palette of colours; None for greys and all others."""
    if path.suffix.lower() in LINEAR_SUFFIXES or picture_format(path) not in ("PNG", "TIFF"):
        return None
    picture_size(path)
    try:
        image = opened(path)
    except PictureError:  # a TIFF that Pillow does not know has no palette
        return None
    with image:
        if image.mode != "P" or image.has_transparency_data:
            return None
        orientation = orientation_of(image)
        decode(image)
        indices = np.asarray(image)
        if image.format == "TIFF":  # which Pillow has turned
            indices = turned(indices, undoing(orientation))
        indices = indices[:, ::-1] if orientation in MIRRORED else indices
        palette = np.array(image.getpalette() or [], dtype=np.int16).reshape(-1, 3)
    used = np.unique(indices)
    used = used[used < len(palette)]
    is_grey = not np.ptp(palette[used], axis=1).any()
    # Greys that are as dark as their numbers are labels too: 0, 1, 2.
    return None if is_grey and palette[used].max(initial=0) > MOST_LABELS else indices


def _is_lossy(path: Path) -> bool:
    if path.suffix.lower() in LINEAR_SUFFIXES:
        return False
    known = picture_format(path)
    if known == "WEBP":
        with path.open("rb") as file:
            return b"VP8L" not in file.read(64)
    return known in _LOSSY


def _is_inverted(coverage: Grey32) -> bool:
    """Return whether all around is white and something inside is black."""
    inside = coverage < 0.5
    return bool((_border(coverage) > 0.5).mean() >= BORDER_COVERED and inside.mean() >= LEAST_SHOWN)


def _border(values: Plane) -> Shaped[ndarray, " pixels"]:
    return np.concatenate([values[0], values[-1], values[1:-1, 0], values[1:-1, -1]])


def _is_as_stored(path: Path) -> bool:
    if path.suffix.lower() in LINEAR_SUFFIXES or picture_format(path) != "PNG":
        return False
    with opened(path) as image:
        return image.info.get(_TEXT) == _AS_STORED


def _unclear(what: str) -> PictureError:
    return PictureError(
        "scene.mask_levels",
        f"cannot be understood as a mask: {what}; save it as PNG with 0 for the background and 255 for the "
        "object",
    )
