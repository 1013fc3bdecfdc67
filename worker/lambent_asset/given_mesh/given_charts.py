"""The texture coordinates of an edited mesh where they are an atlas, and new ones where they are not."""

import numpy as np
from jaxtyping import Int
from lambent_relight.baked.raster import rasterise_uv
from numpy import ndarray

from lambent_asset.given_mesh.glb_file import GivenMesh
from lambent_asset.mesh.atlas import Unwrapped, covered_share, size_within, unwrap
from lambent_asset.mesh.mesh import Mesh, piece_of_face

MOST_OVERLAP = 0.02
"""Share of the charts' area that may lie on other charts in an atlas that is kept."""
MOST_TOUCHING = 0.002
"""Share of the covered texels that may touch a texel of another chart in an atlas that is kept."""
LEAST_COVERAGE = 0.02
"""Share of an atlas that is kept, that charts must cover: less wastes nearly all texels."""


def charts_of(given: GivenMesh, size: int) -> tuple[Unwrapped, bool]:
    """Return the file's charts if they are an atlas, else new ones, and whether they are the file's.

    `size` is that of baked transport, in texels. Raises WorkerError `export.atlas` where unwrapping fails.
    """
    if all(given.has_uv) and given.uv.min() >= 0.0 and given.uv.max() <= 1.0:
        own = Unwrapped(np.arange(len(given.vertices)), given.faces, given.uv)
        area = covered_share(given.uv, given.faces)
        fragments = rasterise_uv(given.uv, given.faces, size)
        # Texels are counted by their centres: the error is far below the margin at 16 texels a side and more.
        whole = area >= LEAST_COVERAGE and float(fragments.covered.mean()) >= (1.0 - MOST_OVERLAP) * area
        if whole and touching_share(given, size_within(own, size)) <= MOST_TOUCHING:
            return own, True
    advice = (
        "raise export.transport_size, decimate the mesh, or give it texture coordinates that are an atlas"
    )
    return unwrap(Mesh(given.vertices, given.faces, 0.0), size, advice=advice), False


def touching_share(given: GivenMesh, size: int) -> float:
    """Return the share of an atlas's covered texels, `size` a side, that touch another chart's.

    What is read between two such texels is a mixture of two places of the surface.
    """
    chart = chart_of_face(given)
    face = rasterise_uv(given.uv, given.faces, size).face
    number = np.where(face >= 0, chart[face], -1)
    beside = np.zeros(number.shape, bool)
    for axis in (0, 1):
        first, second = (np.take(number, range(k, size - 1 + k), axis=axis) for k in (0, 1))
        differs = (first >= 0) & (second >= 0) & (first != second)
        lower, upper = (slice(None),) * axis + (slice(0, -1),), (slice(None),) * axis + (slice(1, None),)
        beside[lower] |= differs
        beside[upper] |= differs
    return float(beside.sum()) / max(1, int((face >= 0).sum()))


def chart_of_face(given: GivenMesh) -> Int[ndarray, " faces"]:
    """Return the chart of each triangle: what hangs together on the surface and in the atlas at once."""
    _, corner = np.unique(np.concatenate([given.vertices, given.uv], axis=1), axis=0, return_inverse=True)
    corner = corner.reshape(-1)
    return piece_of_face(int(corner.max()) + 1, corner[given.faces].astype(np.int64))
