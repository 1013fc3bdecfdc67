"""A cache adapted to a light is added to a bundle, found again, and used for that light and material."""

import logging
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from flashcache.export.reference import GbufferRule
from flashcache.training.light_bake import adaptable
from lambent_asset.light_bake.adapted_bundle import write_adapted
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_relight import MaterialEdit, Renderer, SettingError, environment_from_array, load_bundle
from lambent_relight.brdf import Materials
from lambent_relight.bundle.adapted import AdaptedLight, adapted_lights, choose, environment_digest, misfit
from lambent_relight.bundle.graphs import AdaptedHits, OnnxCaches, SecondaryHits
from lambent_relight.environment.light_sampling import LightSampler
from lambent_relight.fused.reader import FusedCaches
from lambent_relight.refined.passes import Light, Scene
from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import outgoing_radiance
from lambent_relight.refined.surroundings import CacheSurroundings
from support.network_bundle import write_network_bundle
from support.sphere_model import sphere_model

RULE = GbufferRule(box_min=(-0.8,) * 3, box_max=(0.8,) * 3, num_samples=32)
SKY = environment_from_array(np.random.default_rng(1).uniform(0.1, 1.0, (8, 16, 3)))
LIGHT = AdaptedLight(
    name="studio", environment_sha256=environment_digest(SKY), rotate_deg=30.0, albedo_ratio=(1.0, 1.0, 1.0)
)


@pytest.fixture(scope="module", params=[False, True], ids=["float32", "float16"])
def made(request, tmp_path_factory):
    """Return a bundle with an adapted cache, and that cache."""
    folder = tmp_path_factory.mktemp("bundle")
    model = sphere_model(lights=("sky",))
    with torch.no_grad():
        for grid in (model.nerf.density.grid, model.materials.grid, model.fast.distance_grid):
            grid.table.copy_(grid.table.half().float())
        model.fast.feature_grid.table.copy_(model.fast.feature_grid.table.half().float())
        if model.nerf.normals.grid is not None:
            model.nerf.normals.grid.table.copy_(model.nerf.normals.grid.table.half().float())
    plain = write_network_bundle(folder / "plain", model, RULE, half_tables=request.param)
    cache = adaptable(model.fast, 0).eval()
    with torch.no_grad():
        cache.decoder_head.bias.add_(2.0)
        cache.feature_grid.table.mul_(1.3)
    write_adapted(load_bundle(plain), cache, LIGHT, folder / "adapted")
    return load_bundle(folder / "adapted"), cache, load_bundle(plain)


def rays(count: int = 700) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    origin = rng.uniform(-0.8, 0.8, (count, 3)).astype(np.float32)
    direction = rng.normal(size=(count, 3))
    return origin, (direction / np.linalg.norm(direction, axis=-1, keepdims=True)).astype(np.float32)


@torch.no_grad()
def test_both_readers_answer_as_the_cache_does(made):
    bundle, cache, _ = made
    origin, direction = rays()
    index = torch.zeros(len(origin), dtype=torch.long)
    wanted = cache(torch.from_numpy(origin), torch.from_numpy(direction), index)
    for reader in (FusedCaches(bundle), OnnxCaches(bundle)):
        found = reader.adapted("studio", origin, direction)
        np.testing.assert_allclose(found.radiance, wanted.near_radiance.numpy(), atol=2e-5, rtol=2e-5)
        np.testing.assert_allclose(found.opacity[:, 0], wanted.opacity.numpy(), atol=2e-5)
        np.testing.assert_allclose(found.distance[:, 0], wanted.distance.numpy(), atol=2e-5)


def test_what_was_in_the_bundle_stays_as_it_was(made):
    bundle, _, plain = made
    origin, direction = rays(50)
    assert bundle.graph_path("fast_cache") == plain.graph_path("fast_cache")
    assert bundle.weights.startswith(plain.weights)
    for kind in (FusedCaches, OnnxCaches):
        old, new = (kind(each).secondary(origin, direction) for each in (plain, bundle))
        np.testing.assert_array_equal(old.opacity, new.opacity)
    assert adapted_lights(plain) == []


def test_what_a_cache_was_adapted_to_is_read_back(made):
    assert adapted_lights(made[0]) == [LIGHT]


def test_a_cache_fits_its_own_light_and_material_alone():
    turned = SKY.rotated(390.0)
    assert misfit(LIGHT, turned, MaterialEdit()) == ""
    assert "another map" in misfit(LIGHT, replace(turned, radiance=1.01 * turned.radiance), MaterialEdit())
    assert "turned by 40" in misfit(LIGHT, SKY.rotated(40.0), MaterialEdit())
    assert "edited" in misfit(LIGHT, turned, MaterialEdit(roughness_scale=0.9))
    assert "edited" in misfit(LIGHT, turned, MaterialEdit(albedo=(0.5, 0.5, 0.5)))
    assert "multiplied" in misfit(LIGHT, turned, MaterialEdit(albedo_gain=(1.0, 1.1, 1.0)))
    scaled = replace(LIGHT, albedo_ratio=(2.0, 2.0, 2.0))
    assert misfit(scaled, turned, MaterialEdit(albedo_gain=(2.0, 2.0, 2.0))) == ""


def test_a_picture_says_where_its_bounced_light_came_from(made, caplog):
    bundle, _, plain = made
    renderer, camera = Renderer(bundle), bundle.cameras()[0].resized(6, 6)
    way = {"spp": 4, "antialias": 1}
    assert choose(bundle, SKY.rotated(30.0), MaterialEdit()) == (LIGHT, "")
    assert renderer.render(camera, SKY, rotate_deg=30.0, **way).bounces == "adapted:studio"
    assert renderer.render(camera, SKY, rotate_deg=30.0, bounces="one", **way).bounces == "one"
    assert renderer.render(camera, SKY, rotate_deg=30.0, indirect=False, **way).bounces == ""
    with caplog.at_level(logging.WARNING, "lambent_relight"):
        assert renderer.render(camera, SKY, **way).bounces == "one"
    assert "turned by 0" in caplog.text
    with pytest.raises(SettingError, match="turned by 0"):
        renderer.render(camera, SKY, bounces="adapted", **way)
    with pytest.raises(SettingError, match="no adapted caches"):
        Renderer(plain).render(camera, SKY, bounces="adapted", **way)


@pytest.mark.parametrize("occlusion", ["mesh", "cache", "auto"])
def test_a_mesh_that_was_asked_for_in_vain_is_told_once(made, caplog, monkeypatch, occlusion):
    renderer, camera = Renderer(made[0]), made[0].cameras()[0].resized(4, 4)
    # The bundle has no mesh; an adapted cache does not look at it.
    monkeypatch.setattr(renderer, "baked", lambda: SimpleNamespace(traced=None))
    with caplog.at_level(logging.WARNING, "lambent_relight"):
        for _ in range(2):
            way = {"spp": 4, "antialias": 1, "occlusion": occlusion}
            assert renderer.render(camera, SKY, rotate_deg=30.0, **way).bounces == "adapted:studio"
    assert caplog.text.count('occlusion="mesh" has no effect') == (occlusion == "mesh")


@pytest.mark.parametrize(
    ("adapted", "transport", "taken"),
    [(0.1, 0.3, "adapted:studio"), (0.3, 0.1, "one")],
    ids=["better", "worse"],
)
def test_a_cache_is_taken_on_its_own_only_if_it_was_found_better(made, caplog, adapted, transport, taken):
    bundle = made[0]
    judged = BundleManifest()
    judged.CopyFrom(bundle.manifest)
    judged.metrics.update({"adapted_error_studio": adapted, "transport_error_studio": transport})
    renderer = Renderer(replace(bundle, manifest=judged))
    camera, way = bundle.cameras()[0].resized(4, 4), {"rotate_deg": 30.0, "spp": 4, "antialias": 1}
    with caplog.at_level(logging.WARNING, "lambent_relight"):
        assert renderer.render(camera, SKY, **way).bounces == taken
    assert ("its error is 0.3, that of baked transport 0.1" in caplog.text) == (taken == "one")
    assert renderer.render(camera, SKY, bounces="adapted", **way).bounces == "adapted:studio"


def test_an_object_that_turns_the_other_way_is_in_the_light_it_was_adapted_to(made):
    camera = made[0].cameras()[0].resized(4, 4)
    picture = Renderer(made[0]).render(camera, SKY, object_rotate_deg=-30.0, spp=4, antialias=1)
    assert picture.bounces == "adapted:studio"


def test_matter_as_bright_as_the_sky_behind_it_does_not_show():
    """A furnace: what is hidden and what hides it send the same."""
    sky = environment_from_array(np.full((4, 8, 3), 0.7))
    count = 40
    rng = np.random.default_rng(0)
    up = np.broadcast_to(np.float32([0, 0, 1]), (count, 3))
    half = np.full((count, 1), 0.5, np.float32)
    points = SurfacePoints(
        np.zeros((count, 3), np.float32), up, up, Materials(0.6 * np.ones_like(up), half, half)
    )

    class Nothing:
        name = "nothing"

        def secondary(self, origin, direction):
            zero = np.zeros((len(origin), 1), np.float32)
            return SecondaryHits(zero, zero)

    def fog(origin, direction):
        opacity = rng.uniform(0.0, 1.0, (len(origin), 1)).astype(np.float32)
        return AdaptedHits(opacity=opacity, distance=opacity, radiance=np.float32(0.7) * opacity.repeat(3, 1))

    light = Light(sky, LightSampler(sky))
    empty = Scene(CacheSurroundings(Nothing(), 0.01, MaterialEdit()), light)
    arguments = {"num_samples": 16, "seed": 3}
    bare = outgoing_radiance(points, empty, **arguments)
    hidden = outgoing_radiance(points, replace(empty, adapted=fog), **arguments)
    np.testing.assert_allclose(hidden.direct + hidden.indirect, bare.direct, rtol=1e-5)
    assert 0.3 < float(hidden.indirect.mean() / bare.direct.mean()) < 0.7
