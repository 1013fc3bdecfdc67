"""The mesh's textures as materials."""

from dataclasses import replace

import numpy as np
import pytest
from lambent_asset.bundle.glb import write_glb
from lambent_relight.baked.material_maps import material_maps
from support.atlas_box import FACE_COLOURS, atlas_box, coloured
from support.texture_lookup import sample_plane

BOX = atlas_box(32)
TEXTURES = coloured(BOX)


@pytest.fixture(scope="module")
def mesh():
    return write_glb(BOX, TEXTURES, unit="unknown")


def test_maps_are_looked_up_in_linear_light(mesh):
    maps = material_maps(mesh, 0.1, 32)
    uv = np.random.default_rng(1).random((300, 2), np.float32)
    found = maps.albedo_at(uv, np.zeros(300, np.float32))
    # A level of 8 bits is up to 0.9 % of white apart from the next.
    assert np.abs(found - sample_plane(TEXTURES.albedo, uv)).max() < 0.006
    roughness, metalness = maps.roughness_and_metalness_at(uv, np.zeros(300, np.float32))
    assert np.abs(roughness - 0.4).max() < 0.003
    assert np.abs(metalness - 1.0).max() < 1e-6


def test_distant_pixels_see_means_over_texels(mesh):
    maps = material_maps(mesh, 0.1, 8)
    assert [len(level) for level in maps.albedo] == [32, 16, 8]
    uv = np.float32([[1.0 / 32.0 + 0.25, 0.5]])
    near, far = (maps.albedo_at(uv, np.float32([size]))[0] for size in (0.1, 0.4))
    assert np.abs(near - sample_plane(TEXTURES.albedo, uv)[0]).max() < 0.006
    blocks = TEXTURES.albedo.reshape(8, 4, 8, 4, 3).mean(axis=(1, 3))
    assert np.abs(far - sample_plane(blocks, uv)[0]).max() < 0.012
    # Beyond the smallest version nothing changes.
    assert np.array_equal(maps.albedo_at(uv, np.float32([100.0]))[0], far)


def test_between_two_versions_pixels_see_a_mixture_of_both(mesh):
    maps = material_maps(mesh, 0.1, 8)
    uv = np.random.default_rng(2).random((300, 2), np.float32)
    near, between, far = (
        maps.albedo_at(uv, np.full(300, size, np.float32)) for size in (0.1, 0.2**0.5 / 10**0.5, 0.2)
    )
    np.testing.assert_allclose(between, 0.5 * (near + far), atol=1e-5)
    assert np.abs(near - far).max() > 0.01


def test_normals_are_those_of_the_texture(mesh):
    tilted = np.float32([0.6, 0.0, 0.8])
    leaning = write_glb(
        BOX, replace(TEXTURES, tangent_normal=np.broadcast_to(tilted, (32, 32, 3))), unit="unknown"
    )
    uv = np.random.default_rng(3).random((50, 2), np.float32)
    for glb, expected in ((mesh, [0.0, 0.0, 1.0]), (leaning, tilted)):
        found = material_maps(glb, 0.1, 32).normal_at(uv, np.zeros(50, np.float32))
        assert np.abs(found - expected).max() < 1.01 / 255.0


def test_versions_stop_at_the_atlas_of_transport(mesh):
    assert [len(level) for level in material_maps(mesh, 0.1, 17).albedo] == [32]
    means = material_maps(mesh, 0.1, 1).albedo[-1]
    assert means.shape == (1, 1, 3)
    assert FACE_COLOURS.min() * 255 < means.min()
