"""The visual hull: the space that remains when every view cuts away what its silhouette does not cover."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray
from scipy import ndimage

from lambent_capture.arrays import Points, Region, Vector
from lambent_capture.scenes.picture_camera import PictureCamera
from lambent_capture.scenes.silhouettes import Silhouette

COARSE_CELLS = 40


@dataclass(frozen=True, kw_only=True, slots=True)
class HullVotes:
    """The votes of all silhouettes on the cells of a grid."""

    points: Points
    """Centres of the cells, in the order of an array of `shape`."""
    shape: tuple[int, int, int]
    spacing: float
    """Side of a cell, scene units."""
    outside: Bool[ndarray, "views points"]
    """Whether a view says that the cell is not the object."""
    inside: Int[ndarray, " points"]
    """How many views have the cell in their silhouette."""
    min_inside: int
    """Views that must show a cell inside before it can belong to the hull."""

    def against(self, trusted: Bool[ndarray, " views"] | None = None) -> Int[ndarray, " points"]:
        """Return the number of views that contradict each cell; only those in `trusted` where it is given."""
        used = range(len(self.outside)) if trusted is None else np.flatnonzero(trusted)
        count = np.zeros(self.outside.shape[1], dtype=np.int32)
        for view in used:
            count += self.outside[view]
        return count

    def cells(
        self, against: Int[ndarray, " points"], tolerated: int, without: int | None = None
    ) -> Bool[ndarray, " points"]:
        """Return the cells that at most `tolerated` of the votes `against` contradict.

        The vote of the view `without`, which must be among them, is taken off.
        """
        own = 0 if without is None else self.outside[without]
        return (against - own <= tolerated) & (self.inside >= self.min_inside)


def tolerated_views(num_views: int, share: float) -> int:
    """Return the number of views that may contradict a cell of a hull robust to single wrong views."""
    return max(1, round(num_views * share))


def carve(
    silhouettes: Sequence[Silhouette], low: Vector, high: Vector, *, cells: int, tolerated: int
) -> HullVotes | None:
    """Return the hull of `silhouettes` on a grid of `cells` along the longest side of what they leave over.

    It is looked for in the box from `low` to `high` (scene units); None where nothing of that box is left.
    A picture contradicts a cell outside it only if the whole silhouette is in the picture; a third
    of the views must show a cell inside.
    """
    coarse = _votes(silhouettes, low, high, COARSE_CELLS, widened=True)
    left = coarse.cells(coarse.against(), tolerated)
    if not left.any():
        return None
    kept = coarse.points[left]
    return _votes(
        silhouettes,
        np.maximum(kept.min(axis=0) - 1.5 * coarse.spacing, low),
        np.minimum(kept.max(axis=0) + 1.5 * coarse.spacing, high),
        cells,
        widened=False,
    )


def _votes(
    silhouettes: Sequence[Silhouette], low: Vector, high: Vector, cells: int, *, widened: bool
) -> HullVotes:
    """Return the votes; `widened` silhouettes cover all cells they touch, not only centres."""
    spacing = float((high - low).max()) / cells
    counts = np.maximum(np.ceil((high - low) / spacing - 1e-6).astype(int), 1)
    axes = [start + (np.arange(count) + 0.5) * spacing for start, count in zip(low, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    middle = points.mean(axis=0)
    outside = np.zeros((len(silhouettes), len(points)), dtype=bool)
    inside = np.zeros(len(points), dtype=np.int32)
    for view, silhouette in enumerate(silhouettes):
        mask = silhouette.mask
        if widened:
            radius = 0.9 * spacing * silhouette.camera.pixels_per_unit(middle)
            mask = grown(mask, int(np.ceil(radius)))
        shown, index, depth = silhouette.camera.pixels(points)
        covered = mask.ravel()[index]
        outside[view] = shown & ~covered
        if not touches_border(silhouette.mask):
            # The whole object is in the picture, so anything outside the picture is not the object.
            outside[view] |= ~shown & (depth > 0.0)
        inside += shown & covered
    return HullVotes(
        points=points,
        shape=(int(counts[0]), int(counts[1]), int(counts[2])),
        spacing=spacing,
        outside=outside,
        inside=inside,
        min_inside=max(2, len(silhouettes) // 3),
    )


def touches_border(mask: Region) -> bool:
    """Return whether the mask reaches an edge of the picture, so that the object may continue beyond it."""
    return bool(mask[[0, -1]].any() or mask[:, [0, -1]].any())


def grown(mask: Region, pixels: int) -> Region:
    """Return the mask grown by some pixels in all eight directions."""
    if pixels <= 0:
        return mask
    return ndimage.maximum_filter(mask, size=2 * pixels + 1, mode="constant")


def footprint(camera: PictureCamera, points: Points, spacing: float) -> Region:
    """Return the pixels that cells at `points` may cover, at least one pixel wider than their centres."""
    seen = np.zeros(camera.width * camera.height, dtype=bool)
    shown, index, _ = camera.pixels(points)
    seen[index[shown]] = True
    mask = seen.reshape(camera.height, camera.width)
    if not shown.any():
        return mask
    radius = 0.5 * spacing * camera.pixels_per_unit(points.mean(axis=0))
    return grown(mask, max(1, int(np.ceil(radius))))
