"""No light is lost on the way: pictures through the mesh against brute force and the white furnace."""

import numpy as np
import pytest
from lambent_relight import Renderer, environment_from_array, load_bundle, turntable
from lambent_relight.refined.known_light import Spread
from support.analytic_scene import trace
from support.baked_bundle import SCENE, write_baked_bundle
from support.brute_force import reflected_samples
from support.statistics import assert_mean

pytestmark = pytest.mark.slow

CAMERA = turntable(1, radius=4.0, elevation_deg=35.0, width=24, height=24)[0]


@pytest.fixture(scope="module")
def renderer(tmp_path_factory):
    folder = write_baked_bundle(tmp_path_factory.mktemp("energy") / "boxes.relight")
    return Renderer(load_bundle(folder), num_threads=1, reader="onnx")


def sky():
    radiance = np.random.default_rng(2).uniform(0.2, 1.0, (4, 8, 3)).repeat(8, 0).repeat(8, 1)
    radiance[6:8, 10:12] += 9.0
    return environment_from_array(radiance)


def brute_force(light, bounces, *, count=60, per_sample=20):
    """Return independent pictures [count, pixel, 3] by the definition, and which pixels the object covers."""
    origin, direction = CAMERA.rays()
    distance, hits = trace(SCENE, origin.astype(np.float64), direction.astype(np.float64))
    seen = np.flatnonzero(hits[:, 0])
    place, omega_o = (origin + distance * direction)[seen], -direction[seen].astype(np.float64)
    rng, pictures = np.random.default_rng(5), []
    for _ in range(count):
        samples = reflected_samples(
            SCENE,
            np.repeat(place, per_sample, axis=0),
            np.repeat(omega_o, per_sample, axis=0),
            light.lookup,
            rng=rng,
            bounces=bounces - 1,
        )
        pictures.append(samples.reshape(len(seen), per_sample, 3).mean(axis=1))
    return np.stack(pictures), seen


@pytest.mark.parametrize("bounces", [1, 2, 4])
@pytest.mark.parametrize("occlusion", ["mesh", "cache"])
def test_the_light_of_a_number_of_bounces_is_that_of_brute_force(renderer, bounces, occlusion):
    light = sky()
    expected, seen = brute_force(light, bounces)
    ours = np.stack(
        [
            renderer.render(
                CAMERA, light, spp=16, antialias=1, seed=seed, bounces=bounces, occlusion=occlusion
            ).rgb.reshape(-1, 3)[seen]
            for seed in range(40)
        ]
    )
    # Whole pictures, and the foot of the block by itself, where most is in the way.
    count = min(len(ours), len(expected))
    openness = renderer.render(CAMERA, light, spp=64, antialias=1).visibility.reshape(-1)[seen]
    foot = np.argsort(openness)[: len(seen) // 5]
    for part in (slice(None), foot):
        difference = ours[:count, part].mean(axis=1, dtype=np.float64) - expected[:count, part].mean(axis=1)
        assert_mean(difference, np.zeros(3))


def test_a_limit_of_bounces_is_reached_by_the_transport_of_all(renderer):
    light = sky()
    many = renderer.render(CAMERA, light, spp=512, bounces=8)
    transport = renderer.render(CAMERA, light, spp=512, bounces="transport")
    assert (many.bounces, transport.bounces) == ("8", "transport")
    assert transport.indirect.sum() / many.indirect.sum() == pytest.approx(1.0, abs=0.05)
    assert transport.rgb.sum() / many.rgb.sum() == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("occlusion", ["mesh", "cache"])
def test_baked_diffuse_light_has_the_energy_of_rays_at_contacts_too(renderer, occlusion, monkeypatch):
    way = {"spp": 512, "antialias": 1, "occlusion": occlusion}
    sampled = renderer.render(CAMERA, sky(), bounces="transport", **way)
    mixed = renderer.render(CAMERA, sky(), bounces="baked", **way)
    # Nothing of it from rays: what is compared is the bake.
    monkeypatch.setattr(Spread, "best_shares", lambda self, mean: np.zeros((2, len(mean))))
    alone = renderer.render(CAMERA, sky(), bounces="baked", **way)
    assert (sampled.bounces, mixed.bounces, alone.bounces) == ("transport", "baked", "baked")
    seen = sampled.coverage[..., 0] > 0.99
    foot = seen & (sampled.visibility[..., 0] < np.quantile(sampled.visibility[seen], 0.2))
    for part, most in ((seen, 0.01), (foot, 0.02)):
        assert alone.rgb[part].sum() / sampled.rgb[part].sum() == pytest.approx(1.0, abs=most)
        assert mixed.rgb[part].sum() / sampled.rgb[part].sum() == pytest.approx(1.0, abs=most)
    assert np.abs(alone.indirect - sampled.indirect)[seen].max() > 0.0
    errors = [picture.standard_error[seen].mean() for picture in (mixed, alone, sampled)]
    assert errors[0] < 0.99 * errors[1]
    # Rays are as good as the mixture here: it may only cost what chance in the shares does.
    assert errors[0] < 1.01 * errors[2]


def test_pictures_take_baked_diffuse_light_where_the_mesh_is_traced(renderer):
    assert renderer.render(CAMERA, sky(), spp=2).bounces == "baked"
    assert renderer.render(CAMERA, sky(), spp=2, occlusion="cache").bounces == "transport"


def test_directions_by_need_move_no_mean(renderer):
    """The darkest fifth by itself, where chance decides most about what is needed."""
    way = {"antialias": 1, "bounces": "transport"}
    light = sky()
    steady = renderer.render(CAMERA, light, spp=256, **way)
    seen = steady.coverage[..., 0] > 0.0
    dark = seen & (steady.rgb.mean(axis=-1) < np.quantile(steady.rgb[seen].mean(axis=-1), 0.2))
    found = {}
    for name, settings in (("by need", {"spp": 6, "until_stderr": 0.06}), ("alike", {"spp": 32})):
        pictures = [renderer.render(CAMERA, light, seed=seed, **settings, **way) for seed in range(40)]
        found[name] = np.array(
            [[p.rgb[part].mean(dtype=np.float64) for part in (seen, dark)] for p in pictures]
        )
        assert np.mean([picture.num_samples for picture in pictures]) > 8
    assert_mean(found["by need"] - found["alike"], np.zeros(2))
    assert found["by need"].mean(axis=0) == pytest.approx(found["alike"].mean(axis=0), rel=0.01)


def test_directly_lit_pictures_are_those_of_one_bounce(renderer):
    one = renderer.render(CAMERA, sky(), spp=16, bounces=1)
    direct = renderer.render(CAMERA, sky(), spp=16, indirect=False)
    np.testing.assert_array_equal(one.rgb, direct.rgb)
    assert one.indirect.max() == 0.0
    assert renderer.render(CAMERA, sky(), spp=16, bounces="one").bounces == "one"


def test_a_convex_object_in_an_even_light_has_no_shadow_even_from_below_its_surface(renderer):
    traced = renderer.baked().traced
    rng = np.random.default_rng(0)
    place = rng.uniform(-0.39, 0.39, (500, 3))
    place[:, 2] = 0.4 + rng.uniform(-0.02, 0.02, 500)
    towards = rng.normal(size=(500, 3))
    towards[:, 2] = np.abs(towards[:, 2])
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    assert not traced.meet(place.astype(np.float32), towards.astype(np.float32)).opacity.any()
