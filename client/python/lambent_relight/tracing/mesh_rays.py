"""Rays against the surface of a bundle: what is in the way of light, exactly.

A closed surface is met from outside only: a ray that starts a little below it, because materials and meshes
never agree on where it is, leaves through it and is not blocked by itself.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent_relight.tracing.hierarchy import Hierarchy, build_hierarchy
from lambent_relight.tracing.kernels import trace


@dataclass(frozen=True, eq=False)
class MeshHits:
    """The first faces in the way of rays."""

    face: NDArray[np.int32]
    """Number of the face, -1 where the ray is free, [ray]."""
    distance: NDArray[np.float32]
    """From the ray's origin, scene units; infinite where the ray is free, [ray]."""
    weights: NDArray[np.float32]
    """Of the face's corners at the hit, they sum to one, [ray, 3]."""

    @property
    def blocked(self) -> NDArray[np.bool_]:
        """Whether something is in the way, [ray]."""
        return self.face >= 0


class MeshRays:
    """Finds what rays meet on a mesh; several threads may ask at once."""

    def __init__(self, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        """Prepare `faces` [face, 3] over `vertices` [vertex, 3]: about a second for a million of them."""
        self.tree: Hierarchy = build_hierarchy(vertices, faces)
        self.one_sided = is_closed(vertices, faces)
        self.size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
        """Length of the box's diagonal, scene units."""

    def __call__(self, origin: NDArray[np.floating], direction: NDArray[np.floating]) -> MeshHits:
        """Return what rays from `origin` [ray, 3] along unit `direction` [ray, 3] meet first."""
        count = len(origin)
        face, distance = np.empty(count, np.int32), np.empty(count, np.float32)
        place = np.empty((count, 2), np.float32)
        rays = (np.ascontiguousarray(values, np.float32) for values in (origin, direction))
        trace(self.tree, self.one_sided, *rays, face, distance, place)
        weights = np.concatenate([1.0 - place.sum(axis=1, keepdims=True), place], axis=1)
        return MeshHits(face, distance, weights.astype(np.float32))


def is_closed(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> bool:
    """Return whether every edge has as many faces on one side as on the other.

    Vertices at the same place are one: an atlas doubles them along its seams.
    """
    _, number = np.unique(np.asarray(vertices, np.float32), axis=0, return_inverse=True)
    corners = number.reshape(-1)[faces].astype(np.int64)
    start, end = corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    _, edge = np.unique(low * (len(vertices) + 1) + high, return_inverse=True)
    balance = np.bincount(edge.reshape(-1), np.sign(end - start))
    return not balance.any()
