"""From a bundle on disk to pictures on disk."""

from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from lambent_relight import (
    Renderer,
    SettingError,
    UnsupportedQuality,
    environment_from_array,
    load_bundle,
    load_environment,
    look_at,
    render,
    turntable,
    write_environment,
    write_picture_exr,
    write_png,
)
from PIL import Image
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere, Surface
from support.baked_bundle import write_baked_bundle

CLAY = Surface(albedo=(0.6, 0.4, 0.2), perceptual_roughness=0.8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    scene = AnalyticScene((Sphere((0.0, 0.0, 0.0), 1.0, CLAY),))
    return write_analytic_bundle(tmp_path_factory.mktemp("bundle") / "ball.relight", scene)


@pytest.fixture(scope="module")
def renderer(folder):
    return Renderer(load_bundle(folder), num_threads=1, reader="onnx")


CAMERA = turntable(1, radius=4.0, width=24, height=24)[0]
SKY = environment_from_array(np.random.default_rng(0).uniform(0.5, 1.5, (8, 16, 3)))


def test_files_of_light_and_cameras_become_pictures(folder, tmp_path):
    write_environment(tmp_path / "sky.exr", SKY.radiance)
    bundle = load_bundle(folder)
    fractions = []
    picture = render(
        bundle,
        bundle.cameras()[0],
        load_environment(tmp_path / "sky.exr"),
        spp=8,
        progress=fractions.append,
    )
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1.0)
    write_png(tmp_path / "ball.png", picture)
    write_picture_exr(tmp_path / "ball.exr", picture)
    with Image.open(tmp_path / "ball.png") as png:
        assert png.size == (16, 16)
    channels = OpenEXR.File(str(tmp_path / "ball.exr"), separate_channels=True).parts[0].channels
    np.testing.assert_allclose(channels["R"].pixels, (picture.rgb * picture.opacity)[..., 0], rtol=1e-3)


def test_the_background_shows_through_where_the_object_is_not(renderer):
    transparent = renderer.render(CAMERA, SKY, spp=4)
    outside = transparent.opacity[..., 0] == 0.0
    assert outside.any()
    assert not outside.all()
    assert (transparent.rgb[outside] == 0.0).all()
    assert (transparent.standard_error[outside] == 0.0).all()

    white = renderer.render(CAMERA, SKY, spp=4, background=(1.0, 0.5, 0.25))
    np.testing.assert_array_equal(white.rgb[outside], np.float32([[1.0, 0.5, 0.25]] * outside.sum()))
    alpha = transparent.opacity
    np.testing.assert_allclose(
        white.rgb, alpha * transparent.rgb + (1 - alpha) * np.array([1.0, 0.5, 0.25]), rtol=1e-5
    )
    assert (white.opacity == 1.0).all()

    sky = renderer.render(CAMERA, SKY, spp=4, rotate_deg=70.0, background="environment")
    directions = CAMERA.rays()[1].reshape(24, 24, 3)
    np.testing.assert_allclose(sky.rgb[outside], SKY.rotated(70.0).lookup(directions)[outside], rtol=1e-5)


def test_passes_describe_the_surface_and_add_up(renderer):
    picture = renderer.render(CAMERA, SKY, spp=8, antialias=1)
    inside = picture.opacity[..., 0] > 0.0
    np.testing.assert_allclose(picture.rgb, picture.direct + picture.indirect, rtol=1e-6)
    np.testing.assert_allclose(picture.albedo[inside], [[0.6, 0.4, 0.2]] * inside.sum(), rtol=1e-6)
    np.testing.assert_allclose(picture.perceptual_roughness[inside], 0.8, rtol=1e-6)
    origin, direction = (a.reshape(24, 24, 3) for a in CAMERA.rays())
    hit = (origin + picture.distance * direction)[inside]
    np.testing.assert_allclose(np.linalg.norm(hit, axis=-1), 1.0, atol=1e-5)
    np.testing.assert_allclose(picture.normal[inside], hit, atol=1e-5)


def test_the_albedo_ratio_scales_what_is_reflected_and_stops_at_one(renderer):
    plain = renderer.render(CAMERA, SKY, spp=32)
    double = renderer.render(CAMERA, SKY, spp=32, albedo_ratio=(1.5, 1.5, 1.5))
    huge = renderer.render(CAMERA, SKY, spp=32, albedo_ratio=100.0)
    inside = plain.opacity[..., 0] > 0.0
    np.testing.assert_allclose(double.albedo[inside], 1.5 * plain.albedo[inside], rtol=1e-6)
    assert plain.rgb[inside].mean() < double.rgb[inside].mean() < 1.6 * plain.rgb[inside].mean()
    assert (huge.albedo[inside] == 1.0).all()


def test_a_view_is_asked_for_once_however_many_lights_follow(folder):
    renderer = Renderer(load_bundle(folder), num_threads=1, reader="onnx")
    first = renderer.view(CAMERA, 2)
    renderer.render(CAMERA, SKY, spp=2)
    assert renderer.view(CAMERA, 2) is first
    assert renderer.view(CAMERA, 1) is not first
    small = Renderer(renderer.bundle, num_threads=1, reader="onnx", kept_rays=3 * first.num_rays)
    first = small.view(CAMERA, 2)
    assert small.view(CAMERA, 2) is first
    for camera in turntable(6, radius=4.0, width=24, height=24, start_deg=5.0):
        small.view(camera, 2)
    assert small.view(CAMERA, 2) is not first


def test_more_rays_per_pixel_approach_the_true_coverage_of_the_edge(renderer):
    # The ball's outline is a circle in the picture; its pixels' true coverage comes from many fine rays.
    side = CAMERA.width
    fine = renderer.caches.gbuffer(*CAMERA.resized(16 * side, 16 * side).rays()).opacity
    truth = fine.reshape(side, 16, side, 16).mean(axis=(1, 3))
    errors = [
        np.abs(renderer.render(CAMERA, SKY, spp=2, antialias=n).opacity[..., 0] - truth).mean()
        for n in (1, 2, 4)
    ]
    assert errors[2] < 0.5 * errors[1] < 0.35 * errors[0]


def test_pixels_average_their_rays_by_coverage(renderer):
    view = renderer.view(CAMERA, 2)
    ones = np.ones((len(view.pixel), 1), np.float32)
    coverage = view.coverage()
    np.testing.assert_allclose(view.mean(3 * ones)[coverage > 0], 3.0, rtol=1e-6)
    numbers = np.arange(1.0, (coverage > 0).sum() + 1)
    np.testing.assert_array_equal(view.picture(numbers[:, None])[coverage > 0], numbers)
    assert (view.picture(numbers[:, None])[coverage == 0] == 0.0).all()
    assert len(view.pixel) < 4 * coverage.size


def test_a_camera_that_sees_nothing_gives_an_empty_picture(renderer):
    away = turntable(1, radius=4.0, target=(0.0, 0.0, 50.0), width=4, height=4)[0]
    picture = renderer.render(away, SKY, spp=2)
    assert (picture.opacity == 0.0).all()
    assert (picture.rgb == 0.0).all()


def test_odd_numbers_of_samples_are_rounded_up_to_whole_passes(renderer):
    counts = {(2, 1): 2, (13, 1): 14, (500, 1): 501, (2, 2): 8, (64, 2): 64, (70, 2): 72, (2000, 2): 2016}
    for (asked, antialias), spent in counts.items():
        picture = renderer.render(CAMERA, SKY, spp=asked, antialias=antialias)
        assert picture.num_samples == spent


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ({"spp": 1}, "relight.num_samples"),
        ({"antialias": 0}, "relight.antialias"),
        ({"antialias": 9}, "relight.antialias"),
        ({"bounces": "adaptd"}, "relight.bounces"),
        ({"albedo_ratio": (1.0, -1.0, 1.0)}, "relight.albedo_ratio"),
        ({"albedo_ratio": (1.0, 1.0)}, "relight.albedo_ratio"),
        ({"background": "pink"}, "relight.background"),
        ({"background": (1.0, float("nan"), 0.0)}, "relight.background"),
    ],
)
def test_settings_out_of_range_are_refused(renderer, arguments, code):
    with pytest.raises(SettingError) as caught:
        renderer.render(CAMERA, SKY, **({"spp": 2} | arguments))
    assert caught.value.code == code


@pytest.mark.parametrize(("quality", "reason"), [("preview", "baked"), ("baked", "baked"), ("best", "best")])
def test_qualities_that_a_bundle_does_not_have_are_refused(renderer, quality, reason):
    with pytest.raises(UnsupportedQuality, match=reason):
        renderer.render(CAMERA, SKY, quality=quality)


@pytest.fixture(scope="module")
def boxes(tmp_path_factory):
    """Return a renderer of boxes with baked transport; one is a cube from -0.4 to 0.4."""
    folder = write_baked_bundle(tmp_path_factory.mktemp("baked") / "boxes.relight", side=12)
    return Renderer(load_bundle(folder), num_threads=1, reader="onnx")


@pytest.mark.slow
@pytest.mark.parametrize("quality", ["preview", "baked", "refined"])
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.3999, 0.0, 0.1), (0.4, 0.4, 0.4)])
def test_a_camera_inside_the_object_sees_its_walls_and_nothing_strange(boxes, quality, place):
    looking = replace(CAMERA, camera_to_world=look_at(place, (-0.2, -0.1, 0.0)))
    picture = boxes.render(looking, SKY, quality=quality, spp=8, antialias=1)
    for name in ("rgb", "direct", "indirect", "standard_error", "distance", "normal"):
        assert np.isfinite(getattr(picture, name)).all(), name
    assert (picture.opacity == 1.0).all(), "there is a wall wherever one looks"
    assert picture.distance.max() < 1.5
    assert picture.rgb.min() >= 0.0
    assert picture.rgb.max() < 2.0 * SKY.radiance.max()


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.999, 0.0, 0.0)])
def test_a_camera_inside_a_ball_makes_a_picture(renderer, place):
    looking = replace(CAMERA, camera_to_world=look_at(place, (-0.2, -0.1, 0.0)))
    picture = renderer.render(looking, SKY, spp=8, antialias=1)
    assert np.isfinite(picture.rgb).all()
    assert (picture.opacity == 1.0).all()
    assert 0.0 <= picture.rgb.min() <= picture.rgb.max() < 2.0 * SKY.radiance.max()
