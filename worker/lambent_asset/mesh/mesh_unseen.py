"""The part of a mesh that no photograph saw: which it is, and how it is closed smoothly.

What the trained density has there was asked for by no picture: dents, humps and shards, often around the
right place. They are evened out between the borders of what was seen.
"""

import numpy as np
from lambent_core.scene import View, evenly_spaced
from lambent_relight.baked.raster import rasterise
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import cg
from scipy.spatial import cKDTree

from lambent_asset.mesh.atlas import angle_weighted_normals, unit
from lambent_asset.mesh.mesh import Mesh, compact, edges_of, joined, piece_of_face
from lambent_asset.mesh.mesh_depth import relight_camera

MOST_VIEWS = 100
HIDDEN_CELLS = 1.0
"""A vertex this far behind what a picture shows, in cells, counts as shown."""
FINER = 2
"""Pixels of the pictures of the mesh along each side of a photograph's."""
LEAST_COSINE = 0.15
"""A surface is seen by a camera at a larger angle than this from its plane."""
LIKE_COSINE = 0.3
"""Least cosine between the normals of a vertex and of the triangle that is shown in its place."""
NUM_ROUNDINGS = 1
"""Rings of neighbours over which small gaps between what was seen, and small islands, are closed."""
SMOOTHING_CELLS = 24.0
"""Width in cells below which unseen shape is evened out."""
NUM_SMOOTHINGS = 2
NUM_HOLDS = 6
"""Most rounds in which vertices that came out of a seen surface are put back."""
BEHIND_CELLS = 1.0
"""Distance behind a seen surface that is kept, in cells."""
CG_TOLERANCE = 1e-4
NUM_NEIGHBOURS = 48
"""Seen texels near by whose mean an unseen one gets."""
MOST_SEEN = 20_000
"""Seen texels among which they are looked for."""
SEED = 0


def unseen_vertices(mesh: Mesh, views: tuple[View, ...]) -> NDArray[np.bool_]:
    """Return which vertices no view shows.

    They are hidden, turned away, outside of all pictures, or where pictures show nothing (alpha). Without
    views, all count as seen. Small gaps and islands are closed, for they are a matter of rounding.
    """
    seen = np.zeros(len(mesh.vertices), bool)
    if not views:
        return seen
    normals = angle_weighted_normals(mesh.vertices, mesh.faces)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    flat = unit(np.cross(b - a, c - a))
    for view in evenly_spaced(views, MOST_VIEWS):
        seen |= _shown(mesh, normals, flat, view)
        if seen.all():
            break
    around = joined(edges_of(mesh.faces), len(mesh.vertices))
    unseen = ~seen
    for grow in (False, True, True, False):
        for _ in range(NUM_ROUNDINGS):
            unseen = (unseen | (around @ unseen > 0)) if grow else ~(~unseen | (around @ ~unseen > 0))
    return unseen


def _shown(
    mesh: Mesh, normals: NDArray[np.float32], flat: NDArray[np.float32], view: View
) -> NDArray[np.bool_]:
    """Return which vertices one picture shows; `flat` are the unit normals of the triangles."""
    camera = relight_camera(view.name, view.camera)
    camera = camera.resized(camera.width * FINER, camera.height * FINER)
    fragments = rasterise(mesh.vertices, mesh.faces, camera)
    pose = camera.camera_to_world
    towards = pose[:3, 3] - mesh.vertices.astype(np.float64)
    away = np.linalg.norm(towards, axis=1)
    place = -towards @ pose[:3, :3]
    front = place[:, 2] < 0.0
    scale = 1.0 / np.where(front, -place[:, 2], 1.0)
    column = np.floor(camera.centre_x + camera.focal_x * place[:, 0] * scale)
    row = np.floor(camera.centre_y - camera.focal_y * place[:, 1] * scale)
    inside = front & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    pixel = row[inside].astype(int), column[inside].astype(int)
    reached = np.full(len(away), -np.inf)
    reached[inside] = fragments.depth[pixel]
    opaque = np.zeros(len(away), bool)
    opaque[inside] = _alpha(view)[tuple(axis // FINER for axis in pixel)] > 0.5
    # The other side of something thin lies as near behind what is shown.
    alike = np.zeros(len(away), bool)
    alike[inside] = (normals[inside] * flat[fragments.face[pixel]]).sum(-1) > LIKE_COSINE
    facing = (towards * normals).sum(-1) > LEAST_COSINE * away
    # A vertex beside the outline, in a pixel that shows nothing, says nothing: it may lie behind.
    return opaque & np.isfinite(reached) & alike & facing & (away < reached + HIDDEN_CELLS * mesh.cell)


def _alpha(view: View) -> NDArray[np.float32]:
    """Return where the photograph shows the object, under the first of its lights."""
    return next(iter(view.images.values()))[..., 3]


def closed_smoothly(mesh: Mesh, unseen: NDArray[np.bool_]) -> tuple[Mesh, NDArray[np.bool_]]:
    """Return the mesh with its unseen part evened out between the borders of what was seen, and that part.

    Pieces that were not seen at all are left out, unless nothing was. The seen vertices stay where they are.
    Each pass solves (1 + s^2 L) x = x_0, L the graph's Laplacian and s the smoothing width in edges: what is
    much smaller than s disappears, what is larger remains. What was behind a seen surface stays behind it:
    vertices that come out there are put back and held, and the others are evened out between them again.
    """
    if not unseen.any() or unseen.all():
        return mesh, unseen
    piece = piece_of_face(len(mesh.vertices), mesh.faces)
    known = np.zeros(piece.max() + 1, bool)
    known[piece[(~unseen)[mesh.faces].any(axis=1)]] = True
    kept = mesh.faces[known[piece]]
    unseen = unseen[np.unique(kept)]
    vertices, faces = compact(mesh.vertices.astype(np.float64), kept)
    if unseen.any():
        normals = angle_weighted_normals(vertices, faces).astype(np.float64)[~unseen]
        system = _smoothing(vertices, faces, SMOOTHING_CELLS * mesh.cell)
        vertices[unseen] = _evened_out(vertices, unseen, normals, system, mesh.cell)
    return Mesh(vertices.astype(np.float32), faces.astype(np.int32), mesh.cell), unseen


def _smoothing(vertices: NDArray[np.floating], faces: NDArray[np.integer], width: float) -> sparse.csr_array:
    """Return 1 + s^2 L for a smoothing `width` in scene units."""
    edges = edges_of(faces)
    length = float(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1).mean())
    neighbours = joined(edges, len(vertices))
    # In a plane of equilateral triangles the sum over six neighbours is 1.5 times the Laplacian.
    strength = (width / length) ** 2 / 1.5
    return (sparse.diags_array(1.0 + strength * neighbours.sum(axis=1)) - strength * neighbours).tocsr()


def _evened_out(
    vertices: NDArray[np.floating],
    unseen: NDArray[np.bool_],
    normals: NDArray[np.float64],
    system: sparse.csr_array,
    cell: float,
) -> NDArray[np.floating]:
    """Return the places of unseen vertices; `normals` are those of the seen ones."""
    learned = vertices[unseen]
    seen, tree = vertices[~unseen], cKDTree(vertices[~unseen])
    border = system[unseen][:, ~unseen] @ seen
    inner = system[unseen][:, unseen]
    held = np.zeros(len(learned), bool)
    places, start = learned.copy(), learned
    for turn in range(NUM_SMOOTHINGS + NUM_HOLDS):
        if turn < NUM_SMOOTHINGS:
            start = places.copy()
        free = ~held
        wanted = (start - border)[free] - inner[free][:, held] @ places[held]
        matrix = inner[free][:, free]
        for axis in range(3):
            places[free, axis], _ = cg(matrix, wanted[:, axis], x0=places[free, axis], rtol=CG_TOLERANCE)
        if turn < NUM_SMOOTHINGS - 1:
            continue
        _, near = tree.query(places)
        before = ((learned - seen[near]) * normals[near]).sum(-1)
        now = ((places - seen[near]) * normals[near]).sum(-1)
        # As far behind as it was learned, where that is less than the margin.
        least = np.minimum(-before, BEHIND_CELLS * cell)
        out = free & (before < 0.0) & (now > -least)
        if not out.any():
            break
        places[out] -= (now + least)[out, None] * normals[near[out]]
        held |= out
    return places


def plain_where_unseen(
    values: NDArray[np.float32], positions: NDArray[np.floating], unseen: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Return `values` [texel, n] with those of unseen texels replaced by means of the seen ones near by.

    Weights are the inverse squares of distances, so that colours pass into each other at the border.
    """
    if not unseen.any() or unseen.all():
        return values
    seen = np.flatnonzero(~unseen)
    if len(seen) > MOST_SEEN:
        seen = np.sort(np.random.default_rng(SEED).choice(seen, MOST_SEEN, replace=False))
    count = min(NUM_NEIGHBOURS, len(seen))
    away, near = cKDTree(positions[seen]).query(positions[unseen], k=count)
    away, near = away.reshape(-1, count), near.reshape(-1, count)
    weights = 1.0 / np.maximum(away, 1e-9 + 0.1 * away[:, -1:]) ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    filled = values.copy()
    filled[unseen] = np.einsum("tk,tkn->tn", weights, values[seen][near]).astype(np.float32)
    return filled
