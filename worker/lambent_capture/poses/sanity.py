"""Takes out of a solved model what cannot be: points behind cameras or far off, and cameras without support.

COLMAP gives a point behind one of its cameras the largest double as squared error. A point beside a camera
gets the cube of a huge number from the lens's distortion. One such sighting makes any mean 10^150 pixels.
"""

from typing import Any

import numpy as np
import pycolmap
from jaxtyping import Float64
from numpy import ndarray

OUTLIER_PX, OUTLIER_MEDIANS = 1.0, 3.0
"""Work pixels, or medians if that is more, from which on a sighting is left out; COLMAP's limit is 4."""
MOST_PX = 16.0
"""Work pixels beyond which a sighting says nothing, whatever the others do: 1 % of a usual picture."""
MIN_ANGLE_DEG = 1.5
"""Between the rays to a point; smaller ones say nothing of its distance."""
MIN_SIGHTINGS = 10
"""Points that a camera must see in the end."""
FAR = 1000.0
"""Median distances from the middle of the cameras beyond which a camera or a point is nowhere."""
_MIN_FOCAL, _MAX_FOCAL, _MAX_DISTORTION = 0.1, 10.0, 1.0
# Shares of the longer side, and the first coefficient: COLMAP's own limits.


def outlier_limit_px(model: Any) -> float:
    """Return the work pixels from which on a sighting is left out."""
    model.update_point_3d_errors()
    errors = [point.error for point in model.points3D.values() if np.isfinite(point.error)]
    return min(MOST_PX, max(OUTLIER_PX, OUTLIER_MEDIANS * float(np.median(errors)) if errors else 0.0))


def drop_unusable(model: Any) -> list[str]:
    """Take out sightings, points and cameras that cannot be, and return the names of the images left out.

    Points: not finite, behind a camera that sees them, further than `outlier_limit_px` from where they are
    seen, far off, or seen from one direction only. Cameras: not finite, far off, with a lens that cannot be,
    or with fewer than `MIN_SIGHTINGS` points left.
    """
    dropped: list[str] = []
    # Each camera that goes takes sightings along, which may leave others without support.
    for _ in range(1 + model.num_reg_images()):
        _drop_points(model)
        wrong = _wrong_frames(model)
        if not wrong:
            break
        dropped += [model.image(image).name for image in _images_of(model, wrong)]
        for frame in wrong:
            model.deregister_frame(frame)
    model.update_point_3d_errors()
    return sorted(dropped)


def _drop_points(model: Any) -> None:
    manager = pycolmap.ObservationManager(model)
    far = _far_off({number: point.xyz for number, point in model.points3D.items()}, model)
    for number in far:
        manager.delete_point3D(number)
    manager.filter_observations_with_negative_depth()
    manager.filter_all_points3D(outlier_limit_px(model), MIN_ANGLE_DEG)


def _wrong_frames(model: Any) -> set[int]:
    manager = pycolmap.ObservationManager(model)
    wrong = set(manager.filter_frames(_MIN_FOCAL, _MAX_FOCAL, _MAX_DISTORTION, MIN_SIGHTINGS))
    centres = {number: model.image(number).projection_center() for number in model.reg_image_ids()}
    return wrong | {model.image(number).frame_id for number in _far_off(centres, model)}


def _images_of(model: Any, frames: set[int]) -> list[int]:
    return [number for number in model.reg_image_ids() if model.image(number).frame_id in frames]


def _far_off(places: dict[int, Float64[ndarray, " 3"]], model: Any) -> list[int]:
    """Return the numbers of places that are not finite, or too far from the middle of the cameras."""
    centres = np.array([model.image(number).projection_center() for number in model.reg_image_ids()])
    centres = centres[np.isfinite(centres).all(axis=-1)] if len(centres) else centres
    if not len(centres) or not places:
        return []
    middle = np.median(centres, axis=0)
    reach = float(np.median(np.linalg.norm(centres - middle, axis=-1)))
    distances = np.array([np.abs(np.asarray(place) - middle).max() for place in places.values()])
    # Comparisons with NaN are false. Cameras in one place have no reach, and nothing to compare with.
    sound = distances <= FAR * reach if reach > 0.0 else np.isfinite(distances)
    return [number for number, good in zip(places, sound, strict=True) if not good]
