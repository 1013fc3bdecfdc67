"""Masks from a camera that stands still: what changes from photograph to photograph is the object.

No cameras are needed; the masks are for finding them, and a little generous. What turns with the object
counts as object, a printed plate too: its print says how it turned. A plain plate shows no change and is left
out. Once there are cameras, masks are made anew in the object's coordinates, where the plate is the support.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray

from lambent_capture.arrays import Colours32, Grey8, Grey32, Region, Rgb
from lambent_capture.masks.photograph import Progress
from lambent_capture.pictures.mask_levels import write_mask
from lambent_capture.pictures.pictures import picture_size, read_picture

SIDE = 320
"""Longer side at which photographs are compared, pixels."""
FEWEST = 6
"""Photographs below which nothing tells a background from what moves."""
MOST_VOTERS = 48
"""Photographs from which the background is taken, evenly spaced."""
LEAST_CHANGE = 0.12
"""Difference of the logarithm of a channel that counts as a change at least."""
DARK = 0.02
"""Encoded value, of 1, that is added before taking logarithms: differences between blacks do not count."""
NOISES = 5.0
"""Standard deviations of a standing pixel that count as a change."""
SUPPORT = 0.2
"""Share of the photographs in which a background shows at least where the object ever was in front of it."""
SHADOW = (0.25, 0.97)
"""Brightness of a shadow relative to the same place without it."""
SHADOW_TINT = 0.08
"""Difference between the channels' logarithms up to which darkening leaves the colour as it is."""
STANDING = 0.6
"""Share of the photographs in which a pixel shows the background, from which it stands still."""
LEAST_STANDING = 0.2
"""Share of the picture that stands still behind a turntable."""
LEAST_EDGES = 0.003
"""Share of the picture that is edges which stand still: plain paper stands still before any camera."""
EDGE = 0.25
"""Change of the logarithm between neighbouring pixels at an edge."""
SPECK = 0.1
"""Size of a part relative to the largest below which it is a speck."""
GROWN = 0.012
"""Width by which masks are widened, of the longer side."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Motion:
    """What photographs of one camera show of a standing background and of what moves before it."""

    masks: tuple[Region, ...]
    """The object in each photograph, a little generous."""
    standing_share: float
    """Share of the picture that stands still, 0..1."""
    edge_share: float
    """Share of the picture that is edges which stand still, 0..1."""

    @property
    def stands(self) -> bool:
        """Return whether the camera stood still before a background with something on it."""
        moving = any(mask.any() for mask in self.masks)
        return moving and self.standing_share >= LEAST_STANDING and self.edge_share >= LEAST_EDGES


def find_motion(pictures: Sequence[Rgb]) -> Motion | None:
    """Return what moves in photographs of equal size, sRGB; None for too few, or where nothing stands still.

    Pixels are compared as logarithms, after each photograph has been brought to the exposure and white
    balance of the others. The background of a pixel is the value that most photographs agree on; a photograph
    shows the object where it differs from that by more than noise and not just by a shadow.
    """
    if len(pictures) < FEWEST or len({picture.shape for picture in pictures}) > 1:
        return None
    logs = _even(np.stack([np.log(picture.astype(np.float32) / 255.0 + DARK) for picture in pictures]))
    background, support, noise = _background(logs)
    threshold = np.maximum(LEAST_CHANGE, NOISES * noise)
    change = logs - background
    differs = np.abs(change).max(axis=-1) > threshold
    differs &= ~_is_shadow(change)
    # Where no value shows often enough, the object was always in front.
    always = (support < SUPPORT) & (differs.mean(axis=0) > 0.5)
    masks = _cleaned(differs | always)
    standing = (support >= STANDING) & ~(np.mean(masks, axis=0) > 0.5)
    motion = Motion(
        masks=tuple(masks),
        standing_share=float(standing.mean()),
        edge_share=float((standing & _edges(background)).mean()),
    )
    return motion if motion.stands else None


def write_motion_masks(
    paths: Sequence[Path],
    names: Sequence[str],
    out: Path,
    progress: Progress = lambda phase, done, total: None,
) -> Motion | None:
    """Write a mask for each photograph to `out/NAME.png`, of the photograph's size; None where nothing moves.

    `names` are those of the masks without suffix. One photograph at a time is decoded. Raises `PictureError`
    for one that cannot be.
    """
    pictures, sizes = [], []
    for number, path in enumerate(paths):
        progress("looking for what moves", number, len(paths))
        pictures.append(read_picture(path, side=SIDE).srgb())
        sizes.append(picture_size(path))
    motion = find_motion(pictures)
    if motion is None:
        return None
    for name, mask, size in zip(names, motion.masks, sizes, strict=True):
        full = cv2.resize(255 * mask.astype(np.uint8), size, interpolation=cv2.INTER_LINEAR)
        write_mask(out / f"{name}.png", np.where(full > 127, 255, 0).astype(np.uint8), compress_level=3)
    return motion


def _even(logs: Float32[ndarray, "n height width 3"]) -> Float32[ndarray, "n height width 3"]:
    """Return photographs brought to one exposure and white balance: that of their median.

    A photograph's offset is the median over the pixels that vary least, which are background, in two rounds.
    """
    for _ in range(2):
        middle = np.median(logs, axis=0)
        spread = np.abs(logs - middle).mean(axis=(0, 3))
        calm = spread <= np.quantile(spread, 0.5)
        logs = logs - np.median((logs - middle)[:, calm], axis=1)[:, None, None, :]
    return logs.astype(np.float32)


def _background(logs: Float32[ndarray, "n height width 3"]) -> tuple[Colours32, Grey32, Grey32]:
    """Return the value that most photographs agree on, their share, and the noise around it, per pixel."""
    logs = logs[:: -(-len(logs) // MOST_VOTERS)]
    count = len(logs)
    votes = np.zeros(logs.shape[:3], np.int16)
    for each in range(count):
        votes[each] = (np.abs(logs - logs[each]).max(axis=-1) < LEAST_CHANGE).sum(axis=0)
    best = votes.argmax(axis=0)
    chosen = np.take_along_axis(logs, best[None, ..., None], axis=0)[0]
    near = np.abs(logs - chosen).max(axis=-1) < LEAST_CHANGE
    agreeing = np.maximum(near.sum(axis=0), 1)
    mean = (logs * near[..., None]).sum(axis=0) / agreeing[..., None]
    variance = (np.square(logs - mean) * near[..., None]).sum(axis=0).max(axis=-1) / agreeing
    return (
        mean.astype(np.float32),
        (agreeing / count).astype(np.float32),
        np.sqrt(variance).astype(np.float32),
    )


def _is_shadow(change: Float32[ndarray, "n height width 3"]) -> Bool[ndarray, "n height width"]:
    """Return where a pixel is a darker version of the background of the same colour."""
    level = change.mean(axis=-1)
    tint = np.ptp(change, axis=-1)
    return (level > np.log(SHADOW[0])) & (level < np.log(SHADOW[1])) & (tint < SHADOW_TINT)


def _cleaned(raw: Bool[ndarray, "n height width"]) -> list[Region]:
    """Return masks without holes and specks, closed and widened."""
    side = max(raw.shape[1:])
    closing = _disc(max(1, round(0.01 * side)))
    grown = _disc(max(1, round(GROWN * side)))
    masks = []
    for mask in raw:
        # An opening by one pixel removes the noise before it can be closed into parts.
        plain = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, _disc(1))
        plain = _filled(cv2.morphologyEx(plain, cv2.MORPH_CLOSE, closing))
        count, labels, stats, _ = cv2.connectedComponentsWithStats(plain, connectivity=8)
        if count > 1:
            areas = stats[1:, cv2.CC_STAT_AREA]
            kept = 1 + np.flatnonzero(areas >= SPECK * areas.max())
            plain = np.isin(labels, kept).astype(np.uint8)
        masks.append(cv2.dilate(plain, grown).astype(bool))
    return masks


def _filled(mask: Grey8) -> Grey8:
    """Return the mask with what it encloses."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(np.zeros_like(mask), contours, -1, 1, cv2.FILLED))


def _edges(logs: Colours32) -> Region:
    across, down = np.abs(np.diff(logs, axis=1)).max(axis=-1), np.abs(np.diff(logs, axis=0)).max(axis=-1)
    edges = np.zeros(logs.shape[:2], bool)
    edges[:, :-1] |= across > EDGE
    edges[:-1] |= down > EDGE
    return edges


def _disc(radius: int) -> UInt8[ndarray, "side side"]:
    size = 2 * radius + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
