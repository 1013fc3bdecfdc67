"""Triangles are saved where the shape allows it."""

import numpy as np
import pytest
import trimesh
from lambent_asset.mesh.mesh import Mesh
from lambent_asset.mesh.mesh_decimation import (
    adapted,
    distance_to_surface,
    reduced,
    without_folded_pairs,
)
from lambent_asset.mesh.mesh_health import mesh_health
from support.square_views import mesh_of

CELL = 2.0 / 47


@pytest.fixture(scope="module")
def places():
    return np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 48)] * 3, indexing="ij"))


@pytest.fixture(scope="module")
def ball(places):
    return mesh_of(0.8 - np.linalg.norm(places, axis=0))


def test_distances_are_those_of_a_plane_and_of_its_rim():
    square = Mesh(
        np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.int32([[0, 1, 2], [0, 2, 3]]), 0.1
    )
    points = np.array([[0.5, 0.3, 0.2], [1.3, 0.5, 0.0], [1.3, 1.4, 0.0], [0.2, 0.9, 0.0]])
    assert distance_to_surface(points, square) == pytest.approx([0.2, 0.3, 0.5, 0.0], abs=1e-6)


def test_a_smaller_tolerance_takes_more_triangles_and_is_kept(ball):
    counts = []
    for tolerance in (0.2 * CELL, 0.05 * CELL):
        found, error = adapted(ball, 10**6, tolerance)
        assert error <= tolerance
        away = distance_to_surface(ball.vertices, found)
        assert np.quantile(away, 0.98) <= tolerance
        counts.append(len(found.faces))
        # Not many more than needed, either.
        assert reduced(ball, len(found.faces) // 2)[1] > tolerance
    assert counts[1] > 1.5 * counts[0]


def test_more_triangles_than_allowed_are_never_used(ball):
    found, error = adapted(ball, 700, 1e-3 * CELL)
    assert 600 < len(found.faces) <= 700
    assert error > 1e-3 * CELL


@pytest.mark.parametrize("shape", ["plate", "cup", "ball_on_plane"])
def test_thin_parts_rims_and_contacts_survive(places, shape):
    x, y, z = places
    radius = np.hypot(x, y)
    if shape == "plate":
        # 2.4 cells thick.
        field = np.minimum(np.minimum(0.7 - np.abs(x), 0.7 - np.abs(y)), 1.2 * CELL - np.abs(z))
        volume = 1.4 * 1.4 * 2.4 * CELL
    elif shape == "cup":
        wall = 1.2 * CELL - np.abs(radius - 0.5)
        wall = np.minimum(wall, 0.6 - np.abs(z))
        floor = np.minimum(0.5 - radius, 1.2 * CELL - np.abs(z + 0.55))
        field = np.maximum(wall, floor)
        volume = np.pi * 2.0 * 0.5 * 2.4 * CELL * 1.2 + np.pi * 0.25 * 2.4 * CELL
    else:
        ground = np.minimum(np.minimum(0.8 - np.abs(x), 0.8 - np.abs(y)), 0.1 - np.abs(z + 0.6))
        field = np.maximum(ground, 0.4 - np.linalg.norm([x, y, z + 0.12], axis=0))
        volume = 1.6 * 1.6 * 0.2 + 4.0 / 3.0 * np.pi * 0.4**3
    fine = mesh_of(field)
    found, error = adapted(fine, 10**6, 0.3 * CELL)
    health = mesh_health(found.vertices, found.faces)
    assert health.watertight
    assert health.pieces == mesh_health(fine.vertices, fine.faces).pieces == 1
    assert len(found.faces) < 0.3 * len(fine.faces)
    assert error <= 0.3 * CELL
    assert trimesh.Trimesh(found.vertices, found.faces, process=False).volume == pytest.approx(
        volume, rel=0.12
    )
    for bound in (np.min, np.max):
        assert bound(found.vertices, axis=0) == pytest.approx(bound(fine.vertices, axis=0), abs=0.5 * CELL)


def test_a_fold_that_collapsed_to_two_equal_triangles_is_removed():
    faces = np.array([[0, 1, 2], [2, 1, 0], [1, 2, 3]])
    assert without_folded_pairs(faces).tolist() == [[1, 2, 3]]
