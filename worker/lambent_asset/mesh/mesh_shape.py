"""The mesh of an export: extracted, settled, simplified and closed."""

from dataclasses import dataclass

import numpy as np
from flashcache.config import ExportConfig
from flashcache.physical.model import InverseModel
from lambent_core.scene import View
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lambent_asset.mesh.mesh import Corner, Mesh, data_resolution, extract_mesh
from lambent_asset.mesh.mesh_decimation import TOLERANCE_CELLS, adapted, reduced
from lambent_asset.mesh.mesh_settling import settled_mesh
from lambent_asset.mesh.mesh_unseen import closed_smoothly, unseen_vertices

KEPT_CELLS = 0.1
"""Tolerance in cells when triangles are saved where the unseen part became smooth."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A mesh, and which of its vertices no photograph shows."""

    mesh: Mesh
    unseen: NDArray[np.bool_]
    error: float
    """Distance from the fine mesh that `mesh_decimation.adapted` states, scene units."""


def build_shape(
    model: InverseModel,
    config: ExportConfig,
    box: tuple[Corner, Corner],
    *,
    pixel_size: float,
    views: tuple[View, ...],
) -> Shape:
    """Return the mesh of the matter in `box` with about `config.faces` triangles, or as many as it needs.

    `pixel_size` as in `data_resolution`; `views` are the photographs it was trained with. Without views, all
    counts as seen. Raises WorkerError where there is no surface.
    """
    low, high = box
    resolution = data_resolution(model, low, high, pixel_size=pixel_size, limit=config.mesh_resolution)
    fine = settled_mesh(model, extract_mesh(model, low, high, resolution))
    if config.faces:
        mesh, error = reduced(fine, config.faces)
    else:
        mesh, error = adapted(fine, config.max_faces, TOLERANCE_CELLS * fine.cell)
    mesh, unseen = closed_smoothly(mesh, unseen_vertices(mesh, views))
    if not config.faces and unseen.any() and not unseen.all():
        fewer, more = adapted(mesh, config.max_faces, KEPT_CELLS * mesh.cell)
        _, nearest = cKDTree(mesh.vertices).query(fewer.vertices)
        mesh, unseen, error = fewer, unseen[nearest], error + more
    return Shape(mesh, unseen, error)
