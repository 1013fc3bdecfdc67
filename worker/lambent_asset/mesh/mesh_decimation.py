"""Fewer triangles for the same surface, as many as a tolerance asks for."""

import fast_simplification
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lambent_asset.mesh.mesh import Mesh, compact, crosses_of

TOLERANCE_CELLS = 0.3
"""Distance of the fine mesh from the simplified one that is accepted, in cells.

A cell is at least half a pixel of the photographs; noise of the density is about as large."""
TOLERATED_SHARE = 0.99
"""Share of the fine mesh's vertices that keep the tolerance."""
NUM_CHECKED = 20_000
"""Vertices at which the distance is measured."""
FEWEST_FACES = 500
"""Where the search for a number of triangles begins, and no scene needs fewer."""
STEP = 1.15
"""The search ends when it knows the number of triangles within this factor."""
CANDIDATES = 4
"""Triangles near a vertex to which its distance is computed."""
SEED = 0


def simplified(mesh: Mesh, max_faces: int) -> Mesh:
    """Return the mesh simplified to about `max_faces` triangles or fewer.

    Quadric error collapse; triangles without area are dropped, and pairs of triangles with the same corners,
    to which a thin fold collapses.
    """
    vertices: NDArray[np.floating] = mesh.vertices
    faces: NDArray[np.integer] = mesh.faces
    if len(faces) > max_faces:
        vertices, faces = fast_simplification.simplify(
            np.ascontiguousarray(vertices), np.ascontiguousarray(faces), target_count=max_faces
        )
    area = np.linalg.norm(crosses_of(vertices, faces), axis=1)
    vertices, faces = compact(vertices, without_folded_pairs(faces[area > 1e-6 * mesh.cell**2]))
    return Mesh(vertices.astype(np.float32), faces.astype(np.int32), mesh.cell)


def without_folded_pairs(faces: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return `faces` without those that share all three corners with another."""
    _, same, counts = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
    return faces[counts[same.reshape(-1)] == 1]


def adapted(mesh: Mesh, max_faces: int, tolerance: float) -> tuple[Mesh, float]:
    """Return the mesh with as few triangles as keep a tolerance, at most `max_faces`, and its distance.

    The distance is that of `distance_to_surface` within which `TOLERATED_SHARE` of the vertices of `mesh`
    lie, scene units; `tolerance` is what it may be. It is larger where `max_faces` are not enough.
    """

    most = min(max_faces, len(mesh.faces))
    best, error = reduced(mesh, most)
    low, high = min(FEWEST_FACES, most), most
    # Distances fall with the number of triangles, nearly always; where they do not, more triangles are kept.
    while error <= tolerance and high > STEP * low:
        middle = int(np.sqrt(float(low) * high))
        fewer, distance = reduced(mesh, middle)
        if distance <= tolerance:
            best, error, high = fewer, distance, middle
        else:
            low = middle
    return best, error


def reduced(mesh: Mesh, num_faces: int) -> tuple[Mesh, float]:
    """Return the mesh with about `num_faces` triangles, and its distance as in `adapted`."""
    fewer = simplified(mesh, num_faces)
    random = np.random.default_rng(SEED)
    some = random.choice(len(mesh.vertices), min(NUM_CHECKED, len(mesh.vertices)), replace=False)
    away = distance_to_surface(mesh.vertices[some], fewer)
    return fewer, float(np.quantile(away, TOLERATED_SHARE))


def distance_to_surface(points: NDArray[np.floating], mesh: Mesh) -> NDArray[np.float64]:
    """Return the distance of each point from the surface of `mesh`, scene units.

    The nearest triangle is looked for among those with sample points near by, so that the result is too large
    rather than too small.
    """
    corners = np.asarray(mesh.vertices, np.float64)[mesh.faces]
    points = np.asarray(points, np.float64)
    samples, owner = _samples(corners)
    _, nearest = cKDTree(samples).query(points, k=min(CANDIDATES, len(samples)))
    faces = owner[nearest.reshape(len(points), -1)]
    away = [_distance_to_triangles(points, corners[faces[:, k]]) for k in range(faces.shape[1])]
    return np.min(away, axis=0)


def _samples(
    corners: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
    """Return points of triangles, all of the same density but one at least in each, and whose they are."""
    random = np.random.default_rng(SEED)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    count = 4 * len(corners) + 4 * NUM_CHECKED
    owner = np.repeat(
        np.arange(len(corners)), np.ceil(count * area / max(area.sum(), 1e-300)).astype(int) + 1
    )
    u = random.random((len(owner), 2))
    u[u.sum(axis=1) > 1.0] = 1.0 - u[u.sum(axis=1) > 1.0]
    a, b, c = (corners[owner, k] for k in range(3))
    return a + u[:, :1] * (b - a) + u[:, 1:] * (c - a), owner


def _distance_to_triangles(
    points: NDArray[np.floating], corners: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return the distance of each point from its triangle [point, 3, 3]: from its plane, or its edges."""
    a, b, c = (corners[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    squared = np.maximum((normal * normal).sum(-1), 1e-300)
    inside = np.ones(len(points), bool)
    edges = np.full(len(points), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        along = end - start
        inside &= (np.cross(along, points - start) * normal).sum(-1) >= 0.0
        share = ((points - start) * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-300)
        nearest = start + share.clip(0.0, 1.0)[:, None] * along
        edges = np.minimum(edges, np.linalg.norm(points - nearest, axis=1))
    plane = np.abs(((points - a) * normal).sum(-1)) / np.sqrt(squared)
    return np.where(inside, plane, edges)
