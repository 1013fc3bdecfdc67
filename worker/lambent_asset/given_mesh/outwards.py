"""Turns closed pieces of a mesh that are inside out, which rays that meet one side only would see through."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from lambent_asset.given_mesh.glb_file import GivenMesh
from lambent_asset.mesh.atlas import angle_weighted_normals
from lambent_asset.mesh.mesh import piece_of_face

FACES_AT_ONCE = 1 << 17


def turned_outwards(given: GivenMesh) -> tuple[GivenMesh, int]:
    """Return the mesh with closed pieces that face inwards turned round, and how many there were.

    A piece is closed where each edge has two triangles that run through it in opposite directions; vertices
    at one place count as one. One that lies inside the rest is the wall of a hollow and stays. Normals of the
    file that then point inwards are turned too.
    """
    _, place = np.unique(given.vertices, axis=0, return_inverse=True)
    joined = place.reshape(-1)[given.faces].astype(np.int64)
    count = int(joined.max()) + 1
    _, piece = np.unique(piece_of_face(count, joined), return_inverse=True)
    volume = np.bincount(piece, weights=_tetrahedra(given))
    inwards = np.flatnonzero(_closed(joined, count, piece) & (volume < 0.0))
    turned = [number for number in inwards if not _enclosed(given, piece, int(number))]
    if not turned:
        return given, 0
    some = np.isin(piece, turned)
    faces = given.faces.copy()
    faces[some] = faces[some][:, ::-1]
    facing = angle_weighted_normals(given.vertices, faces)
    touched = np.zeros(len(given.vertices), bool)
    touched[faces[some]] = True
    against = touched & ((given.normals * facing).sum(axis=1) < 0.0)
    normals = np.where(against[:, None], -given.normals, given.normals)
    return replace(given, faces=faces, normals=normals), len(turned)


def _tetrahedra(given: GivenMesh) -> Float[ndarray, " faces"]:
    """Return the signed volumes between the triangles and the middle of the mesh, scene units cubed."""
    middle = given.vertices.astype(np.float64).mean(axis=0)
    a, b, c = (given.vertices[given.faces[:, k]].astype(np.float64) - middle for k in range(3))
    return (a * np.cross(b, c)).sum(axis=1) / 6.0


def _closed(
    faces: Int[ndarray, "faces 3"], num_places: int, piece: Int[ndarray, " faces"]
) -> Bool[ndarray, " pieces"]:
    """Return for each piece whether it is the whole border of something."""
    start, end = faces.reshape(-1), faces[:, [1, 2, 0]].reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    _, edge = np.unique(low * num_places + high, return_inverse=True)
    edge = edge.reshape(-1)
    along = np.bincount(edge, weights=np.where(start < end, 1.0, -1.0))
    good = (np.bincount(edge) == 2) & (along == 0.0)
    bad = np.bincount(np.repeat(piece, 3), weights=~good[edge])
    return bad == 0.0


def _enclosed(given: GivenMesh, piece: Int[ndarray, " faces"], number: int) -> bool:
    """Return whether the rest of the mesh winds round a piece.

    Source: Van Oosterom and Strackee, The Solid Angle of a Plane Triangle (1983), equation 8.
    """
    point = given.vertices[given.faces[piece == number][0]].astype(np.float64).mean(axis=0)
    rest = given.faces[piece != number]
    corners = given.vertices[rest]
    if not len(rest) or (point < corners.min(axis=(0, 1))).any() or (point > corners.max(axis=(0, 1))).any():
        return False
    total = 0.0
    for begin in range(0, len(rest), FACES_AT_ONCE):
        a, b, c = (corners[begin : begin + FACES_AT_ONCE, k].astype(np.float64) - point for k in range(3))
        la, lb, lc = (np.linalg.norm(arm, axis=1) for arm in (a, b, c))
        top = (a * np.cross(b, c)).sum(axis=1)
        bottom = la * lb * lc + (a * b).sum(1) * lc + (a * c).sum(1) * lb + (b * c).sum(1) * la
        total += float(np.arctan2(top, bottom).sum()) / (2.0 * np.pi)
    return abs(total) > 0.5
