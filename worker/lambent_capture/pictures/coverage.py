"""Coverage of each picture by the object: mask files, alpha, and their combination."""

from pathlib import Path

import numpy as np
from lambent_proto.v1 import scene_pb2
from scipy import ndimage

from lambent_capture.arrays import Grey32, Reduced32
from lambent_capture.pictures.exif import exif_facts
from lambent_capture.pictures.mask_levels import Mask, read_mask
from lambent_capture.pictures.picture import box_averaged, turned, undoing
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import has_alpha, picture_size, read_picture
from lambent_capture.pictures.resample import reduced_size, resampled

OUTLINE_SIDE = 384
"""Longer side at which two ways to turn a mask are compared with the photograph, pixels."""
CLEARER = 1.25
"""Contrast along the right outline over that along the wrong one, at least."""
SAME_OVERLAP = 0.98
"""Intersection over union of two masks that are the same but for their edges."""


def has_coverage(folder: Path, frame: scene_pb2.Frame) -> bool:
    """Return whether a frame has a mask file, or photographs that may be transparent; reads headers only.

    Raises `PictureError` for a photograph that cannot be opened.
    """
    return bool(frame.mask) or has_alpha(folder / frame.images[0].path)


def frame_mask(folder: Path, frame: scene_pb2.Frame) -> Mask | None:
    """Return the mask file of a frame in the stored rows and columns of its photograph; None without one.

    Raises `PictureError` as `photograph_mask` does.
    """
    if not frame.mask:
        return None
    return photograph_mask(folder / frame.mask, folder / frame.images[0].path, frame.mask_encoding)


def photograph_mask(path: Path, photograph: Path, encoding: str = "") -> Mask:
    """Return a mask in the rows and columns of its photograph, as `read_picture` gives them.

    A mask that was painted on the photograph as people see it is turned back by the photograph's EXIF
    orientation, and one with an orientation of its own by that. Where the sizes do not tell whether a mask
    was painted upright, the photograph does: an outline lies where its colours change. A mask of another size
    is returned as it is. Raises `PictureError` as `read_mask` does, and `scene.mask_orientation` where
    neither way is clearly better.
    """
    mask = read_mask(path, encoding)
    taken, own = exif_facts(photograph), exif_facts(path)
    alike = (taken.orientation, taken.is_mirrored) == (own.orientation, own.is_mirrored)
    if alike or mask.is_as_stored:
        return mask
    width, height = picture_size(photograph)
    candidates = [turned(turned(mask.coverage, own.orientation), undoing(taken.orientation))]
    if own.orientation == 1 and not own.is_mirrored:
        # A program that ignores EXIF painted on the rows and columns of the file.
        candidates.append(mask.coverage[:, ::-1] if taken.is_mirrored else mask.coverage)
    fitting = [candidate for candidate in candidates if candidate.shape == (height, width)]
    if not fitting:
        return mask
    chosen = fitting[0] if len(fitting) == 1 else _clearest(photograph, fitting)
    return Mask(coverage=chosen, full=mask.full, is_inverted=mask.is_inverted, is_as_stored=True)


def fits(path: Path, photograph: Path) -> bool:
    """Return whether a mask has the size of its photograph, as it is stored or as it is to be seen.

    Raises `PictureError` for a file whose header cannot be read.
    """
    mask, picture = picture_size(path), picture_size(photograph)
    if mask == picture:
        return True
    turns = {exif_facts(each).orientation for each in (path, photograph)}
    return mask == picture[::-1] and not turns.isdisjoint({6, 8})


def frame_coverage(folder: Path, frame: scene_pb2.Frame) -> Grey32 | None:
    """Return the object's coverage of each pixel of the first photograph, or None if it is not given.

    The size is that of the files, lens distortion included. Raises `PictureError`.
    """
    alpha = alpha_of(folder / frame.images[0].path)
    mask = frame_mask(folder, frame)
    if mask is None:
        return alpha
    if alpha is None or alpha.shape != mask.coverage.shape:
        return mask.coverage
    return np.minimum(alpha, mask.coverage)


def alpha_of(path: Path) -> Grey32 | None:
    """Return the alpha of a picture, from 0 to 1, or None where it states none. Raises `PictureError`."""
    if not has_alpha(path):
        return None
    picture = read_picture(path)
    return None if picture.alpha is None else picture.coverage()


def small_coverage(folder: Path, frame: scene_pb2.Frame, max_side: int) -> Reduced32 | None:
    """Return `frame_coverage` as the frame's pinhole camera shows it, reduced to `max_side` pixels."""
    coverage = frame_coverage(folder, frame)
    if coverage is None:
        return None
    size = reduced_size(frame.camera.width, frame.camera.height, max_side)
    return resampled(coverage[..., None], frame.camera, size)[..., 0]


def _clearest(photograph: Path, candidates: list[Grey32]) -> Grey32:
    """Return the one of two masks whose outline lies where the photograph changes."""
    size = reduced_size(candidates[0].shape[1], candidates[0].shape[0], OUTLINE_SIDE)
    insides = [box_averaged(candidate, size) > 0.5 for candidate in candidates]
    union = (insides[0] | insides[1]).sum()
    if not union or (insides[0] & insides[1]).sum() >= SAME_OVERLAP * union:
        return candidates[0]
    shown = read_picture(photograph, side=max(size)).srgb().astype(np.float32)
    change = sum(ndimage.gaussian_gradient_magnitude(shown[..., channel], 1.0) for channel in range(3))
    clear = []
    for inside in insides:
        outline = inside & ~ndimage.binary_erosion(inside, border_value=1)
        clear.append(float(np.asarray(change)[outline].mean()) if outline.any() else 0.0)
    best, other = (0, 1) if clear[0] >= clear[1] else (1, 0)
    if clear[best] < CLEARER * clear[other] or not clear[best]:
        raise PictureError(
            "scene.mask_orientation",
            "has the size of its photograph both as the file stores it and as its EXIF orientation turns it; "
            "save photograph and mask upright, without an EXIF orientation",
        )
    return candidates[best]
