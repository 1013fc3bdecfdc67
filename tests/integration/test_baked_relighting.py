"""Qualities `preview` and `baked`, from a bundle on disk to pictures."""

import json

import numpy as np
import OpenEXR
import pytest
from lambent.cli import app
from lambent_core.colour import srgb_from_linear
from lambent_relight import (
    BundleError,
    MaterialEdit,
    Renderer,
    environment_from_array,
    load_bundle,
    turntable,
    write_environment,
    write_picture_exr,
)
from lambent_relight.baked.depth_steps import depth_steps
from lambent_relight.baked.light import MAX_DOMINANT, lit_texels
from lambent_relight.baked.renderer import BakedRenderer
from lambent_relight.baked.shading import lobes_of, shade
from lambent_relight.baked.shadow_maps import shadow_map
from lambent_relight.baked.transport import read_transport
from lambent_relight.baked.view import look_at_surface
from lambent_relight.bundle.graphs import NoCaches
from support.baked_bundle import write_baked_bundle
from support.plain_shading import shade_pixels

pytestmark = pytest.mark.slow

CAMERA = turntable(1, radius=4.0, elevation_deg=35.0, width=40, height=40)[0]


def sky(seed=0, sun=0.0):
    radiance = np.random.default_rng(seed).uniform(0.2, 1.0, (4, 8, 3)).repeat(8, 0).repeat(8, 1)
    radiance[9:11, 20:22] += sun
    return environment_from_array(radiance)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_baked_bundle(tmp_path_factory.mktemp("baked") / "boxes.relight")


@pytest.fixture(scope="module")
def renderer(folder):
    return Renderer(load_bundle(folder), num_threads=1, reader="onnx")


def decibels(a, b):
    shown = [srgb_from_linear(p.rgb) * p.opacity + 1.0 - p.opacity for p in (a, b)]
    return -10.0 * np.log10(np.mean((shown[0] - shown[1]) ** 2))


@pytest.fixture(scope="module")
def refined(renderer):
    return renderer.render(CAMERA, sky(), spp=256)


def test_baked_pictures_are_close_to_refined_ones_and_closer_than_previews(renderer, refined):
    baked = renderer.render(CAMERA, sky(), quality="baked")
    preview = renderer.render(CAMERA, sky(), quality="preview")
    assert decibels(baked, refined) > 34.0
    assert 24.0 < decibels(preview, refined) < decibels(baked, refined) - 1.0


def test_passes_add_up_in_every_quality(renderer, refined):
    for picture in (refined, renderer.render(CAMERA, sky(), quality="baked")):
        whole = picture.direct + picture.indirect
        np.testing.assert_allclose(picture.diffuse + picture.specular, whole, atol=1e-5)
        np.testing.assert_allclose(picture.rgb, whole, atol=1e-5)
        assert picture.visibility.min() >= 0.0
        inside = picture.coverage[..., 0] > 0.99
        assert 0.5 < picture.visibility[inside].mean() < 1.0


def test_openness_of_baked_pictures_is_what_refined_ones_count(renderer, refined):
    baked = renderer.render(CAMERA, sky(), quality="baked")
    inside = (baked.coverage[..., 0] > 0.99) & (refined.coverage[..., 0] > 0.99)
    assert np.abs(baked.visibility - refined.visibility)[inside].mean() < 0.03


def test_indirect_light_brings_baked_pictures_closer(renderer, refined):
    with_bounces = renderer.render(CAMERA, sky(), quality="baked")
    without = renderer.render(CAMERA, sky(), quality="baked", indirect=False)
    assert np.abs(without.indirect).max() == 0.0
    assert decibels(with_bounces, refined) > decibels(without, refined) + 1.0
    ratio = with_bounces.indirect.sum() / refined.indirect.sum()
    assert ratio == pytest.approx(1.0, abs=0.1)


def test_refined_light_of_many_bounces_is_more_than_that_of_one(renderer, refined):
    once = renderer.render(CAMERA, sky(), spp=256, bounces="one")
    np.testing.assert_allclose(once.direct.mean(), refined.direct.mean(), rtol=0.02)
    # Albedos of 0.6 and 0.8 around: the second bounce is a fifth of the first.
    assert 1.05 < refined.indirect.sum() / once.indirect.sum() < 1.4


def test_refined_pictures_go_on_until_they_are_as_quiet_as_asked(renderer):
    quick = renderer.render(CAMERA, sky(), spp=8)
    fractions = []
    quiet = renderer.render(CAMERA, sky(), spp=8, until_stderr=0.04, progress=fractions.append)
    assert quiet.num_samples > quick.num_samples
    inside = quiet.coverage[..., 0] > 0.99
    assert quiet.standard_error[inside].mean() < 0.05 * quiet.rgb[inside].mean()
    assert quick.standard_error[inside].mean() > 0.05 * quick.rgb[inside].mean()
    assert 0.0 < min(fractions) <= max(fractions) <= 1.0


def test_baked_relighting_is_linear_in_the_light(renderer):
    # Without dominant lights, whose choice depends on the whole map.
    baked = renderer.baked()
    arguments = {"preview": False, "antialias": 2, "indirect": True, "edit": MaterialEdit()}
    a, b = sky(1), sky(2)
    both = environment_from_array(0.5 * a.radiance + 2.0 * b.radiance)
    one, other, mixed = (baked.render(CAMERA, light, **arguments).rgb for light in (a, b, both))
    np.testing.assert_allclose(mixed, 0.5 * one + 2.0 * other, rtol=1e-5, atol=1e-5 * mixed.max())


def test_turning_the_light_equals_a_turned_map(renderer):
    light = sky(3)
    # 90 degrees are a quarter of the map's columns.
    turned = environment_from_array(np.roll(light.radiance, -16, axis=1))
    expected = renderer.render(CAMERA, turned, quality="baked").rgb
    found = renderer.render(CAMERA, light, quality="baked", rotate_deg=90.0).rgb
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-4)


def test_turning_the_object_is_turning_camera_and_light_the_other_way(renderer):
    light = sky(4)
    cameras = turntable(4, radius=4.0, elevation_deg=35.0, width=40, height=40)
    # The boxes look the same from all four sides: only the light differs.
    turned = renderer.render(cameras[0], light, quality="baked", object_rotate_deg=90.0)
    still = renderer.render(cameras[0], light, quality="baked")
    np.testing.assert_allclose(turned.coverage, still.coverage, atol=1e-3)
    assert decibels(turned, still) > 34.0
    np.testing.assert_allclose(turned.normal, still.normal, atol=0.05)


def test_a_sun_is_split_off_and_its_shadow_is_where_the_traced_one_is(renderer, monkeypatch):
    sunny = sky(0, sun=300.0)
    light = renderer.baked().light(sunny, 4)
    assert len(light.directions) == 1
    truth = renderer.render(CAMERA, sunny, spp=256)
    baked = renderer.render(CAMERA, sunny, quality="baked")
    # The same light, in harmonics alone.
    monkeypatch.setattr("lambent_relight.baked.renderer.MAX_DOMINANT", 0)
    smooth = renderer.render(CAMERA, sunny, quality="baked")
    assert decibels(baked, truth) > decibels(smooth, truth) + 0.5


def test_compiled_and_plain_arrays_agree(renderer, monkeypatch):
    arguments = {"preview": False, "antialias": 2, "indirect": True, "edit": MaterialEdit()}
    compiled = renderer.baked().render(CAMERA, sky(), **arguments)
    monkeypatch.setattr("lambent_relight.baked.kernels.shade_pixels", shade_pixels)
    plain = renderer.baked().render(CAMERA, sky(), **arguments)
    assert not np.array_equal(compiled.rgb, plain.rgb)
    np.testing.assert_allclose(compiled.rgb, plain.rgb, rtol=1e-5, atol=1e-6)


def test_another_exposure_calls_no_renderer_and_makes_what_a_fresh_relight_makes(
    folder, tmp_path, monkeypatch
):
    write_environment(tmp_path / "sky.exr", sky().radiance)
    rendered, render = [], Renderer.render
    monkeypatch.setattr(
        Renderer, "render", lambda *given, **more: rendered.append(1) or render(*given, **more)
    )

    def relit(out, *words):
        words = ("--env", str(tmp_path / "sky.exr"), "-o", str(tmp_path / out), "--quality", "baked", *words)
        assert app.run(["relight", str(folder), *words, "--turntable", "1", "--size", "16"]) == 0
        return {path.name: path.read_bytes() for path in (tmp_path / out / "sky").iterdir()}

    before = relit("out")
    brighter = relit("out", "--exposure-ev", "1")
    assert len(rendered) == 1
    assert brighter.keys() == {"turntable_000.png", "turntable_000.exr"}
    assert brighter["turntable_000.png"] != before["turntable_000.png"]
    assert brighter == relit("fresh", "--exposure-ev", "1")
    assert len(rendered) == 2


@pytest.mark.parametrize("quality", ["preview", "baked", "refined"])
def test_material_edits_act_in_every_quality(renderer, quality):
    settings = {"quality": quality, "spp": 16}
    plain = renderer.render(CAMERA, sky(), **settings)
    red = renderer.render(CAMERA, sky(), **settings, edit=MaterialEdit(albedo_gain=(1.2, 0.5, 0.5)))
    inside = plain.coverage[..., 0] > 0.99
    np.testing.assert_allclose(red.albedo[inside][:, 1], 0.5 * plain.albedo[inside][:, 1], rtol=1e-4)
    assert red.rgb[inside][:, 1].mean() < 0.75 * plain.rgb[inside][:, 1].mean()
    white = renderer.render(CAMERA, sky(), **settings, edit=MaterialEdit(albedo=(0.9, 0.9, 0.9)))
    np.testing.assert_allclose(white.albedo[inside], 0.9, atol=1e-5)
    glossy = renderer.render(CAMERA, sky(), **settings, edit=MaterialEdit(roughness_scale=0.5))
    halved = 0.5 * plain.perceptual_roughness[inside]
    np.testing.assert_allclose(glossy.perceptual_roughness[inside], halved, atol=1e-3)


@pytest.mark.parametrize("quality", ["baked", "refined"])
def test_depth_is_along_the_axis_and_distance_along_the_ray(renderer, quality):
    picture = renderer.render(CAMERA, sky(), quality=quality, spp=2, object_rotate_deg=30.0)
    cosine = CAMERA.rays()[1] @ -CAMERA.camera_to_world[:3, 2].astype(np.float32)
    np.testing.assert_allclose(picture.depth.ravel(), picture.distance.ravel() * cosine, rtol=1e-5)
    assert picture.depth.max() > 0.0


def test_exr_layers_hold_every_pass(renderer, tmp_path):
    picture = renderer.render(CAMERA, sky(), quality="baked")
    write_picture_exr(tmp_path / "p.exr", picture, attributes={"lambent:quality": "baked"})
    part = OpenEXR.File(str(tmp_path / "p.exr"), separate_channels=True).parts[0]
    assert part.header["lambent:quality"] == "baked"
    assert part.header["colorInteropID"] == "lin_rec709_scene"
    layers = {name.rpartition(".")[0] for name in part.channels}
    assert layers >= {"direct", "indirect", "diffuse", "specular", "visibility", "albedo", "normal"}


def test_a_lite_bundle_is_smaller_and_still_close(tmp_path, folder, refined):
    lite = write_baked_bundle(tmp_path / "lite.relight", tier="lite")
    picture = Renderer(load_bundle(lite), num_threads=1, reader="onnx").render(CAMERA, sky(), quality="baked")
    assert decibels(picture, refined) > 31.0
    sizes = [sum(f.stat().st_size for f in (p / "transport").iterdir()) for p in (lite, folder)]
    assert sizes[0] < 0.6 * sizes[1]


@pytest.mark.parametrize(
    "damage",
    [
        lambda t: t["planes"][0]["scales"].pop(),
        lambda t: t["planes"][0].update(bands=6),
        lambda t: t["planes"][1].update(name="direct"),
        lambda t: t.update(size=100_000),
        lambda t: t.update(num_texels=t["num_texels"] + 1),
        lambda t: t.update(num_shadow_directions=255),
        lambda t: t["planes"][2].update(bands=9),
    ],
)
def test_transport_that_does_not_fit_its_files_is_refused(folder, tmp_path, damage):
    copy = tmp_path / "bad.relight"
    copy.mkdir()
    for path in folder.rglob("*"):
        if path.is_file():
            (copy / path.relative_to(folder)).parent.mkdir(exist_ok=True)
            (copy / path.relative_to(folder)).write_bytes(path.read_bytes())
    manifest = json.loads((copy / "manifest.json").read_text())
    damage(manifest["transport"])
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match=r"bundle\.transport_invalid"):
        read_transport(load_bundle(copy))


def test_without_soft_edges_only_outlines_differ(renderer, monkeypatch):
    soft = renderer.render(CAMERA, sky(), quality="baked")
    monkeypatch.setattr(renderer.caches, "gbuffer", lambda *rays: pytest.fail("asked the volume"))
    hard = renderer.render(CAMERA, sky(), quality="baked", soft_edges=False)
    inside = (soft.coverage[..., 0] == 1.0) & (hard.coverage[..., 0] == 1.0)
    view = renderer.baked().view(CAMERA, 2, soft_edges=False)
    steps = look_at_surface(renderer.baked().scene, CAMERA, 2)
    inside.ravel()[steps.pixel[depth_steps(steps).at]] = False
    # Creases of the mesh are shaded sample by sample.
    inside.ravel()[view.pixel[view.within < 1.0]] = False
    assert inside.sum() > 400
    # Beside outlines materials are the volume's, which are those of the textures before 8 bits were left.
    np.testing.assert_allclose(hard.rgb[inside], soft.rgb[inside], atol=0.003)


@pytest.mark.parametrize("seed", [0, 1])
def test_edges_between_surfaces_are_means_of_what_each_reflects(renderer, seed):
    """One lobe of the mean normal and the mean material reflects what neither surface does."""
    baked, light = renderer.baked(), sky(seed, sun=30.0)
    edit = MaterialEdit(roughness_scale=0.4)
    prepared = baked.light(light, MAX_DOMINANT)
    towards = zip(prepared.directions, prepared.radii_rad, strict=True)
    shadows = [shadow_map(baked.scene.mesh, *each) for each in towards]

    def drawn(camera, antialias, *, apart):
        view = look_at_surface(baked.scene, camera, antialias, apart=apart)
        lobes, lit = lobes_of(view, edit, preview=False), lit_texels(baked.scene, view.used)
        gain = edit.bounce_gain(baked.scene.mean_albedo)
        shown = shade(view, lit, lobes, prepared, shadows, preview=False, indirect=True, bounce_gain=gain)
        return view, shown["rgb"] * view.image(view.coverage)

    side, factor = CAMERA.width, 8
    fine = drawn(CAMERA.resized(factor * side, factor * side), 1, apart=False)[1]
    truth = fine.reshape(side, factor, side, factor, 3).mean(axis=(1, 3))
    view, apart = drawn(CAMERA, 2, apart=True)
    mean = drawn(CAMERA, 2, apart=False)[1]
    edges = np.unique(view.pixel[view.within < 1.0])
    assert len(edges) > 50
    encoded = [srgb_from_linear(np.minimum(each, 1.0)).reshape(-1, 3)[edges] for each in (apart, mean, truth)]
    error = [np.sqrt(np.mean((each - encoded[2]) ** 2)) for each in encoded[:2]]
    assert error[0] < 0.85 * error[1], error


def test_two_lights_that_take_turns_are_prepared_once(renderer, monkeypatch):
    lights = [sky(10), sky(11)]
    first = [renderer.render(CAMERA, light, quality="baked").rgb for light in lights]
    monkeypatch.setattr(
        "lambent_relight.baked.renderer.prepare_light", lambda *_: pytest.fail("prepared again")
    )
    again = [renderer.render(CAMERA, light, quality="baked").rgb for light in lights]
    np.testing.assert_array_equal(first, again)
    assert np.abs(first[0] - first[1]).max() > 0.01


def test_remembered_views_are_bounded_by_their_memory_and_not_by_their_pixels(renderer):
    cameras = turntable(3, radius=4.0, elevation_deg=35.0, width=40, height=40)

    def opened(kept_bytes):
        return BakedRenderer(renderer.bundle, renderer.caches, kept_bytes=kept_bytes)

    coarse, fine = (opened(0).view(cameras[0], antialias, soft_edges=False) for antialias in (1, 4))
    assert len(np.unique(fine.pixel)) < 1.2 * coarse.num_pixels
    assert fine.size_bytes > 2.0 * coarse.size_bytes
    one = opened(4 * coarse.size_bytes)
    first = [one.view(camera, 1, soft_edges=False) for camera in cameras]
    assert all(
        one.view(camera, 1, soft_edges=False) is view for camera, view in zip(cameras, first, strict=True)
    )
    last = one.view(cameras[0], 4, soft_edges=False)
    assert one.view(cameras[0], 4, soft_edges=False) is last
    assert one.view(cameras[0], 1, soft_edges=False) is not first[0]


def test_without_networks_a_view_is_made_once_whatever_edges_are_asked_for(renderer):
    baked = BakedRenderer(renderer.bundle, NoCaches())
    assert baked.view(CAMERA, 2, soft_edges=True) is baked.view(CAMERA, 2, soft_edges=False)


def test_places_of_fragments_are_small_numbers_that_keep_nothing_else_in_memory(renderer):
    points = renderer.baked().view(CAMERA, 1, soft_edges=False).points
    for place in (points.row, points.column):
        assert (place.dtype, place.base) == (np.int32, None)


def test_the_memory_of_a_view_is_that_of_its_arrays(renderer):
    view = renderer.baked().view(CAMERA, 2, soft_edges=False)
    assert view.near is view.far
    names = (
        "pixel",
        "within",
        "first",
        "texel",
        "share",
        "used",
        "coverage",
        "distance",
        "omega_o",
        "normal",
    )
    names += ("albedo", "perceptual_roughness", "metalness", "visibility", "openness", "surroundings")
    names += ("near", "share_of_near")
    fragments = len(view.points.position)
    of_points = (12 + 12 + 4 + 4) * fragments + view.points.first.nbytes
    assert view.size_bytes == sum(getattr(view, name).nbytes for name in names) + of_points
