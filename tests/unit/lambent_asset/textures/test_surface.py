"""The surface with an atlas, of a model whose density is a ball."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.config import ExportConfig
from lambent_asset.textures.surface import build_surface, settled, upright
from support.sphere_model import RADIUS, sphere_model

CONFIG = ExportConfig(mesh_resolution=24, max_faces=600, transport_size=64)


@pytest.fixture(scope="module")
def model():
    return sphere_model()


@pytest.fixture(scope="module")
def surface(model):
    return build_surface(model, CONFIG)


def test_texels_are_listed_row_by_row(surface):
    assert surface.size == 64
    assert (np.diff(surface.texel_index) > 0).all()
    assert 0.25 * 64**2 < len(surface.texel_index) <= 64**2
    assert len(surface.positions) == len(surface.texel_normals) == len(surface.texel_index)


def test_places_and_normals_of_texels_are_those_of_the_ball(surface):
    radius = np.linalg.norm(surface.positions, axis=1)
    assert abs(np.median(radius) - RADIUS) < 0.08
    assert np.percentile(np.abs(radius - np.median(radius)), 90) < 0.03
    assert np.allclose(np.linalg.norm(surface.texel_normals, axis=1), 1.0, atol=1e-5)
    outwards = surface.positions / radius[:, None]
    # A texel in a sliver of the mesh may take its normal from far away.
    assert np.percentile((surface.texel_normals * outwards).sum(-1), 1) > 0.0


def test_copies_of_a_vertex_share_its_normal(surface):
    _, group = np.unique(surface.vertices, axis=0, return_inverse=True)
    first = np.zeros((group.max() + 1, 3), np.float32)
    first[group] = surface.normals
    assert np.array_equal(first[group], surface.normals)


def test_settling_moves_points_to_where_a_ray_ends(model):
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    cell = 0.06
    wanted = None
    for away in (0.0, 0.04, -0.04):
        found = np.linalg.norm(settled(model, (RADIUS + away) * directions, directions, cell), axis=1)
        wanted = found if wanted is None else wanted
        assert np.abs(found - wanted).max() < 0.02


def test_a_ray_that_meets_nothing_leaves_the_point_where_it_was(model, monkeypatch):
    monkeypatch.setattr(model.nerf.density, "density", lambda points: torch.zeros(len(points)))
    points = np.random.default_rng(2).normal(size=(10, 3)).astype(np.float32)
    outwards = np.tile(np.float32([0.0, 0.0, 1.0]), (10, 1))
    # The mesh lies between two of the places where density is evaluated.
    assert np.abs(settled(model, points, outwards, 0.05) - points).max() < 0.05 * 0.3


def test_learned_normals_that_point_inwards_are_leaned_outwards():
    plain = np.tile(np.float32([0.0, 0.0, 1.0]), (4, 1))
    learned = np.float32([[0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [1.0, 0.0, -0.1], [0.0, 0.0, 0.0]])
    found = upright(learned, plain)
    assert np.allclose(found[1], learned[1], atol=1e-6)
    assert np.allclose(found[[0, 3]], plain[[0, 3]])
    assert found[2, 2] > 0.15


def test_a_larger_atlas_has_more_texels(model, surface):
    larger = build_surface(model, replace(CONFIG, transport_size=128))
    # Charts pack more densely where the space between them is a smaller share.
    assert 3.2 < len(larger.texel_index) / len(surface.texel_index) < 5.6
