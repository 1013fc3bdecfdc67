"""Open edges and separate pieces of meshes."""

import numpy as np
from lambent_asset.mesh.mesh_health import MeshHealth, mesh_health

VERTICES = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def test_a_tetrahedron_is_closed_even_where_its_vertices_are_split():
    closed = MeshHealth(boundary_edges=0, non_manifold_edges=0, pieces=1)
    assert mesh_health(VERTICES, TETRAHEDRON) == closed
    assert closed.watertight
    assert mesh_health(VERTICES[TETRAHEDRON.reshape(-1)], np.arange(12).reshape(4, 3)) == closed


def test_a_missing_triangle_leaves_three_edges_open():
    found = mesh_health(VERTICES, TETRAHEDRON[1:])
    assert (found.boundary_edges, found.non_manifold_edges, found.watertight) == (3, 0, False)


def test_a_third_triangle_at_an_edge_and_a_triangle_turned_over_are_not_manifold():
    more = np.concatenate([VERTICES, np.float32([[2, 2, 2]])])
    fin = mesh_health(more, np.concatenate([TETRAHEDRON, [[0, 1, 4]]]))
    assert (fin.boundary_edges, fin.non_manifold_edges) == (2, 1)
    turned = TETRAHEDRON.copy()
    turned[3] = turned[3][::-1]
    assert mesh_health(VERTICES, turned).non_manifold_edges == 3


def test_things_that_do_not_touch_are_pieces():
    vertices = np.concatenate([VERTICES, VERTICES + 5])
    assert mesh_health(vertices, np.concatenate([TETRAHEDRON, TETRAHEDRON + 4])).pieces == 2
