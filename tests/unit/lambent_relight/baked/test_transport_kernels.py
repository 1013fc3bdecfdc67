"""Compiled loops over directions and points, against plain ones."""

import numpy as np
import pytest
from lambent_relight.baked.transport_kernels import NearestPoint, basis_rows, mirrored_sums
from lambent_relight.environment import harmonics


def unit(rng, count):
    vectors = rng.normal(size=(count, 3))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("bands", [1, 3, 4, 7, 9])
def test_the_compiled_basis_is_the_basis(bands):
    directions = np.concatenate([unit(np.random.default_rng(0), 200), np.eye(3), -np.eye(3)])
    np.testing.assert_allclose(basis_rows(directions, bands), harmonics.basis(directions, bands), atol=3e-6)


def test_mirrored_sums_are_sums_over_mirrored_directions():
    rng = np.random.default_rng(1)
    directions, normals = unit(rng, 20), unit(rng, 5)
    opacity = rng.integers(0, 256, (5, 20)).astype(np.uint8)
    found = mirrored_sums(opacity, normals, directions, 4, least=12, scale=0.1)
    for t in range(5):
        below = directions - 2.0 * (directions @ normals[t])[:, None] * normals[t]
        weight = np.where(opacity[t] > 12, 0.1 * opacity[t].astype(float), 0.0)
        np.testing.assert_allclose(found[t], weight @ harmonics.basis(below, 4), rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("spread", [(1.0, 1.0, 1.0), (1.0, 1.0, 0.0), (1.0, 1e-3, 1e-3)])
def test_the_nearest_point_is_found_beside_the_surface_and_nearly_found_far_from_it(spread):
    rng = np.random.default_rng(2)
    points = (rng.uniform(-1.0, 1.0, (400, 3)) * spread).astype(np.float32)
    near = (points + 0.05 * unit(rng, 400)).astype(np.float32)
    far = rng.uniform(-2.0, 2.0, (300, 3)).astype(np.float32)
    for queries, slack in ((near, 1e-5), (far, 0.75)):
        index = NearestPoint(points)(queries)
        distance = np.linalg.norm(queries[:, None] - points, axis=-1)
        chosen = distance[np.arange(len(queries)), index]
        # A cell is a quarter wide: 400 points, eight cells along a side of length 2.
        assert (chosen <= distance.min(axis=1) + slack).all()


def test_one_point_is_always_the_nearest():
    assert NearestPoint(np.zeros((1, 3), np.float32))(np.ones((4, 3), np.float32)).tolist() == [0] * 4
