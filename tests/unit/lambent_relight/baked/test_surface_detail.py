"""The detail of textures on surfaces that networks see."""

from dataclasses import replace

import numpy as np
import pytest
from lambent_asset.bundle.glb import write_glb
from lambent_asset.textures.photo_albedo import fine_texels
from lambent_relight.baked.material_maps import material_maps
from lambent_relight.baked.raster import interpolate, rasterise
from lambent_relight.baked.surface_detail import SurfaceDetail
from lambent_relight.bundle.graphs import PrimaryHits
from lambent_relight.cameras import turntable
from support.atlas_box import atlas_box, coloured
from support.printed_box import open_scene, stripes

BOX = atlas_box(64)
SIZE = 256
MODEL = np.float32([0.4, 0.3, 0.5])
SCENE = open_scene(BOX, np.broadcast_to(MODEL, (len(BOX.texel_index), 3)))
(CAMERA,) = turntable(1, radius=7.0, elevation_deg=30.0, width=64, height=64, field_of_view_deg=30.0)


@pytest.fixture(scope="module")
def detail():
    fine = fine_texels(BOX, SIZE)
    textures = coloured(BOX)
    plane = np.zeros((SIZE * SIZE, 3), np.float32)
    plane[fine.index] = stripes(fine.positions)
    textures = replace(textures, albedo=plane.reshape(SIZE, SIZE, 3))
    mesh = write_glb(BOX, textures, unit="unknown")
    maps = material_maps(mesh, BOX.texel_size * BOX.size / SIZE, BOX.size)
    return SurfaceDetail.of(replace(SCENE, maps=maps))


@pytest.fixture(scope="module")
def seen():
    """Return which rays of `CAMERA` meet the box, where, and hits there with an albedo of their own."""
    found = rasterise(BOX.vertices, BOX.faces, CAMERA)
    ray = np.flatnonzero(found.covered)
    ones = np.ones((len(ray), 1), np.float32)
    hits = PrimaryHits(
        opacity=ones,
        distance=found.depth.ravel()[ray][:, None],
        normal=np.tile(np.float32([0.0, 0.0, 1.0]), (len(ray), 1)),
        albedo=ones * MODEL * np.float32(0.5),
        perceptual_roughness=0.3 * ones,
        metalness=0.1 * ones,
    )
    return ray, interpolate(found, BOX.faces, BOX.vertices), hits


def test_hits_on_the_mesh_get_the_print_relative_to_the_model(detail, seen):
    ray, places, hits = seen
    found = detail.applied(hits, CAMERA, ray)
    # The network sees half of what the model says on the atlas, and so half of the print.
    error = np.abs(found.albedo - 0.5 * stripes(places)).mean(axis=1)
    assert np.median(error) < 0.01
    assert found.perceptual_roughness is hits.perceptual_roughness
    assert found.metalness is hits.metalness


def test_hits_beside_the_mesh_stay_as_they_are(detail, seen):
    ray, _, hits = seen
    behind = replace(hits, distance=hits.distance + np.float32(1.01 * detail.tolerance))
    assert np.array_equal(detail.applied(behind, CAMERA, ray).albedo, hits.albedo)
    outside = np.setdiff1d(np.arange(CAMERA.width * CAMERA.height), ray)[: len(ray)]
    assert np.array_equal(detail.applied(hits, CAMERA, np.resize(outside, len(ray))).albedo, hits.albedo)


def test_a_texture_that_says_what_the_model_says_changes_nothing(seen):
    ray, _, hits = seen
    textures = coloured(BOX, np.broadcast_to(MODEL, (len(BOX.texel_index), 3)))
    mesh = write_glb(BOX, textures, unit="unknown")
    same = SurfaceDetail.of(replace(SCENE, maps=material_maps(mesh, BOX.texel_size, BOX.size)))
    np.testing.assert_allclose(same.applied(hits, CAMERA, ray).albedo, hits.albedo, rtol=0.02)
