"""Edges of baked pictures: steps in depth are found, and both sides of one are shown as the volume says."""

from dataclasses import replace

import numpy as np
import pytest
from lambent_relight import Renderer, environment_from_array, load_bundle, turntable
from lambent_relight.baked.depth_steps import depth_steps
from lambent_relight.baked.edges import with_soft_edges
from lambent_relight.baked.scene import load_baked_scene
from lambent_relight.baked.view import look_at_surface
from lambent_relight.bundle.graphs import NoCaches, PrimaryHits
from lambent_relight.cameras import Camera, look_at
from scipy import ndimage
from support.analytic_scene import AnalyticScene
from support.baked_bundle import SCENE, SLAB, write_baked_bundle
from support.plain_shading import shade_pixels

pytestmark = pytest.mark.slow

SIDE = 48
AROUND = turntable(1, radius=4.0, elevation_deg=40.0, start_deg=20.0, width=SIDE, height=SIDE)[0]
GREY = (0.5, 0.5, 0.5)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return load_bundle(write_baked_bundle(tmp_path_factory.mktemp("edges") / "boxes.relight"))


@pytest.fixture(scope="module")
def scene(bundle):
    return load_baked_scene(bundle)


class Haze:
    """A volume that has `share` of every edge in front, whose surface is grey and faces the viewer."""

    name = "haze"

    def __init__(self, share, near, far):
        self.share, self.near, self.far = share, near, far

    def gbuffer(self, origin, direction):
        one = np.ones((len(origin), 1), np.float32)
        distance = one * (self.share * self.near + (1.0 - self.share) * self.far)
        return PrimaryHits(one, distance, -direction, one * np.float32(GREY), 0.3 * one, 0.2 * one)


def test_steps_are_where_the_block_hides_the_slab_and_nowhere_else(scene):
    view = look_at_surface(scene, AROUND, 2)
    steps = depth_steps(view)
    assert 10 < len(steps.at) < view.num_pixels // 8
    behind = view.distance[steps.far, 0] - view.distance[steps.near, 0]
    assert behind.min() > 4.0 * view.distance.min() / AROUND.focal_x
    for side in (steps.near, steps.far):
        apart = np.abs(np.stack(np.divmod(view.pixel[side], SIDE)) - np.divmod(view.pixel[steps.at], SIDE))
        assert apart.max() <= 1
    # The block stands on the slab: what hides is higher than what is hidden.
    eye = AROUND.camera_to_world[:3, 3]
    heights = (eye - view.distance * view.omega_o)[:, 2]
    assert (heights[steps.near] > heights[steps.far]).mean() > 0.95


def test_a_slanted_plane_has_no_steps_however_flat_it_is_seen(tmp_path):
    scene = load_baked_scene(
        load_bundle(write_baked_bundle(tmp_path / "slab", AnalyticScene((SLAB,)), side=8))
    )
    middle = np.float64([0.0, 0.0, -0.4])
    for height in (0.15, 0.5, 2.0):
        pose = look_at(middle + np.float64([1.5, 0.0, height]), middle)
        camera = Camera.centred("over", SIDE, SIDE, 3.0 * SIDE, pose)
        view = look_at_surface(scene, camera, 1)
        assert view.num_pixels > SIDE
        inside = np.abs(view.pixel // SIDE - SIDE / 2) < SIDE / 4
        assert not inside[depth_steps(view).at].any()


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_step_is_lit_as_both_sides_in_the_volumes_proportion(scene, share):
    view = look_at_surface(scene, AROUND, 2)
    steps = depth_steps(view)
    number = len(steps.at) // 2
    pick = np.zeros(len(steps.at), bool)
    pick[number] = True
    one = steps[pick]
    near, far = view.distance[one.near[0], 0], view.distance[one.far[0], 0]
    soft = with_soft_edges(view, Haze(share, near, far), 2)
    np.testing.assert_allclose(np.add.reduceat(soft.share, soft.first[:-1]), 1.0, rtol=1e-5)
    at = np.searchsorted(soft.pixel, view.pixel[one.at[0]])
    assert soft.pixel[at] == view.pixel[one.at[0]]
    values = np.random.default_rng(0).uniform(size=(len(view.used), 3)).astype(np.float32)
    sides = view.mean(values)
    expected = share * sides[one.near[0]] + (1.0 - share) * sides[one.far[0]]
    np.testing.assert_allclose(soft.mean(values)[at], expected, atol=1e-5)
    open_sides = view.openness[one.near[0]] * share + view.openness[one.far[0]] * (1.0 - share)
    np.testing.assert_allclose(soft.openness[at], open_sides, atol=1e-5)
    np.testing.assert_allclose(soft.albedo[at], GREY, rtol=1e-5)
    np.testing.assert_allclose(soft.normal[at], soft.omega_o[at], atol=0.05)
    assert soft.perceptual_roughness[at, 0] == pytest.approx(0.3)


def test_away_from_edges_the_mesh_decides_and_without_networks_everywhere(scene):
    view = look_at_surface(scene, AROUND, 2)
    soft = with_soft_edges(view, Haze(0.5, 3.0, 4.0), 2)
    kept = np.isin(soft.pixel, view.pixel)
    place = np.searchsorted(view.pixel, soft.pixel[kept])
    same = (soft.albedo[kept] == view.albedo[place]).all(axis=-1)
    assert 0.4 < same.mean() < 0.9
    inner = np.zeros(view.num_pixels, bool)
    inner[depth_steps(view).at] = True
    assert not same[inner[place]].any()
    np.testing.assert_array_equal(soft.normal[kept][same], view.normal[place][same])
    assert with_soft_edges(view, NoCaches(), 2) is view


def test_pixels_beside_the_border_come_from_the_volume_though_the_mesh_covers_them(scene):
    """Where the volume and the mesh end in different places, a pixel beside the border shows it."""
    view = look_at_surface(scene, AROUND, 2)
    full = np.zeros((SIDE, SIDE), bool)
    full.ravel()[view.pixel[view.coverage[:, 0] > 1.0 - 1e-6]] = True
    beside = full & ndimage.binary_dilation(~full, np.ones((3, 3)))
    assert beside.sum() > 20
    soft = with_soft_edges(view, Haze(0.5, 3.0, 4.0), 2)
    at = np.searchsorted(soft.pixel, np.flatnonzero(beside))
    np.testing.assert_array_equal(soft.pixel[at], np.flatnonzero(beside))
    np.testing.assert_allclose(soft.albedo[at], np.broadcast_to(GREY, (len(at), 3)), rtol=1e-5)


def test_normals_of_edges_face_the_viewer_whichever_way_the_volume_has_them(scene):
    class Backwards(Haze):
        def gbuffer(self, origin, direction):
            return replace(super().gbuffer(origin, direction), normal=direction)

    view = look_at_surface(scene, AROUND, 2)
    soft = with_soft_edges(view, Backwards(0.5, 3.0, 4.0), 2)
    of_volume = (np.abs(soft.albedo - np.float32(GREY)) < 1e-4).all(axis=-1)
    assert of_volume.sum() > 20
    assert (soft.normal * soft.omega_o).sum(axis=-1)[of_volume].min() >= 0.0


def test_exact_edges_stay_as_they_are(bundle):
    """Where mesh and volume agree, using the volume hardly changes a picture."""
    renderer = Renderer(bundle, num_threads=1, reader="onnx")
    sky = environment_from_array(np.random.default_rng(0).uniform(0.2, 1.0, (8, 16, 3)))
    soft, sharp = (renderer.render(AROUND, sky, quality="baked", soft_edges=asks) for asks in (True, False))
    inside = sharp.coverage[..., 0] > 0.999
    difference = np.abs(soft.rgb - sharp.rgb)[inside].mean() / sharp.rgb[inside].mean()
    assert difference < 0.01
    assert SCENE.shapes[0] is SLAB


def test_compiled_and_plain_arrays_agree_on_steps(scene, bundle, monkeypatch):
    baked = Renderer(bundle, num_threads=1, reader="onnx").baked()
    baked._caches = Haze(0.4, 3.4, 4.1)
    sky = environment_from_array(np.random.default_rng(0).uniform(0.2, 1.0, (8, 16, 3)))
    from lambent_relight import MaterialEdit

    way = {"preview": False, "antialias": 2, "indirect": True, "edit": MaterialEdit()}
    compiled = baked.render(AROUND, sky, **way)
    monkeypatch.setattr("lambent_relight.baked.kernels.shade_pixels", shade_pixels)
    plain = baked.render(AROUND, sky, **way)
    assert not np.array_equal(compiled.rgb, plain.rgb)
    np.testing.assert_allclose(compiled.rgb, plain.rgb, rtol=1e-4, atol=1e-6)
