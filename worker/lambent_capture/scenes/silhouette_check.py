"""Uses the masks of a capture: to see whether its poses agree with them, and to find the object's box."""

from pathlib import Path

import numpy as np
from lambent_proto.v1 import scene_pb2

from lambent_capture.pictures.coverage import has_coverage, small_coverage
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.problems import Problems
from lambent_capture.scenes.extent import set_fitted_box
from lambent_capture.scenes.silhouettes import (
    AGREEMENT,
    MASK_SIDE,
    SINGLE_AGREEMENT,
    Hull,
    Silhouette,
    carve,
    explained,
    other_convention,
    silhouette_of,
)
from lambent_capture.scenes.world import settle

MAX_VIEWS = 40
MIN_VIEWS = 8
"""Fewer silhouettes than this leave too much room to say anything."""
MISFIT_SHARE = 0.25
"""Share of the frames that may disagree before it is more than a matter of single frames."""
MARGIN = 0.05
"""Added to each side of the box, as a share of its longest side."""


def training_silhouettes(
    folder: Path, manifest: scene_pb2.SceneManifest, problems: Problems
) -> list[Silhouette]:
    """Return the silhouettes of up to 40 training frames, evenly chosen; those without a background left out.

    Pictures that cannot be opened are noted in `problems`.
    """
    frames = [frame for frame in manifest.frames if frame.split == scene_pb2.SPLIT_TRAIN]
    chosen = sorted({round(i) for i in np.linspace(0, len(frames) - 1, min(len(frames), MAX_VIEWS))})
    silhouettes = []
    for frame in (frames[i] for i in chosen):
        path = frame.mask or frame.images[0].path
        try:
            coverage = small_coverage(folder, frame, MASK_SIDE) if has_coverage(folder, frame) else None
        except PictureError as error:
            problems.error(error.code, f'{path} (frame "{frame.name}") {error}', path)
            continue
        if coverage is None:
            continue
        silhouette = silhouette_of(frame, coverage)
        if silhouette.mask.any() and not silhouette.mask.all():
            silhouettes.append(silhouette)
    return silhouettes


def check_silhouettes(views: list[Silhouette], problems: Problems) -> None:
    """Note in `problems` when poses and masks cannot both be right: of all frames, or of a few."""
    if len(views) < MIN_VIEWS:
        return
    shares = explained(views, carve(views))
    if np.median(shares) >= AGREEMENT and shares.min() >= SINGLE_AGREEMENT:
        return
    # One view may contradict this hull, or each would have carved away what shows that it is wrong.
    lenient = explained(views, carve(views, one_may_differ_from=MIN_VIEWS - 1))
    worst = views[int(shares.argmin())].name
    agreed = f'{np.floor(100.0 * np.median(shares)):.0f} % of their area only (worst: frame "{worst}")'
    convention = other_convention(views, better_than=float(lenient.mean()))
    if convention is not None:
        problems.error(
            "scene.axes_wrong",
            f"projected with these poses the masks agree on {agreed}, but on all of it when the poses are "
            f"read {convention.advice}",
            worst,
        )
        return
    misfits = [(view, share) for view, share in zip(views, lenient, strict=True) if share < SINGLE_AGREEMENT]
    if np.median(lenient) >= AGREEMENT and len(misfits) <= MISFIT_SHARE * len(views):
        for view, share in misfits:
            problems.warning(
                "scene.mask_disagrees",
                f'frame "{view.name}": only {100.0 * share:.0f} % of its mask lies where the other masks '
                "allow the object to be; its pose or its mask is wrong, fix it or leave the frame out",
                view.name,
            )
        return
    problems.warning(
        "scene.silhouettes_disagree",
        f"projected with these poses the masks agree on {agreed}; check that masks and poses belong together",
        worst,
    )


def fit_to_silhouettes(manifest: scene_pb2.SceneManifest, views: list[Silhouette]) -> bool:
    """Replace bounds guessed from the cameras by a box around what the masks show, and settle the world.

    Returns False, leaving everything as it is, where the capture fixes its box, where there are too few
    masks, or where poses and masks do not agree.
    """
    if manifest.bounds_from != "cameras" or len(views) < MIN_VIEWS:
        return False
    hull = carve(views)
    if np.median(explained(views, hull)) < AGREEMENT:  # a bad mask or two must not cut the object away
        hull = carve(views, one_may_differ_from=MIN_VIEWS - 1)
    if hull is None or np.median(explained(views, hull)) < AGREEMENT:
        return False
    low, high = _box_with_margin(hull)
    # Cameras all on one side leave a cone behind the object open: there the guess is kept.
    low = np.where(hull.open_low, np.maximum(low, manifest.bounds.minimum), low)
    high = np.where(hull.open_high, np.minimum(high, manifest.bounds.maximum), high)
    set_fitted_box(manifest, low, high)
    settle(manifest)
    return True


def _box_with_margin(hull: Hull) -> tuple[np.ndarray, np.ndarray]:
    low, high = hull.box
    margin = MARGIN * float((high - low).max())
    step = 0.01 * float((high - low).max())
    # Whole hundredths: the rest is the grid's, not the object's.
    return np.floor((low - margin) / step) * step, np.ceil((high + margin) / step) * step
