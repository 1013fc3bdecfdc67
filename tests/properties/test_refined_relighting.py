"""Refined relighting is an unbiased estimate of the light that exactly traced scenes reflect."""

import json
from pathlib import Path

import numpy as np
import pytest
from lambent_relight.brdf import materials_from_roughness
from lambent_relight.bundle.bundle import load_bundle
from lambent_relight.bundle.graphs import OnnxCaches, PointMaterials, PrimaryHits, SecondaryHits
from lambent_relight.cameras import Camera, look_at
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.light_sampling import LightSampler
from lambent_relight.environment.maps import Environment, environment_from_array
from lambent_relight.refined.passes import Light, Scene
from lambent_relight.refined.pixel_rays import PixelRays
from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import outgoing_radiance
from lambent_relight.refined.surroundings import CacheSurroundings
from lambent_relight.renderer import Renderer
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Box, Plane, Sphere, Surface
from support.brute_force import reflected_samples
from support.onnx_expressions import NumpyOps
from support.statistics import assert_mean

GOLDEN = json.loads(
    (Path(__file__).parents[1] / "golden/environment_orientation.json").read_text(encoding="utf-8")
)
RED = Surface(albedo=(0.9, 0.3, 0.2))
GREEN = Surface(albedo=(0.2, 0.8, 0.3), perceptual_roughness=0.6)
GOLD = Surface(albedo=(0.9, 0.7, 0.3), perceptual_roughness=0.5, metalness=1.0)

CORNER = AnalyticScene((Plane((0, 0, 0), (0, 0, 1), RED), Plane((0, 0, 0), (1, 0, 0), GREEN)))
GOLD_CORNER = AnalyticScene((Plane((0, 0, 0), (0, 0, 1), RED), Plane((0, 0, 0), (1, 0, 0), GOLD)))
SHADED = AnalyticScene((Plane((0, 0, 0), (0, 0, 1), RED), Sphere((0, 0, 1.2), 0.8, GOLD)))


def sky(seed: int = 0) -> Environment:
    """Return a map with a bright window in a dim, coloured sky."""
    image = np.random.default_rng(seed).uniform(0.2, 1.0, (8, 16, 3)).astype(np.float32)
    image[1, 5] += np.array([8.0, 7.0, 5.0], np.float32)
    return environment_from_array(image)


def even_sky(radiance: float = 1.0) -> Environment:
    return environment_from_array(np.full((4, 8, 3), radiance))


@pytest.fixture(scope="module")
def caches(tmp_path_factory):
    """Return a function from a scene to its graphs."""
    opened: dict[AnalyticScene, OnnxCaches] = {}

    def open_caches(scene: AnalyticScene) -> OnnxCaches:
        if scene not in opened:
            folder = write_analytic_bundle(tmp_path_factory.mktemp("scene") / "a.relight", scene)
            opened[scene] = OnnxCaches(load_bundle(folder), num_threads=1)
        return opened[scene]

    return open_caches


def surface_points(scene: AnalyticScene, position, viewer, count: int) -> SurfacePoints:
    """Return the same point `count` times."""
    where = np.tile(np.array([position], np.float64), (count, 1))
    omega_o = np.asarray(viewer, np.float64) - where
    omega_o /= np.linalg.norm(omega_o, axis=-1, keepdims=True)
    albedo, roughness, metalness, normal = (
        np.asarray(a, np.float32) for a in scene.surface_at(NumpyOps, where)
    )
    return SurfacePoints(
        where.astype(np.float32),
        normal,
        omega_o.astype(np.float32),
        materials_from_roughness(albedo, roughness, metalness),
    )


def fours(count: int) -> PixelRays:
    """Return `count` pixels of four rays that weigh alike."""
    return PixelRays.of(np.repeat(np.arange(count), 4), np.ones((4 * count, 1)))


def relit(
    open_caches, scene, environment, position, viewer, *, count=1500, seed=0, indirect=True, num_samples=8
):
    """Return independent estimates [count, 3] of the light that leaves `position` towards `viewer`."""
    around = CacheSurroundings(open_caches(scene), scene.origin_offset, MaterialEdit())
    radiance = outgoing_radiance(
        surface_points(scene, position, viewer, count),
        Scene(around, Light(environment, LightSampler(environment)), indirect=indirect),
        num_samples=num_samples,
        seed=seed,
    )
    return (radiance.direct + radiance.indirect).astype(np.float64)


def by_definition(scene, environment, position, viewer, *, count=1500, per_sample=128, bounces=1):
    """Return independent brute-force estimates [count, 3] of the same."""
    points = surface_points(scene, position, viewer, count * per_sample)
    samples = reflected_samples(
        scene,
        points.position.astype(np.float64),
        points.omega_o.astype(np.float64),
        environment.lookup,
        rng=np.random.default_rng(7),
        bounces=bounces,
    )
    return samples.reshape(count, per_sample, 3).mean(axis=1)


@pytest.mark.parametrize(("bounces", "num_samples"), [(0, 3), (1, 3), (0, 8), (1, 8)])
@pytest.mark.parametrize(
    ("scene", "position", "viewer"),
    [
        (CORNER, (0.5, 0.0, 0.0), (2.0, 1.0, 1.5)),
        (GOLD_CORNER, (0.3, 0.0, 0.0), (2.0, 1.0, 1.5)),
        (SHADED, (0.4, 0.3, 0.0), (1.0, -2.0, 1.5)),
        (SHADED, (0.48, 0.0, 0.56), (2.0, 1.0, 0.8)),
    ],
    ids=["two coloured walls", "golden wall", "below a golden ball", "on the golden ball"],
)
def test_light_of_a_traced_scene_is_what_its_definition_says(
    caches, scene, position, viewer, bounces, num_samples
):
    environment = sky()
    ours = relit(caches, scene, environment, position, viewer, indirect=bounces > 0, num_samples=num_samples)
    expected = by_definition(scene, environment, position, viewer, bounces=bounces)
    assert_mean(ours - expected, np.zeros(3))


def test_the_bounce_between_two_walls_has_the_energy_of_the_closed_form(caches):
    # Form factors between perpendicular half planes that share an edge are 1/2 everywhere.
    black = Surface(albedo=(0.6, 0.6, 0.6), perceptual_roughness=1.0)
    scene = AnalyticScene(
        (Plane((0, 0, 0), (0, 0, 1), black), Plane((0, 0, 0), (1, 0, 0), black)), origin_offset=1e-4
    )
    position, viewer = (0.5, 0.0, 0.0), (0.6, 0.0, 2.0)
    both = relit(caches, scene, even_sky(), position, viewer)
    direct = relit(caches, scene, even_sky(), position, viewer, indirect=False)
    diffuse_direct, diffuse_bounce = 0.6 * 0.5, (0.6 * 0.5) ** 2
    # The dielectric lobes add at most 0.04 of what arrives, at each of the two reflections.
    assert diffuse_direct < direct.mean() < diffuse_direct + 0.04
    assert diffuse_bounce < (both - direct).mean() < (0.3 + 0.04) ** 2


@pytest.mark.parametrize("cosine", [0.9, 0.4])
def test_a_white_ball_in_a_white_sky_reflects_all_of_it_and_a_gloss(caches, cosine):
    scene = AnalyticScene((Sphere((0, 0, 0), 1.0, Surface(albedo=(1.0, 1.0, 1.0))),))
    sine = np.sqrt(1 - cosine**2)
    viewer = (0.0, 1000.0 * sine, 1.0 + 1000.0 * cosine)
    samples = relit(caches, scene, even_sky(), (0.0, 0.0, 1.0), viewer)
    expected = by_definition(scene, even_sky(), (0.0, 0.0, 1.0), viewer)
    assert_mean(samples - expected, np.zeros(3))
    assert 1.0 < samples.mean() < 1.04


def test_a_black_surface_under_any_light_shows_its_gloss_only(caches):
    scene = AnalyticScene((Plane((0, 0, 0), (0, 0, 1), Surface(albedo=(0.0, 0.0, 0.0))),))
    samples = relit(caches, scene, even_sky(), (0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
    assert 0.0 < samples.mean() < 0.04


def test_a_mirror_shows_the_sky_it_reflects(caches):
    mirror = Surface(albedo=(0.9, 0.9, 0.9), perceptual_roughness=0.05, metalness=1.0)
    scene = AnalyticScene((Plane((0, 0, 0), (0, 0, 1), mirror),))
    rows = np.linspace(2.0, 1.0, 32)[:, None, None] * np.array([1.0, 0.5, 0.25])
    gradient = environment_from_array(np.broadcast_to(rows, (32, 64, 3)))
    samples = relit(caches, scene, gradient, (0.0, 0.0, 0.0), (-3.0, 0.0, 2.0), count=400)
    reflected = gradient.lookup(np.array([[3.0, 0.0, 2.0]]) / np.sqrt(13.0))[0]
    np.testing.assert_allclose(samples.mean(axis=0), 0.9 * reflected, rtol=0.03)


def test_relighting_is_linear_in_the_light(caches):
    first, second = sky(1), sky(2)
    both = environment_from_array(0.5 * first.radiance + 2.0 * second.radiance)
    arguments = (SHADED, (0.4, 0.3, 0.0), (1.0, -2.0, 1.5))

    def estimates(environment, seed):
        return relit(caches, arguments[0], environment, *arguments[1:], seed=seed)

    difference = estimates(both, 3) - 0.5 * estimates(first, 4) - 2.0 * estimates(second, 5)
    assert_mean(difference, np.zeros(3))


@pytest.mark.parametrize(("rays", "num_samples"), [(1, 16), (4, 4)])
def test_the_stated_standard_error_is_the_spread_of_repeated_renders(caches, rays, num_samples):
    scene, environment = SHADED, sky()
    count = 5000
    pixels = fours(count) if rays == 4 else PixelRays.alone(count)
    points = surface_points(scene, (0.4, 0.3, 0.0), (1.0, -2.0, 1.5), rays * count)
    around = CacheSurroundings(caches(scene), scene.origin_offset, MaterialEdit())
    lit = Scene(around, Light(environment, LightSampler(environment)))
    radiance = outgoing_radiance(points, lit, num_samples=num_samples, seed=1, pixels=pixels)
    assert radiance.num_samples == num_samples
    total = pixels.mean(radiance.direct + radiance.indirect)
    deviations = (total - total.mean(axis=0)) ** 2
    assert_mean(
        deviations * count / (count - 1) - radiance.standard_error.astype(np.float64) ** 2, np.zeros(3)
    )


def test_rays_of_a_pixel_are_quieter_together_and_no_less_by_themselves(caches):
    environment, count = sky(), 400
    points = surface_points(CORNER, (0.5, 0.0, 0.0), (2.0, 1.0, 1.5), 4 * count)
    around = CacheSurroundings(caches(CORNER), CORNER.origin_offset, MaterialEdit())
    scene = Scene(around, Light(environment, LightSampler(environment)), indirect=False)
    pixels = fours(count)
    spread, single = {}, {}
    for name, rays in (("shared", pixels), ("own", PixelRays.alone(4 * count))):
        found = outgoing_radiance(points, scene, num_samples=16, seed=2, pixels=rays)
        total = (found.direct + found.indirect).astype(np.float64)
        spread[name] = pixels.mean(total).var(axis=0)
        single[name] = total.reshape(count, 4, 3)[:, 0].var(axis=0)
    # The F-test's 1e-4 quantile for two variances of 400 samples is 0.69.
    assert (spread["shared"] < 0.69 * spread["own"]).all()
    assert (single["shared"] < single["own"] / 0.69).all()


class Veil:
    """Answers every secondary ray alike: a half-transparent white wall at distance 2."""

    name = "veil"

    def __init__(self, opacity: float) -> None:
        self.opacity = opacity
        self.asked: list[np.ndarray] = []

    def gbuffer(self, origin, direction):
        ones = np.ones((len(origin), 1), np.float32)
        return PrimaryHits(self.opacity * ones, 2 * ones, -direction, 0.5 * ones * np.ones(3), ones, 0 * ones)

    def secondary(self, origin, direction):
        self.asked.append(origin + 2.0 * direction)
        ones = np.ones((len(origin), 1), np.float32)
        return SecondaryHits(np.float32(self.opacity) * ones, 2.0 * ones)

    def material(self, position):
        self.hits = position
        ones = np.ones((len(position), 1), np.float32)
        return PointMaterials(ones * np.ones(3, np.float32), ones, ones, -position)


def veiled(opacity: float, *, seed: int, count: int = 3000):
    veil = Veil(opacity)
    points = surface_points(SHADED, (0.0, 0.0, 0.0), (1.0, -2.0, 1.5), count)
    light = Light(even_sky(), LightSampler(even_sky()))
    scene = Scene(CacheSurroundings(veil, 0.0, MaterialEdit()), light)
    return veil, outgoing_radiance(points, scene, num_samples=4, seed=seed)


def test_a_half_transparent_hit_shades_and_blocks_by_its_opacity():
    clear = veiled(0.0, seed=2)[1]
    assert (clear.indirect == 0.0).all()
    for opacity in (0.4, 0.8):
        radiance = veiled(opacity, seed=2)[1]
        np.testing.assert_allclose(radiance.direct, (1 - opacity) * clear.direct, rtol=1e-5)
    # Of the thinnest, not every hit is followed.
    opacities = (0.1, 0.4, 0.8)
    thinnest, thin, thick = (
        veiled(o, seed=s)[1].indirect.astype(np.float64) for s, o in enumerate(opacities, start=3)
    )
    # What a hit adds is proportional to opacity times the visibility of the hit, which is 1 - opacity.
    assert_mean(thin / (0.4 * 0.6) - thick / (0.8 * 0.2), np.zeros(3))
    assert_mean(thin / (0.4 * 0.6) - thinnest / (0.1 * 0.9), np.zeros(3))
    assert thin.mean() > 0.0


def test_hits_are_shaded_where_the_distance_says():
    veil, _ = veiled(1.0, seed=5, count=50)
    # Blocked everywhere, every active ray is followed, so the last pass asked about exactly these points.
    np.testing.assert_allclose(veil.hits, veil.asked[-2], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(veil.hits, axis=-1), 2.0, rtol=1e-5)


def test_half_covered_pixels_are_mixed_with_what_is_behind_them(cube):
    renderer = Renderer(cube.bundle, num_threads=1, reader="onnx")
    renderer.caches = Veil(0.25)
    camera = camera_at((3.0, 0.0, 0.0))
    plain = renderer.render(camera, sky(), spp=4)
    mixed = renderer.render(camera, sky(), spp=4, background=(1.0, 2.0, 3.0))
    assert (plain.opacity == 0.25).all()
    np.testing.assert_allclose(mixed.rgb, 0.25 * plain.rgb + 0.75 * np.array([1.0, 2.0, 3.0]), rtol=1e-5)
    np.testing.assert_allclose(mixed.standard_error, 0.25 * plain.standard_error, rtol=1e-5)


def camera_at(position, *, side: int = 6, name: str = "view") -> Camera:
    return Camera.centred(name, side, side, 4.0 * side, look_at(position, (0.0, 0.0, 0.0)))


@pytest.fixture(scope="module")
def cube(tmp_path_factory) -> Renderer:
    scene = AnalyticScene((Box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)),))
    folder = write_analytic_bundle(tmp_path_factory.mktemp("cube") / "cube.relight", scene)
    return Renderer(load_bundle(folder), num_threads=1)


FACES = {f"{sign}{axis}": None for axis in "xyz" for sign in "+-"}


@pytest.mark.parametrize("case", GOLDEN["cases"], ids=lambda c: f"{c['row']},{c['column']},{c['rotate_deg']}")
def test_one_texel_lights_the_golden_face_of_a_cube(cube, case):
    image = np.zeros((GOLDEN["height"], GOLDEN["width"], 3), np.float32)
    image[case["row"], case["column"]] = 10.0
    environment = environment_from_array(image)
    brightness = {}
    for face in FACES:
        normal = np.zeros(3)
        normal["xyz".index(face[1])] = 1.0 if face[0] == "+" else -1.0
        picture = cube.render(
            camera_at(3.0 * normal, side=3), environment, rotate_deg=case["rotate_deg"], spp=16
        )
        assert (picture.opacity == 1.0).all()
        np.testing.assert_allclose(picture.normal, np.broadcast_to(normal, (3, 3, 3)), atol=1e-6)
        brightness[face] = picture.rgb.mean()
        if normal @ np.array(case["direction"]) < -0.5:
            assert brightness[face] == 0.0
    assert max(brightness, key=brightness.get) == case["lit_face"]


def test_turning_the_light_is_turning_the_map(cube):
    image = sky(3).radiance
    camera = camera_at((2.0, 1.5, 1.0))
    rolled_map = environment_from_array(np.roll(image, -4, axis=1))
    turned = cube.render(camera, environment_from_array(image), rotate_deg=90.0, spp=512)
    rolled = cube.render(camera, rolled_map, spp=512, seed=1)
    straight = cube.render(camera, environment_from_array(image), spp=512)
    error = np.sqrt(turned.standard_error**2 + rolled.standard_error**2)
    assert np.abs((turned.rgb - rolled.rgb) / error).mean() < 1.5
    assert np.abs((straight.rgb - rolled.rgb) / error).mean() > 3.0


def test_equal_seeds_give_equal_pictures_and_other_seeds_do_not(cube):
    camera = camera_at((2.0, 1.5, 1.0))
    first, again, other = (cube.render(camera, sky(), spp=8, seed=seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.rgb, again.rgb)
    assert np.abs(first.rgb - other.rgb).max() > 0.0


def test_pictures_are_the_same_for_any_number_of_threads(caches, monkeypatch):
    monkeypatch.setattr("lambent_relight.refined.shading.RAYS_PER_CHUNK", 1 << 8)
    environment, finished = sky(), []
    points = surface_points(SHADED, (0.7, 0.2, 0.0), (1.0, -2.0, 2.0), 400)
    around = CacheSurroundings(caches(SHADED), SHADED.origin_offset, MaterialEdit())
    light = Light(environment, LightSampler(environment))
    results = [
        outgoing_radiance(
            points,
            Scene(around, light, num_threads=num_threads),
            num_samples=16,
            seed=3,
            progress=finished.append,
        )
        for num_threads in (1, 3)
    ]
    for name in ("direct", "indirect", "specular", "visibility", "standard_error"):
        np.testing.assert_array_equal(*(getattr(result, name) for result in results))
    half = len(finished) // 2
    assert finished[:half] == finished[half:] == sorted(finished[:half])
    assert finished[-1] == 1.0
