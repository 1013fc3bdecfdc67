"""Compares few points of all pairs of photographs: which are worth a closer look, and what stands still.

Matching all points of all pairs takes most of the time, and four times as long for twice the photographs. The
few hundred clearest points of each cost a fiftieth of that and tell which pairs show the same.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int
from numpy import ndarray

from lambent_capture.poses.features import Features

MAX_RATIO = 0.8
"""Of the distance to the best match over that to the second best (Lowe 2004)."""
STILL_SHARE, STILL_PX = 0.002, 1.0
"""Of the longer side, or work pixels if that is more, that a point which stands still may seem to move."""
GRID = 4
"""Cells along each side of the picture; a background fills several, a date stamp one or two."""
STILL_CELLS, STILL_MATCHES = 3, 8
"""Cells and matches that a pair with a standing background has at least."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Survey:
    """Matches among the clearest points of all pairs; symmetric, zero on the diagonal."""

    moved: Int[ndarray, "photographs photographs"]
    """Matches at different places of the two pictures."""
    still: Int[ndarray, "photographs photographs"]
    """Matches at the same place."""
    still_cells: Int[ndarray, "photographs photographs"]
    """Cells of the picture, of `GRID` x `GRID`, with matches at the same place."""

    @property
    def still_share(self) -> float:
        """Return the share of the other photographs with which a photograph shares a standing background.

        The median of all photographs: 0 for a camera that is carried around, 1 for one on a tripod.
        """
        if len(self.still) < 2:
            return 0.0
        stands = (self.still_cells >= STILL_CELLS) & (self.still >= STILL_MATCHES)
        return float(np.median(stands.sum(axis=1) / (len(stands) - 1)))


def survey(
    features: Sequence[Features],
    sides: Sequence[float],
    num_clear: int,
    told: Callable[[int, int], None] = lambda done, total: None,
) -> Survey:
    """Return how many of the `num_clear` clearest points each pair has in common.

    `sides` are the longer sides of the photographs in work pixels.
    `told` is called with the number of pairs that were compared, of how many.
    """
    count = len(features)
    clear = [_clearest(one, num_clear) for one in features]
    moved, still, cells = (np.zeros((count, count), int) for _ in range(3))
    total = count * (count - 1) // 2
    done = 0
    stacked = np.concatenate([descriptors for _, descriptors in clear]) if clear else np.zeros((0, 128))
    ends = np.cumsum([len(descriptors) for _, descriptors in clear])
    for first in range(count):
        told(done, total)
        # One large product for all partners: many small ones take several times as long.
        likeness = clear[first][1] @ stacked[ends[first] :].T
        for second in range(first + 1, count):
            columns = slice(ends[second - 1] - ends[first], ends[second] - ends[first])
            matches = mutual_matches(likeness[:, columns])
            here, there = clear[first][0][matches[:, 0]], clear[second][0][matches[:, 1]]
            stands = np.linalg.norm(here - there, axis=1) < max(STILL_PX, STILL_SHARE * sides[first])
            places = np.floor(here[stands] * (GRID / sides[first])).astype(int)
            for table, value in (
                (moved, int((~stands).sum())),
                (still, int(stands.sum())),
                (cells, len(np.unique(places, axis=0))),
            ):
                table[first, second] = table[second, first] = value
        done += count - 1 - first
    told(done, total)
    return Survey(moved=moved, still=still, still_cells=cells)


def mutual_matches(likeness: Float32[ndarray, "points others"]) -> Int[ndarray, "matches 2"]:
    """Return the indices of points that are each other's best match, and clearly so.

    `likeness` are the products of descriptors of unit length.
    """
    if min(likeness.shape) < 2:
        return np.zeros((0, 2), int)
    likeness = likeness.copy()
    rows, best = np.arange(len(likeness)), likeness.argmax(axis=1)
    nearest = likeness[rows, best]
    is_back = nearest == likeness.max(axis=0)[best]
    likeness[rows, best] = -1.0
    second = likeness.max(axis=1)
    # Squared distance of unit vectors: 2 - 2 cos.
    clear = (1.0 - nearest) < MAX_RATIO**2 * (1.0 - second)
    kept = clear & is_back
    return np.stack([rows[kept], best[kept]], axis=1)


def choose_pairs(
    likeness: Int[ndarray, "photographs photographs"], names: Sequence[str], per_photograph: int
) -> list[tuple[int, int]]:
    """Return the pairs worth matching, those that are most alike first.

    These are, for each photograph, the `per_photograph` most alike and its two neighbours on each side in the
    order of names; and the pairs that connect all photographs with each other as well as any can.
    """
    count = len(names)
    if count < 2:
        return []
    chosen = _spanning_pairs(likeness)
    order = sorted(range(count), key=lambda i: natural_key(names[i]))
    for step in (1, 2):
        chosen |= {_pair(a, b) for a, b in zip(order, order[step:], strict=False)}
    for one in range(count):
        best = np.argsort(-likeness[one], kind="stable")
        others = [int(other) for other in best if other != one]
        chosen |= {_pair(one, other) for other in others[:per_photograph]}
    return sorted(chosen, key=lambda pair: (-likeness[pair], pair))


def natural_key(name: str) -> list[tuple[int, int | str]]:
    """Return a key that sorts IMG_9 before IMG_10."""
    parts = re.findall(r"\d+|\D+", name)
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts]


def _clearest(features: Features, number: int) -> tuple[Float32[ndarray, "n 2"], Float32[ndarray, "n 128"]]:
    chosen = slice(0, number)
    descriptors = features.descriptors[chosen].astype(np.float32)
    lengths = np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-6)
    return features.points[chosen, :2], descriptors / lengths


def _spanning_pairs(likeness: Int[ndarray, "photographs photographs"]) -> set[tuple[int, int]]:
    """Return the pairs of a tree over all photographs with the greatest likeness (Prim's algorithm)."""
    count = len(likeness)
    inside = np.zeros(count, bool)
    inside[0] = True
    best, link = likeness[0].copy(), np.zeros(count, int)
    chosen = set()
    for _ in range(count - 1):
        new = int(np.where(inside, -1, best).argmax())
        chosen.add(_pair(int(link[new]), new))
        inside[new] = True
        closer = likeness[new] > best
        best[closer], link[closer] = likeness[new][closer], new
    return chosen


def _pair(one: int, other: int) -> tuple[int, int]:
    return (one, other) if one < other else (other, one)
