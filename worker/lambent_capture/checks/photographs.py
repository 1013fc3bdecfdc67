"""Looks at photographs without cameras: one decode of each at reduced size, figures, and thumbnails.

For the check's child process, which limits memory and time. Findings: `photograph_findings.note_photographs`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from lambent_core.files import file_sha256
from numpy import ndarray

from lambent_capture.checks import photograph_measures as measures
from lambent_capture.checks.observe import portrait_of, thumbnail_of
from lambent_capture.checks.photograph_limits import PhotographLimits
from lambent_capture.pictures.exif import ExifFacts, exif_facts
from lambent_capture.pictures.picture_error import NOTHING_SKIPPED, SKIPPED, PictureError
from lambent_capture.pictures.pictures import (
    LINEAR_SUFFIXES,
    opened,
    picture_format,
    picture_size,
    read_picture,
)

MASK_AMONG_PHOTOGRAPHS = "scene.mask_among_photographs"


@dataclass(frozen=True, kw_only=True, slots=True)
class PhotographFigures:
    """Measurements of one photograph; a photograph with a `fault` has name, size and facts at most."""

    name: str
    """Path below the folder."""
    width: int = 0
    height: int = 0
    facts: ExifFacts = field(default_factory=ExifFacts)
    fault: str = ""
    """Code of what makes it unusable."""
    reason: str = ""
    """The same in words, to follow the name."""
    sharpness: float = 0.0
    """Relative to the sharpest quarter of the photographs; 0 where it has no texture."""
    brightness_ev: float = 0.0
    clipped_share: float = 0.0
    deviation: float = 0.0
    """Standard deviation of brightness, 8-bit levels."""
    flat_share: float = 0.0
    has_alpha: bool = False
    colour_doubt: str = ""
    """Why its colour space is an assumption, as the end of a sentence; "" where it is none."""
    num_pictures: int = 1
    """Pictures in an animation."""
    is_panorama: bool = False
    """Whether its own metadata say so."""
    is_like_a_mask: bool = False
    same_as: str = ""
    """Name of the first photograph that shows the same view of the same thing."""
    is_copy: bool = False
    """Whether it is the same as `same_as` byte by byte."""
    alike: str = ""
    """Name of an earlier photograph that differs little, where none is the same."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PhotographsFigures:
    """Measurements of the photographs in a folder."""

    photographs: tuple[PhotographFigures, ...]
    exposure_range_ev: float
    """Between the 5th and 95th percentile of the median brightness."""
    thumbnails: Mapping[str, str]
    """JPEG in base64 by name."""
    portrait: str
    """The first photograph that is not a mask, by which people recognise them: JPEG in base64; empty without
    any that can be read."""

    @property
    def usable(self) -> tuple[PhotographFigures, ...]:
        """Return the photographs without a fault."""
        return tuple(each for each in self.photographs if not each.fault)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Return the names of the photographs with a fault."""
        return tuple(each.name for each in self.photographs if each.fault)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Seen:
    """What is kept of a photograph until all have been read."""

    figures: dict[str, Any]
    detail: float
    digest: str
    small: UInt8[ndarray, "32 32"]
    bits: int
    thumbnail: str


def look(
    folder: Path,
    names: Sequence[str],
    limits: PhotographLimits,
    announce: Callable[[str], None] = lambda name: None,
    skip: Mapping[str, str] = NOTHING_SKIPPED,
) -> PhotographsFigures:
    """Return the figures of the photographs `names` in `folder`; nothing that they hold makes it raise.

    `announce` is called with each name before its file is decoded, and with "" at the end; `skip` has those
    that have brought a reader down, with the code of how.
    """
    seen: dict[str, _Seen] = {}
    rows: list[dict[str, Any]] = []
    portraits: dict[int, str] = {}
    for name in names:
        announce(name)
        row: dict[str, Any] = {"name": name}
        rows.append(row)
        if name in skip:
            row |= {"fault": skip[name], "reason": SKIPPED[skip[name]]}
            continue
        try:
            seen[name] = _read(folder / name, limits, row, portraits)
            row |= seen[name].figures
        except PictureError as error:
            row |= {"fault": error.code, "reason": str(error)}
    announce("")
    details = [each.detail for each in seen.values() if each.detail > 0.0]
    sharpest = float(np.percentile(details, 75.0)) if details else 0.0
    for row in rows:
        if row["name"] in seen and sharpest > 0.0:
            row["sharpness"] = seen[row["name"]].detail / sharpest
    _tell_masks_apart(rows, seen)
    _compare(rows, seen, limits)
    photographs = tuple(PhotographFigures(**row) for row in rows)
    usable = [each for each in photographs if not each.fault]
    shown = [each.brightness_ev for each in usable if each.deviation >= limits.blank_levels]
    low, high = np.percentile(shown or [0.0], [5.0, 95.0])
    return PhotographsFigures(
        photographs=photographs,
        exposure_range_ev=float(high - low),
        thumbnails={name: each.thumbnail for name, each in seen.items()},
        portrait=next((portraits[rank] for rank in sorted(portraits)), ""),
    )


def _read(path: Path, limits: PhotographLimits, row: dict[str, Any], portraits: dict[int, str]) -> _Seen:
    """Return what a photograph shows, after filling in its size; raises `PictureError` where it is unusable.

    `portraits` gets its portrait under its rank where it is the first of that: 0 for a photograph, 1 for
    a picture of one level, which may be the mask of a view without the object, and 2 for any other mask.
    """
    row["width"], row["height"] = size = picture_size(path)
    if min(size) < limits.min_side:
        raise PictureError(
            "scene.image_tiny",
            f"has {size[0]} x {size[1]} pixels, in which nothing can be recognised; use the original",
        )
    row["facts"] = exif_facts(path)
    num_pictures, is_panorama = _extras(path)
    picture = read_picture(path, side=limits.detail_side)
    if picture.is_linear and not np.isfinite(picture.levels).all():
        raise PictureError("scene.image_not_finite", "holds NaN or infinity; export it again without")
    shown, alpha = picture.srgb(), picture.coverage()
    luma = measures.luma_of(shown)
    is_like_a_mask = bool((alpha >= 1.0).all()) and measures.is_like_a_mask(shown)
    rank = 2 if is_like_a_mask else int(luma.std() < limits.blank_levels)
    if rank not in portraits:
        portraits[rank] = portrait_of(shown, alpha)
    return _Seen(
        figures={
            "brightness_ev": measures.brightness_ev(shown),
            "clipped_share": float((shown.max(axis=-1) >= limits.clipped_level).mean()),
            "deviation": float(luma.std()),
            "flat_share": measures.flat_share(shown),
            "has_alpha": bool((alpha < 1.0).any()),
            "colour_doubt": picture.colour_doubt,
            "num_pictures": num_pictures,
            "is_panorama": is_panorama,
            "is_like_a_mask": is_like_a_mask,
        },
        detail=measures.sharpness_of(luma),
        digest=file_sha256(path),
        small=measures.small_luma(luma),
        bits=measures.difference_hash(luma),
        thumbnail=thumbnail_of(shown, np.ones(luma.shape, dtype=np.float32), side=limits.thumbnail_side),
    )


def _extras(path: Path) -> tuple[int, bool]:
    """Return how many pictures an animation has, and whether the metadata (Google's GPano) name a
    panorama."""
    if path.suffix.lower() in LINEAR_SUFFIXES or picture_format(path) == "TIFF":
        return 1, False
    with opened(path) as image:
        animated = image.format in ("PNG", "WEBP")
        described = image.info.get("xmp", b"")
        described = described.encode() if isinstance(described, str) else described
        return (getattr(image, "n_frames", 1) if animated else 1), b"GPano:ProjectionType" in described


def _tell_masks_apart(rows: list[dict[str, Any]], seen: Mapping[str, _Seen]) -> None:
    """Mark pictures that look like masks as unusable, unless all of them do."""
    masks = [row for row in rows if row.get("is_like_a_mask")]
    if len(masks) < len(seen):
        reason = "is black and white, as masks are; give masks in a folder called masks, or with --masks"
        for row in masks:
            row |= {"fault": MASK_AMONG_PHOTOGRAPHS, "reason": reason}


def _compare(rows: list[dict[str, Any]], seen: Mapping[str, _Seen], limits: PhotographLimits) -> None:
    """Fill in which photographs are the same as, or like, an earlier one."""
    names: list[str] = []
    smalls = np.zeros((len(seen), 32 * 32), dtype=np.int16)
    bits = np.zeros(len(seen), dtype=np.uint64)
    first: dict[str, str] = {}
    for row in rows:
        each = seen.get(row["name"])
        if each is None or row.get("fault"):
            continue
        if each.digest in first:
            row |= {"same_as": first[each.digest], "is_copy": True}
            continue
        first[each.digest] = row["name"]
        count = len(names)
        small = each.small.ravel().astype(np.int16)
        distance = np.abs(smalls[:count] - small).max(axis=1, initial=0)
        flipped = np.bitwise_count(bits[:count] ^ np.uint64(each.bits))
        if count and distance.min() <= limits.same_levels:
            row["same_as"] = names[int(distance.argmin())]
            continue
        if count and flipped.min() <= limits.alike_bits:
            row["alike"] = names[int(flipped.argmin())]
        smalls[count], bits[count] = small, each.bits
        names.append(row["name"])
