"""Measures a capture: from its description and its pictures to figures and thumbnails."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from lambent_proto.v1 import capture_pb2, scene_pb2
from numpy import ndarray

from lambent_capture.arrays import Points, Vector
from lambent_capture.checks.agreement import compare
from lambent_capture.checks.brightness import (
    deviation_from_neighbours,
    relative_exposure,
    surface_luminance,
)
from lambent_capture.checks.hull import HullVotes, carve, footprint, tolerated_views
from lambent_capture.checks.limits import CaptureLimits
from lambent_capture.checks.observe import Observation, observe
from lambent_capture.checks.sphere import angles_deg, largest_gap, unit_directions
from lambent_capture.scenes.extent import camera_axes, looked_at_point
from lambent_capture.scenes.silhouettes import Silhouette

SCHEMA_VERSION = "1.0"


@dataclass(frozen=True, slots=True)
class Examination:
    """The result of `examine_capture`."""

    figures: capture_pb2.CaptureFigures
    thumbnails: Mapping[str, str]
    """JPEG in base64 by name of the frame."""
    portrait: str = ""
    """The picture by which people recognise the capture, JPEG in base64."""


def examine_capture(
    folder: Path,
    manifest: scene_pb2.SceneManifest,
    limits: CaptureLimits,
    announce: Callable[[str], None] = lambda path: None,
) -> Examination:
    """Return the measurements of a usable capture.

    `announce` is called with the path of each file before it is decoded, and with "" once none is. Raises
    `PictureError` for a picture that cannot be read; `inspect_files` has found those.
    """
    observations = observe(folder, manifest, limits, announce)
    announce("")
    return Examination(
        figures=measure(observations, manifest, limits),
        thumbnails={each.frame.name: each.thumbnail for each in observations},
        portrait=next((each.portrait for each in observations), ""),
    )


def measure(
    observations: Sequence[Observation], manifest: scene_pb2.SceneManifest, limits: CaptureLimits
) -> capture_pb2.CaptureFigures:
    """Return the figures of pictures that have been read."""
    figures = capture_pb2.CaptureFigures(schema_version=SCHEMA_VERSION)
    for each in observations:
        _add_view(figures, each)
    _measure_sharpness(figures, observations)
    figures.has_masks = bool(observations) and float(np.mean([each.has_mask for each in observations])) > 0.5
    centre = _measure_silhouettes(figures, observations, manifest, limits) if figures.has_masks else None
    if centre is None:
        centre = looked_at_point(*camera_axes(list(manifest.frames)))
    _measure_sphere(figures, observations, np.zeros(3) if centre is None else centre)
    return figures


def _add_view(figures: capture_pb2.CaptureFigures, seen: Observation) -> None:
    mask = seen.mask
    border = np.concatenate([mask[0], mask[-1], mask[1:-1, 0], mask[1:-1, -1]])
    figures.views.add(
        name=seen.frame.name,
        split=seen.frame.split,
        mask_share=float(mask.mean()),
        border_share=float(border.mean()) if seen.has_mask else 0.0,
        moved_share=1.0,
        pictures=[
            capture_pb2.PictureFigures(light=each.light, path=each.path, clipped_share=each.clipped_share)
            for each in seen.pictures
        ],
    )


def _measure_sharpness(figures: capture_pb2.CaptureFigures, observations: Sequence[Observation]) -> None:
    details = [picture.detail for each in observations for picture in each.pictures if picture.detail > 0.0]
    sharpest = float(np.percentile(details, 75)) if details else 0.0
    for view, each in zip(figures.views, observations, strict=True):
        for row, picture in zip(view.pictures, each.pictures, strict=True):
            row.sharpness = picture.detail / sharpest if sharpest > 0.0 else 0.0


def _measure_sphere(
    figures: capture_pb2.CaptureFigures, observations: Sequence[Observation], centre: Vector
) -> None:
    positions = np.array([each.camera.position for each in observations]).reshape(-1, 3)
    directions = unit_directions(positions, centre)
    azimuth, elevation = angles_deg(directions)
    for index, view in enumerate(figures.views):
        view.azimuth_deg, view.elevation_deg = float(azimuth[index]), float(elevation[index])
        view.distance = float(np.linalg.norm(positions[index] - centre))
    trained = np.array([each.frame.split == scene_pb2.SPLIT_TRAIN for each in observations], dtype=bool)
    figures.num_train_views = int(trained.sum())
    if not trained.any():
        return
    upper = largest_gap(directions[trained], lowest_deg=0.0)
    figures.gap_deg = largest_gap(directions[trained], lowest_deg=-90.0).radius_deg
    figures.upper_gap_deg = upper.radius_deg
    figures.upper_gap_azimuth_deg = upper.azimuth_deg
    figures.upper_gap_elevation_deg = upper.elevation_deg
    figures.lowest_elevation_deg = float(elevation[trained].min())
    figures.highest_elevation_deg = float(elevation[trained].max())


def _measure_silhouettes(
    figures: capture_pb2.CaptureFigures,
    observations: Sequence[Observation],
    manifest: scene_pb2.SceneManifest,
    limits: CaptureLimits,
) -> Vector | None:
    """Fill in what the silhouettes say of each other; return the middle of their hull, if they have one."""
    silhouettes = [Silhouette(each.camera, each.mask) for each in observations]
    if len(silhouettes) < limits.min_views_for_hull:
        return None
    low, high = np.array(manifest.bounds.minimum), np.array(manifest.bounds.maximum)
    margin = 0.5 * (limits.box_margin - 1.0) * (high - low)
    tolerated = tolerated_views(len(silhouettes), limits.tolerated_share)
    hull = carve(silhouettes, low - margin, high + margin, cells=limits.hull_cells, tolerated=tolerated)
    cells = None if hull is None else hull.cells(hull.against(), tolerated)
    if hull is None or cells is None or not cells.any():
        return None
    figures.has_hull = True
    agreements = compare(
        hull,
        silhouettes,
        tolerated=tolerated,
        unexplained_limit=limits.unexplained_share,
    )
    for view, agreement in zip(figures.views, agreements, strict=True):
        for name, value in asdict(agreement).items():
            setattr(view, name, value)
    points = hull.points[cells]
    figures.outside_box_share = _outside_box(silhouettes, points, hull.spacing, low, high)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    _measure_exposure(figures, observations, hull, cells, centre)
    return centre


def _outside_box(
    silhouettes: Sequence[Silhouette], points: Points, spacing: float, low: Vector, high: Vector
) -> float:
    """Return the share of a silhouette that only cells outside of the box explain, median over the views.

    The hull itself may bulge out of the box where views are few; what silhouettes show may not.
    """
    beyond = ((points < low - spacing) | (points > high + spacing)).any(axis=1)
    if not beyond.any():
        return 0.0
    shares = []
    for each in silhouettes:
        lost = footprint(each.camera, points[beyond], spacing) & each.mask
        if lost.any():
            lost &= ~footprint(each.camera, points[~beyond], spacing)
        shares.append(float(lost.sum() / max(each.mask.sum(), 1)))
    return float(np.median(shares))


def _measure_exposure(
    figures: capture_pb2.CaptureFigures,
    observations: Sequence[Observation],
    hull: HullVotes,
    cells: ndarray,
    centre: Vector,
) -> None:
    ranges = []
    for light in sorted({picture.light for each in observations for picture in each.pictures}):
        lit = [
            (index, row, picture)
            for index, each in enumerate(observations)
            for row, picture in enumerate(each.pictures)
            if picture.light == light
        ]
        cameras = [observations[index].camera for index, _, _ in lit]
        seen = surface_luminance(
            hull,
            cells,
            cameras,
            [picture.luminance for _, _, picture in lit],
            [observations[index].coverage for index, _, _ in lit],
        )
        exposures = relative_exposure(seen)
        offsets = exposures.offsets
        directions = unit_directions(np.array([camera.position for camera in cameras]), centre)
        jumps = deviation_from_neighbours(offsets, directions)
        for (index, row, _), offset, jump in zip(lit, offsets, jumps, strict=True):
            figures.views[index].pictures[row].exposure_ev = float(offset)
            figures.views[index].pictures[row].exposure_jump_ev = float(jump)
        for (index, _, _), mismatch in zip(lit, exposures.mismatch, strict=True):
            figures.views[index].mismatch_ev = max(figures.views[index].mismatch_ev, float(mismatch))
        low, high = np.percentile(offsets, [5.0, 95.0])
        ranges.append(float(high - low))
    figures.exposure_range_ev = max(ranges, default=0.0)
