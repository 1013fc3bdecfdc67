"""Rays against a mesh find what trying every face finds."""

import numpy as np
import pytest
from lambent_relight.tracing.hierarchy import LEAF_FACES, build_hierarchy
from lambent_relight.tracing.mesh_rays import MeshRays, is_closed

BOX_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
BOX_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip
"""Counter-clockwise seen from outside."""


def soup(count: int, seed: int = 0):
    """Return triangles anywhere in the unit cube, large and small."""
    rng = np.random.default_rng(seed)
    size = 0.5 * rng.random((count, 1, 1)) ** 3
    corners = rng.random((count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    return corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count).reshape(-1, 3)


def rays(vertices, count: int, seed: int = 1):
    """Return rays from anywhere towards the middle of faces, but for some that lie along an axis exactly."""
    rng = np.random.default_rng(seed)
    middle = vertices.reshape(-1, 3, 3).mean(axis=1)
    origin = rng.uniform(-0.5, 1.5, (count, 3))
    direction = middle[rng.integers(0, len(middle), count)] + rng.normal(0.0, 0.05, (count, 3)) - origin
    direction[: count // 10] = np.eye(3)[rng.integers(0, 3, count // 10)]
    return origin, direction / np.linalg.norm(direction, axis=1, keepdims=True)


def every_face(vertices, faces, origin, direction, *, one_sided=False):
    """Return (face or -1, distance) of the first hits, in double precision, by solving for each face."""
    a, b, c = (vertices.astype(np.float64)[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    along = direction @ normal.T
    along = np.where(np.abs(along) < 1e-30, 1e-30, along)
    distance = np.einsum("nfi,fi->nf", a[None] - origin[:, None], normal) / along
    place = origin[:, None] + distance[..., None] * direction[:, None]
    inside = np.ones(distance.shape, bool)
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("nfi,fi->nf", np.cross(q - p, place - p), normal) >= 0.0
    valid = inside & (distance > 0.0) & ((along < 0.0) | (not one_sided))
    distance = np.where(valid, distance, np.inf)
    face = distance.argmin(axis=1)
    nearest = distance[np.arange(len(origin)), face]
    return np.where(np.isfinite(nearest), face, -1), nearest


@pytest.mark.parametrize("count", [1, 2, LEAF_FACES, 9, 400])
@pytest.mark.parametrize("one_sided", [False, True])
def test_the_first_face_is_that_of_a_search_through_all_faces(count, one_sided):
    vertices, faces = soup(count)
    finder = MeshRays(vertices, faces)
    assert not finder.one_sided
    finder.one_sided = one_sided
    origin, direction = rays(vertices, 3000)
    found = finder(origin, direction)
    face, distance = every_face(vertices, faces, origin, direction, one_sided=one_sided)
    agreed = found.face == face
    # The two disagree only about rays through edges, which single precision moves.
    assert agreed.mean() > 0.999
    assert (face >= 0).any()
    hit = agreed & (face >= 0)
    np.testing.assert_allclose(found.distance[hit], distance[hit], rtol=2e-3, atol=1e-5)
    assert np.isinf(found.distance[agreed & (face < 0)]).all()


def test_weights_give_the_place_of_the_hit():
    vertices, faces = soup(60)
    origin, direction = rays(vertices, 2000)
    found = MeshRays(vertices, faces)(origin, direction)
    hit = np.flatnonzero(found.blocked)
    corners = vertices[faces[found.face[hit]]]
    place = np.einsum("nc,nci->ni", found.weights[hit], corners)
    expected = origin[hit] + found.distance[hit, None] * direction[hit]
    np.testing.assert_allclose(place, expected, atol=2e-4)
    np.testing.assert_allclose(found.weights.sum(axis=1), 1.0, atol=1e-6)


def test_a_closed_surface_is_left_from_below_and_met_from_outside():
    box = MeshRays(BOX_CORNERS, BOX_FACES)
    assert box.one_sided
    assert not box([[0.5, 0.5, 0.999]], [[0.0, 0.0, 1.0]]).blocked[0]
    found = box([[0.5, 0.5, 1.5]], [[0.0, 0.0, -1.0]])
    assert found.blocked[0]
    assert found.distance[0] == pytest.approx(0.5)
    opened = MeshRays(BOX_CORNERS, BOX_FACES[:-1])
    assert opened([[0.5, 0.5, 0.9]], [[0.0, 0.0, 1.0]]).blocked[0] != opened.one_sided


def test_a_surface_is_closed_when_every_edge_has_two_faces_even_across_seams():
    assert is_closed(BOX_CORNERS, BOX_FACES)
    assert not is_closed(BOX_CORNERS, BOX_FACES[1:])
    turned = BOX_FACES.copy()
    turned[0] = turned[0, ::-1]
    assert not is_closed(BOX_CORNERS, turned)
    # An atlas gives every face its own corners.
    assert is_closed(BOX_CORNERS[BOX_FACES].reshape(-1, 3), np.arange(36).reshape(-1, 3))


def test_faces_at_one_place_and_in_a_row_of_growing_gaps_are_built_and_found():
    vertices, faces = soup(1)
    pile = MeshRays(vertices, np.repeat(faces, 300, axis=0))
    origin = vertices.mean(axis=0) + np.cross(vertices[1] - vertices[0], vertices[2] - vertices[0])
    towards = vertices.mean(axis=0) - origin
    assert pile([origin], [towards / np.linalg.norm(towards)]).blocked[0]
    # Splitting takes one face off at a time, as deep as single precision reaches.
    place = np.float32(2.0) ** -np.arange(100)
    row = np.stack([place, 0 * place, 0 * place], axis=1)[:, None] + 0.1 * place[:, None, None] * np.eye(3)
    tree = build_hierarchy(row.reshape(-1, 3), np.arange(300).reshape(-1, 3))
    assert sorted(tree.face) == list(range(100))
    assert _depth(tree) < 80


def _depth(tree, node=0):
    inner = [tree.children[node, side] for side in range(2) if tree.children[node, side] > 0]
    return 1 + max((_depth(tree, child) for child in inner), default=0)
