"""A bundle's fast cache is adapted, stopped and resumed, and refused where it cannot be."""

import math

import numpy as np
import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.export.reference import GbufferRule
from flashcache.physical.estimator import DirectionCounts
from flashcache.physical.incident import SecondaryRays
from flashcache.training.bake_scene import ModelScene
from flashcache.training.light_bake import BakeScene, LightBakeConfig
from lambent_asset.light_bake.bundle_scene import bundle_scene, cache_of
from lambent_core.errors import Stopped, UsageError
from lambent_relight import load_bundle, load_environment, write_environment
from lambent_relight.bundle.adapted import adapted_lights, environment_digest
from lambent_run.run.light_bake import BakeRequest, bake_light, light_image, mean_radiance
from support.network_bundle import write_network_bundle
from support.recording_reporter import RecordingReporter
from support.sphere_model import RADIUS, sphere_model

RULE = GbufferRule(box_min=(-0.8,) * 3, box_max=(0.8,) * 3, num_samples=64)
FEW = DirectionCounts(cosine=1, sampler=1, specular=2)
QUICK = LightBakeConfig(num_steps=3, num_points=8, fast=FEW)
ONES = torch.ones(3)


@pytest.fixture(scope="module")
def model():
    return sphere_model(lights=("sky",))


@pytest.fixture(scope="module")
def bundle(model, tmp_path_factory):
    return write_network_bundle(tmp_path_factory.mktemp("made") / "plain", model, RULE)


@pytest.fixture(scope="module")
def sky(tmp_path_factory):
    path = tmp_path_factory.mktemp("maps") / "high noon.exr"
    write_environment(path, np.random.default_rng(0).uniform(0.2, 2.0, (8, 16, 3)), half=False)
    return path


def rays_from(points) -> SecondaryRays:
    origins = points.positions + 0.01 * points.normal
    return SecondaryRays(origins, points.normal, 0.05, 2.0, points.light_index)


@torch.no_grad()
def test_the_cache_of_a_bundle_is_the_one_it_was_made_from(model, bundle):
    cache = cache_of(load_bundle(bundle), "sky")
    origin = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) - 0.5
    direction = torch.nn.functional.normalize(origin.flip(-1) + 0.1, dim=-1)
    index = torch.zeros(50, dtype=torch.long)
    for found, wanted in zip(
        cache(origin, direction, index), model.fast(origin, direction, index), strict=True
    ):
        torch.testing.assert_close(found, wanted, atol=1e-6, rtol=1e-6)


@torch.no_grad()
@pytest.mark.parametrize("kind", ["run", "bundle"])
def test_both_scenes_start_on_the_ball_and_face_who_looks(model, bundle, kind):
    scene: BakeScene = bundle_scene(load_bundle(bundle), 0.5 * ONES, num_threads=1)
    if kind == "run":
        scene = ModelScene(model, scene.viewpoints, scene.box, 0.5 * ONES)
    points = scene.starts(64, torch.Generator().manual_seed(1))
    assert 5 < len(points.positions) <= 64
    assert float((points.positions.norm(dim=-1) - RADIUS).abs().mean()) < 0.1
    assert bool(((points.normal * points.omega_o).sum(dim=-1) >= -1e-5).all())
    wanted = 0.5 * model.materials(points.positions).albedo
    torch.testing.assert_close(scene.materials(points.positions).albedo, wanted, atol=1e-4, rtol=1e-4)
    rays = rays_from(points)
    met = scene.meet(rays, torch.Generator().manual_seed(2))
    fast = model.fast(rays.origins, rays.directions, rays.light_index)
    known = model.ask_nerf(rays, None) if kind == "run" else fast
    torch.testing.assert_close(met.opacity, known.opacity, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(met.weight, known.opacity, atol=1e-4, rtol=1e-4)
    if kind == "bundle":
        places = rays.origins + fast.distance[:, None] * rays.directions
        torch.testing.assert_close(met.positions, places, atol=1e-3, rtol=1e-3)


def test_a_baked_bundle_names_its_light_and_equal_seeds_agree(bundle, sky, tmp_path):
    request = BakeRequest(
        environment=sky, rotate_deg=400.0, albedo_ratio=(0.5, 0.6, 0.7), config=QUICK, seed=4
    )
    found = [bake_light(bundle, tmp_path / name, request, RecordingReporter()) for name in ("a", "b")]
    made = load_bundle(tmp_path / "a")
    assert adapted_lights(made) == [found[0]]
    assert found[0].name == "high_noon"
    assert found[0].rotate_deg == pytest.approx(40.0)
    assert found[0].environment_sha256 == environment_digest(load_environment(sky))
    assert made.weights == load_bundle(tmp_path / "b").weights
    assert made.manifest.metrics["adapted_error_high_noon"] > 0.0
    assert "transport_error_high_noon" not in made.manifest.metrics, "this bundle has no baked transport"
    assert not (tmp_path / "a.work").exists()


def test_a_stopped_bake_goes_on_to_the_same_result(bundle, sky, tmp_path):
    request = BakeRequest(environment=sky, config=QUICK)
    bake_light(bundle, tmp_path / "whole", request, RecordingReporter())

    class Impatient(RecordingReporter):
        def should_stop(self) -> bool:
            return True

    with pytest.raises(Stopped):
        bake_light(bundle, tmp_path / "parts", request, Impatient())
    assert (tmp_path / "parts.work").is_dir()
    bake_light(bundle, tmp_path / "parts", request, RecordingReporter())
    assert load_bundle(tmp_path / "parts").weights == load_bundle(tmp_path / "whole").weights


def test_a_second_light_joins_the_first(bundle, sky, tmp_path):
    bake_light(bundle, tmp_path / "one", BakeRequest(environment=sky, config=QUICK), RecordingReporter())
    again = BakeRequest(environment=sky, config=QUICK, name="other", rotate_deg=90.0)
    bake_light(tmp_path / "one", tmp_path / "two", again, RecordingReporter())
    lights = adapted_lights(load_bundle(tmp_path / "two"))
    assert [(light.name, light.rotate_deg) for light in lights] == [("high_noon", 0.0), ("other", 90.0)]


def test_what_cannot_be_done_is_refused_with_a_code(bundle, sky, tmp_path):
    def refused(source, out, **fields) -> str:
        with pytest.raises(UsageError) as error:
            bake_light(source, out, BakeRequest(config=QUICK, **fields), RecordingReporter())
        return error.value.code

    assert refused(bundle, bundle, environment=sky) == "bake.exists"
    assert refused(bundle, tmp_path / "x", environment=sky, name="sky") == "bake.name_taken"
    assert refused(bundle, tmp_path / "x", environment=tmp_path / "no.exr") == "environment.missing"
    assert refused(tmp_path, tmp_path / "x", environment=sky) == "bundle.manifest_missing"


@pytest.mark.parametrize(
    ("name", "value"),
    [("albedo_ratio", (1.0, 0.0, 1.0)), ("albedo_ratio", (1.0, 1.0, math.nan)), ("rotate_deg", math.inf)],
)
def test_a_request_that_means_nothing_is_refused_whoever_makes_it(sky, name, value):
    with pytest.raises(ConfigError, match=name):
        BakeRequest(environment=sky, **{name: value})


def test_a_turned_map_keeps_its_light_and_moves_it(sky):
    environment = load_environment(sky)
    still, turned = light_image(environment), light_image(environment.rotated(90.0))
    assert mean_radiance(turned) == pytest.approx(mean_radiance(still), rel=1e-5)
    # +90 degrees about z carry +x to +y, a quarter of the columns to the left.
    np.testing.assert_allclose(turned, np.roll(still, -4, axis=1), rtol=1e-4)
