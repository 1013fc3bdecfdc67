"""Levels of detail of a ball."""

from itertools import pairwise

import numpy as np
import pytest
from flashcache.config import ExportConfig
from lambent_asset.bundle.mesh_levels import coarser, level_textures, levels_of_detail
from lambent_asset.mesh.mesh_health import mesh_health
from lambent_asset.textures.surface import build_surface
from lambent_asset.textures.textures import TextureSet
from lambent_relight.baked.raster import nearest_texel, rasterise_uv
from support.sphere_model import sphere_model


@pytest.fixture(scope="module")
def surface():
    return build_surface(sphere_model(), ExportConfig(transport_size=128))


@pytest.fixture(scope="module")
def level(surface):
    return coarser(surface, len(surface.faces) // 2)


def test_each_level_has_about_half_of_the_triangles_of_the_one_before(surface):
    counts = [len(surface.faces), *(len(level.faces) for level in levels_of_detail(surface))]
    assert len(counts) >= 2
    assert counts[1] == pytest.approx(0.5 * counts[0], rel=0.05)
    assert all(after <= 0.75 * before for before, after in pairwise(counts))


def test_a_level_has_the_same_charts_closed_along_their_borders(surface, level):
    assert mesh_health(level.vertices, level.faces).watertight
    full = rasterise_uv(surface.uv, surface.faces, 128).covered
    assert np.array_equal(rasterise_uv(level.uv, level.faces, 128).covered, full)
    assert np.array_equal(np.flatnonzero(full), level.texel_index)


def test_a_texel_of_a_level_shows_the_same_place_of_the_surface(surface, level):
    def places(one):
        found = rasterise_uv(one.uv, one.faces, 128)
        corners = one.vertices[one.faces[found.face[found.covered]]].astype(np.float64)
        second, third = found.barycentric[found.covered].T[:, :, None]
        return corners[:, 0] * (1.0 - second - third) + corners[:, 1] * second + corners[:, 2] * third

    away = np.linalg.norm(places(level) - places(surface), axis=1)
    texel = np.sqrt(4.0 * np.pi * 0.5**2 / len(surface.texel_index))
    assert np.median(away) < 0.5 * texel
    assert np.quantile(away, 0.99) < 3.0 * texel


def test_textures_of_a_level_are_means_and_its_normals_unit(surface, level):
    random = np.random.default_rng(0)
    planes = {
        name: random.random((128, 128, count)).astype(np.float32)
        for name, count in (
            *(("albedo", 3), ("perceptual_roughness", 1), ("metalness", 1)),
            *(("occlusion", 1), ("tangent_normal", 3)),
        )
    }
    small = level_textures(TextureSet(**planes), level, 2)
    assert small.albedo.shape == (64, 64, 3)
    assert small.albedo[5, 7] == pytest.approx(planes["albedo"][10:12, 14:16].mean(axis=(0, 1)), abs=1e-6)
    assert np.allclose(np.linalg.norm(small.tangent_normal, axis=-1), 1.0, atol=1e-5)
    # Not the given ones, which belong to other frames.
    assert (small.tangent_normal[..., 2] > 0.0).all()
    assert nearest_texel(level.texel_index, 128).shape == (128, 128)
