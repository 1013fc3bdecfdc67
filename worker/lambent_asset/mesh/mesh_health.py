"""Open edges and separate pieces of a mesh."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent_asset.mesh.mesh import piece_of_face


@dataclass(frozen=True, kw_only=True, slots=True)
class MeshHealth:
    """What keeps a mesh from being the border of a solid; all zero but `pieces` where nothing does."""

    boundary_edges: int
    """Edges of one triangle only: rims of holes."""
    non_manifold_edges: int
    """Edges of more than two triangles, or that two triangles run through in the same direction."""
    pieces: int
    """Connected pieces; things that do not touch are several."""

    @property
    def watertight(self) -> bool:
        """Whether the mesh encloses a volume."""
        return self.boundary_edges == 0 and self.non_manifold_edges == 0


def mesh_health(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> MeshHealth:
    """Return the edges and pieces of a mesh; vertices at the same place, as along seams, count as one."""
    _, same = np.unique(np.asarray(vertices, np.float32), axis=0, return_inverse=True)
    joined = same.reshape(-1)[faces].astype(np.int64)
    joined = joined[
        (joined[:, 0] != joined[:, 1]) & (joined[:, 1] != joined[:, 2]) & (joined[:, 2] != joined[:, 0])
    ]
    if not len(joined):
        return MeshHealth(boundary_edges=0, non_manifold_edges=0, pieces=0)
    count = int(joined.max()) + 1
    edges = np.concatenate([joined[:, [0, 1]], joined[:, [1, 2]], joined[:, [2, 0]]])
    forwards = edges[:, 0] < edges[:, 1]
    _, edge = np.unique(np.sort(edges, axis=1) @ np.array([count, 1]), return_inverse=True)
    uses = np.bincount(edge)
    turned = np.bincount(edge, weights=np.where(forwards, 1.0, -1.0))
    return MeshHealth(
        boundary_edges=int((uses == 1).sum()),
        non_manifold_edges=int(((uses > 2) | ((uses == 2) & (turned != 0.0))).sum()),
        pieces=len(np.unique(piece_of_face(count, joined))),
    )
