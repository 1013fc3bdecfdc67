"""The built-in estimate: tries several weightings of colours and views, and uses the most consistent one.

docs/benchmarks/masks.md has its accuracy.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from lambent_core.errors import SceneRefusedError
from lambent_core.measured import measured, significant
from PIL import Image
from scipy import ndimage

from lambent_capture.arrays import Grey, PerView, Reduced, Vector
from lambent_capture.checks.hull import carve, footprint, tolerated_views
from lambent_capture.masks.consensus import ConsensusSettings, Leaning, MaskView, agree
from lambent_capture.masks.evidence import lab_of, separation
from lambent_capture.masks.outline import refine_outline
from lambent_capture.masks.photograph import Photograph
from lambent_capture.pictures.picture import box_averaged
from lambent_capture.pictures.resample import reduced_size
from lambent_capture.problems import Problems
from lambent_capture.scenes.extent import looked_at_point
from lambent_capture.scenes.silhouettes import Silhouette

LEANINGS = (
    # Colours and edges alike: right for most captures.
    Leaning(colour=1.0, distance=1.0, most_hull=2.5, least_hull=4.0),
    # Edges more than colours: a plain background that shares its colour with the object.
    Leaning(colour=0.7, distance=1.5, most_hull=2.5, least_hull=4.0),
    # Views more than pictures: busy backgrounds, and metal that mirrors them.
    Leaning(colour=0.7, distance=0.4, most_hull=4.0, least_hull=6.0),
)


@dataclass(frozen=True, kw_only=True, slots=True)
class EstimateSettings:
    """Sizes, and thresholds below which an estimate is rejected."""

    consensus_side: int = 128
    """Longer side at which the views are brought to agree, pixels."""
    band: int = 2
    """Half the width of the band around the outline that is drawn anew, in pixels of `consensus_side`."""
    temperature: float = 0.005
    """Difference in consistency between two leanings at which the better one counts e times as much."""
    min_views: int = 8
    """With fewer views, almost any estimate is consistent."""
    min_consistency: float = 0.85
    """Least median overlap of a mask with what the others make of it. Estimates that are right reach 0.91 to
    0.96 on the benchmark scenes (true masks 0.95 to 0.96, limited by the size of the cells)."""
    min_explained: float = 0.93
    """Least median share of a mask that the others explain (0.97 to 1 where it is right)."""
    min_separation: float = 0.7
    """Least median chance that colours tell object from background, between views; 0.5 is none."""
    smallest_share: float = 0.003
    """Least share of the picture, median, that an object covers."""
    largest_share: float = 0.85
    tolerated_share: float = 0.08
    """Share of the views that may be wrong without spoiling the hull the others are judged by."""
    hull_cells: int = 48


@dataclass(frozen=True, kw_only=True, slots=True)
class Consistency:
    """Agreement of the masks with each other; one value per view."""

    overlap: PerView
    """Intersection over union of the mask and the hull of the others."""
    explained: PerView
    """Share of the mask that the hull of the others explains."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Masks with their reliability."""

    coverages: list[Grey]
    consistency: Consistency
    separation: PerView
    """How well colours separate object and background, 0.5 to 1; see `evidence.separation`."""


def estimate_masks(views: Sequence[MaskView], settings: EstimateSettings) -> Estimate:
    """Return where the object is in every view, at the size of its picture, by the agreement of views alone.

    Raises `SceneRefusedError` with `scene.mask_missing` where the views do not agree on an object.
    """
    if len(views) < settings.min_views:
        raise not_credible(too_few(len(views)))
    estimate = agreed_masks(views, settings)
    if isinstance(estimate, str):
        raise not_credible(estimate)
    reason = why_not_credible(estimate, settings)
    if reason:
        raise not_credible(reason)
    return estimate


def too_few(number: int) -> str:
    """Return the reason for refusing so few views."""
    return f"{number} views are too few to find the object by comparing them"


def agreed_masks(views: Sequence[MaskView], settings: EstimateSettings) -> Estimate | str:
    """Return where the object is in every view, credible or not; a reason where there is nothing at all."""
    small = [view.box_averaged(settings.consensus_side) for view in views]
    middle = middle_of(views)
    if isinstance(middle, str):
        return middle
    centre, distance = middle
    beliefs = _most_consistent(small, centre, distance, settings)
    if beliefs is None:
        return "the views have no object in common that differs from its background"
    coverages = []
    for view, reduced, belief in zip(views, small, beliefs, strict=True):
        grown = _enlarged(belief, (view.camera.width, view.camera.height))
        band = max(settings.band, round(settings.band * view.camera.width / reduced.camera.width))
        coverages.append(_clean(refine_outline(lab_of(view.image_srgb), grown, band)))
    consistency = consistency_of(coverages, views, centre, distance, settings)
    return Estimate(coverages, consistency, separation_of(small, coverages))


def _most_consistent(
    views: Sequence[MaskView], centre: Vector, distance: float, settings: EstimateSettings
) -> list[Grey] | None:
    """Return the beliefs of all leanings, mixed by how consistent each makes the views."""
    candidates, scores = [], []
    for leaning in LEANINGS:
        agreement = agree(views, centre, distance, leaning, ConsensusSettings())
        if agreement is None:
            continue
        beliefs = agreement.beliefs
        refined = [
            refine_outline(lab_of(view.image_srgb), belief, settings.band)
            for view, belief in zip(views, beliefs, strict=True)
        ]
        candidates.append(beliefs)
        scores.append(float(np.median(consistency_of(refined, views, centre, distance, settings).overlap)))
    if not candidates:
        return None
    weights = np.exp((np.array(scores) - max(scores)) / settings.temperature)
    weights /= weights.sum()
    return [
        np.sum([weight * beliefs[view] for weight, beliefs in zip(weights, candidates, strict=True)], axis=0)
        for view in range(len(views))
    ]


def consistency_of(
    coverages: Sequence[Grey],
    views: Sequence[MaskView],
    centre: Vector,
    distance: float,
    settings: EstimateSettings,
) -> Consistency:
    """Return the agreement of each mask with the hull of the others; zeros where they have none."""
    half = np.full(3, ConsensusSettings().reach * distance)
    silhouettes = []
    for view, coverage in zip(views, coverages, strict=True):
        size = reduced_size(view.camera.width, view.camera.height, settings.consensus_side)
        mask = box_averaged(coverage.astype(np.float32), size) >= 0.5
        silhouettes.append(Silhouette(view.camera.resized(*size), mask))
    tolerated = tolerated_views(len(views), settings.tolerated_share)
    hull = carve(silhouettes, centre - half, centre + half, cells=settings.hull_cells, tolerated=tolerated)
    if hull is None:
        return Consistency(overlap=np.zeros(len(views)), explained=np.zeros(len(views)))
    against = hull.against()
    overlap, explained = [], []
    for number, silhouette in enumerate(silhouettes):
        mask = silhouette.mask
        cells = hull.cells(against, tolerated, number)
        wide = footprint(silhouette.camera, hull.points[cells], hull.spacing)
        # Cells reach over the outline by about a pixel.
        seen = ndimage.binary_erosion(wide, border_value=1)
        overlap.append(float((mask & seen).sum() / max((mask | seen).sum(), 1)))
        explained.append(float((mask & wide).sum() / max(mask.sum(), 1)))
    return Consistency(overlap=np.array(overlap), explained=np.array(explained))


def separation_of(small: Sequence[MaskView], coverages: Sequence[Grey]) -> PerView:
    """Return how well colours separate masks of any size from their background; see `evidence.separation`."""
    reduced = [
        box_averaged(coverage.astype(np.float32), (view.camera.width, view.camera.height))
        for view, coverage in zip(small, coverages, strict=True)
    ]
    return separation([lab_of(view.image_srgb) for view in small], reduced)


def why_not_credible(estimate: Estimate, settings: EstimateSettings) -> str:
    """Return why the masks are not credible; empty where they are."""
    share = float(np.median([(coverage >= 0.5).mean() for coverage in estimate.coverages]))
    overlap = float(np.median(estimate.consistency.overlap))
    if not settings.smallest_share <= share <= settings.largest_share:
        return f"what was found covers {significant(100.0 * share, 2)} % of the pictures"
    explained = float(np.median(estimate.consistency.explained))
    if overlap < settings.min_consistency or explained < settings.min_explained:
        return (
            f"what was found overlaps by {measured(100.0 * overlap)} % with what the other views make of it, "
            f"at least {measured(100.0 * settings.min_consistency)} % are needed"
        )
    if np.median(estimate.separation) < settings.min_separation:
        return "what was found has no colours of its own; it looks like its background"
    return ""


def not_credible(reason: str, *, markable: bool = False) -> SceneRefusedError:
    """Return the refusal of a capture whose masks are not credible; `markable`: a person's marks may help."""
    mark = "mark the object on a few photographs (lambent masks --edit), " if markable else ""
    problems = Problems()
    problems.error(
        "scene.mask_missing",
        "no picture says where the object is, and it could not be found by comparing the views: "
        f"{reason}; {mark}cut the object out and save PNG with alpha, or give masks with --masks",
    )
    return SceneRefusedError.of(problems.findings())


def middle_of(views: Sequence[MaskView] | Sequence[Photograph]) -> tuple[Vector, float] | str:
    """Return the point the cameras look at and their distance from it, scene units; or why there is none."""
    positions = np.array([view.camera.position for view in views])
    centre = looked_at_point(positions, np.array([-view.camera.camera_to_world[:3, 2] for view in views]))
    if centre is None:
        return "the cameras do not look at a common point"
    return centre, float(np.median(np.linalg.norm(positions - centre, axis=-1)))


def _enlarged(belief: Grey, size: tuple[int, int]) -> Reduced:
    if (belief.shape[1], belief.shape[0]) == size:
        return belief
    image = Image.fromarray(belief.astype(np.float32))
    return np.asarray(image.resize(size, Image.Resampling.BICUBIC), dtype=np.float64).clip(0.0, 1.0)


def _clean(coverage: Grey) -> Grey:
    """Return the coverage without islands and holes of less than a thousandth of the object."""
    mask = coverage >= 0.5
    limit = 1e-3 * mask.sum()
    for value, parts in ((0.0, mask), (1.0, ~mask)):
        labels, number = ndimage.label(parts)
        sizes = np.bincount(labels.ravel(), minlength=number + 1)
        small = sizes < limit
        small[0] = False
        coverage = np.where(small[labels], value, coverage)
    return coverage
