"""A baked surface between its texels."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from lambent_asset.bundle.glb import write_glb
from lambent_relight.baked.light import coarse_bounce, lit_texels, prepare_light, texel_bounce
from lambent_relight.baked.material_maps import material_maps
from lambent_relight.baked.mesh import AtlasMesh, mesh_from_glb
from lambent_relight.baked.raster import rasterise
from lambent_relight.baked.scene import SurfacePlaces, baked_scene
from lambent_relight.baked.transport import Transport, coarse_blocks
from lambent_relight.cameras import turntable
from lambent_relight.environment.maps import environment_from_array
from support.atlas_box import atlas_box, coloured
from support.quad_surface import box_of_quads, surface_of

BOX = atlas_box(32)
CAMERA = turntable(1, radius=3.0, elevation_deg=30.0, width=48, height=48)[0]


def transport_of(surface, indirect=None):
    count = len(surface.texel_index)
    blocks = len(coarse_blocks(surface.size, surface.texel_index)[0])
    material = np.concatenate([np.full((5, count), 0.5), surface.texel_normals.T]).astype(np.float32)
    flat = np.zeros((4, 3, blocks), np.float32)
    if indirect is not None:
        flat[0] = indirect(blocks)
    return Transport(
        surface.size,
        surface.texel_index,
        np.full((4, count), 0.5, np.float32),
        np.ones((1, count), np.float32),
        flat,
        None,
        material,
    )


def places_of(scene):
    return SurfacePlaces.of(rasterise(scene.mesh.vertices, scene.mesh.faces, CAMERA), scene.mesh)


@pytest.mark.parametrize("lean", [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.28, 0.96]])
def test_normals_are_the_meshs_with_the_detail_of_the_normal_map(lean):
    plane = np.broadcast_to(np.float32(lean), (32, 32, 3))
    glb = write_glb(BOX, replace(coloured(BOX), tangent_normal=plane), unit="unknown")
    scene = baked_scene(mesh_from_glb(glb), transport_of(BOX), material_maps(glb, 0.1, 32))
    places = places_of(scene)
    found = scene.normals_at(places, np.zeros(len(places.uv), np.float32))
    flat = places(scene.mesh.normals)
    assert np.abs(np.linalg.norm(found, axis=1) - 1.0).max() < 1e-5
    np.testing.assert_allclose(np.sum(found * flat, axis=1), lean[2], atol=0.01)


def test_indirect_light_is_bilinear_between_blocks_and_stays_in_its_chart():
    walls, _, mesh = surface_of(box_of_quads(), 8)
    normals = np.zeros_like(walls.positions) + walls.normals
    texels = SimpleNamespace(size=walls.size, texel_index=walls.texel_index, texel_normals=normals)
    transport = transport_of(texels, lambda n: np.tile(np.arange(n) % 7, (3, 1)))
    scene = baked_scene(AtlasMesh(mesh["vertices"], mesh["faces"], mesh["uv"]), transport)
    lit = lit_texels(scene)
    light = prepare_light(environment_from_array(np.ones((16, 32, 3))), 2, 0)
    coarse, fine = coarse_bounce(lit, light), texel_bounce(lit, light)
    near = coarse[lit.around]
    assert (fine >= near.min(axis=1) - 1e-5).all()
    assert (fine <= near.max(axis=1) + 1e-5).all()
    assert not np.allclose(fine, coarse[lit.coarse])
    # Charts are two texels apart, so that blocks of one are next to those of another.
    first, _ = coarse_blocks(walls.size, walls.texel_index)
    for blocks in scene.blocks_around.T:
        np.testing.assert_array_equal(normals[first[blocks]], normals)
