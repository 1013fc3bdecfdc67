"""Factors from albedo to radiance."""

from dataclasses import replace

import numpy as np
from lambent_asset.bundle.glb import write_glb
from lambent_asset.textures.photo_shading import SurfaceUnderLight
from lambent_relight import environment_from_array
from lambent_relight.baked.light import lit_texels, prepare_light
from lambent_relight.baked.material_maps import material_maps
from lambent_relight.baked.mesh import mesh_from_glb
from lambent_relight.baked.scene import baked_scene
from lambent_relight.baked.shading import lobes_of, shade
from lambent_relight.baked.transport import coarse_blocks
from lambent_relight.baked.view import look_at_surface
from lambent_relight.cameras import turntable
from lambent_relight.edits import MaterialEdit
from support.analytic_scene import Surface
from support.asset_bundle import painted
from support.atlas_box import atlas_box
from support.printed_box import open_scene, sky

BOX = atlas_box(16)
ALBEDO = np.float32([0.6, 0.4, 0.2])


def bouncing_scene():
    """Return a box that gets little but bounced light, which differs from block to block."""
    scene = open_scene(BOX, np.broadcast_to(ALBEDO, (len(BOX.texel_index), 3)))
    still = scene.transport
    blocks = len(coarse_blocks(BOX.size, BOX.texel_index)[0])
    indirect = np.zeros((9, 3, blocks), np.float32)
    indirect[0] = np.random.default_rng(3).uniform(0.0, 2.0, (3, blocks))
    transport = replace(still, direct=0.1 * still.direct, indirect=indirect)
    paint = Surface(albedo=tuple(ALBEDO), perceptual_roughness=0.6, metalness=0.0)
    glb = write_glb(BOX, painted(BOX, paint), unit="unknown")
    return baked_scene(mesh_from_glb(glb), transport, material_maps(glb, 0.1, BOX.size))


def test_photographs_are_divided_by_the_light_that_pictures_show():
    scene, radiance = bouncing_scene(), sky()
    light = prepare_light(environment_from_array(radiance), 7, 0)
    view = look_at_surface(scene, turntable(1, radius=7.0, width=48, height=48, elevation_deg=30.0)[0], 2)
    shown = shade(
        view,
        lit_texels(scene, view.used),
        lobes_of(view, MaterialEdit(), preview=False),
        light,
        (),
        preview=False,
        indirect=True,
        bounce_gain=np.ones(3, np.float32),
    )["diffuse"].reshape(-1, 3)[view.pixel]
    lit = SurfaceUnderLight(scene, radiance).turned(None)
    np.testing.assert_allclose(view.albedo, np.broadcast_to(ALBEDO, view.albedo.shape), atol=0.005)
    np.testing.assert_allclose(shown, view.albedo * view.mean(lit.diffuse[view.used]), rtol=1e-4)
