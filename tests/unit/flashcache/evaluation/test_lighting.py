"""Pictures under the light of the photographs: the mean that training estimates, with less noise."""

import math

import pytest
import torch
from flashcache.evaluation.lighting import lit_radiance, sky_sampler
from flashcache.evaluation.monte_carlo import RenderRule, _by_blocks
from flashcache.evaluation.views import PictureSamples, render_physical, render_relit
from flashcache.geometry.directions import direction_from_uv, normalize
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig, control_variate
from flashcache.physical.incident import LightSources
from flashcache.physical.model import InverseModel
from flashcache.physical.sampling import EnvironmentMapSampler
from flashcache.physical.shading import ShadingPoints
from support.lit_sphere import camera
from support.sphere_model import sphere_model
from support.statistics import assert_mean

COUNT = 3000


@pytest.fixture(scope="module")
def model() -> InverseModel:
    return sphere_model(lights=("sky",)).requires_grad_(False).eval()


def copies_of_a_point() -> ShadingPoints:
    normal = normalize(torch.tensor([[0.3, -0.2, 0.9]])).expand(COUNT, 3)
    omega_o = normalize(torch.tensor([[0.6, 0.2, 0.8]])).expand(COUNT, 3)
    return ShadingPoints(0.5 * normal, normal, omega_o, torch.zeros(COUNT, dtype=torch.long))


@pytest.mark.parametrize("from_sky", [False, True])
@pytest.mark.parametrize("rule", [RenderRule(), RenderRule(control_variate="fast_only", sampler="none")])
def test_pictures_have_the_mean_that_training_estimates(model, rule, from_sky):
    points = copies_of_a_point()
    mixture = model.light_sampler(points.positions, points.light_index) if rule.sampler == "vmf" else None
    generators = [torch.Generator().manual_seed(seed) for seed in (1, 2)]
    with torch.no_grad():
        sky = sky_sampler(model, 0) if from_sky else None
        found = lit_radiance(model, points, num_directions=16, rule=rule, generator=generators[0], sky=sky)
        expected = control_variate(
            points,
            model.materials(points.positions),
            LightSources(
                model.nerf_source(generators[1]), model.environment, model.limits, model.fast_source()
            ),
            mixture=mixture,
            config=EstimatorConfig(
                fast=DirectionCounts.split(16),
                exact=DirectionCounts.split(8),
                control_variate=rule.control_variate,
                sampler=rule.sampler,
                stratified=True,
            ),
            generator=generators[1],
        ).rgb
    assert_mean(found.double() - expected.double(), torch.zeros(3))


def test_the_correction_is_no_small_part_of_that_mean(model):
    """Or the test above would not notice its sign."""
    points, generator = copies_of_a_point(), torch.Generator().manual_seed(1)
    with torch.no_grad():
        whole, fast = (
            lit_radiance(
                model,
                points,
                num_directions=16,
                rule=RenderRule(control_variate=variate),
                generator=generator,
            ).mean(dim=0)
            for variate in ("on", "fast_only")
        )
    assert float(((whole - fast) / whole).abs().max()) > 0.1


@pytest.mark.parametrize("sampler", ["vmf", "none"])
def test_a_lamp_of_the_learned_light_makes_no_noise(sampler):
    """The light sampler has not learned it: a polish finds it sharper than stage two did."""
    model = sphere_model(lights=("sky",)).requires_grad_(False).eval()
    texture = torch.full((40, 40, 3), 0.2)
    texture[12:14, 22:24] = 60.0
    model.environment.set_texture(texture.reshape(1, -1, 3))
    points, spread = copies_of_a_point(), []
    for sky in (None, sky_sampler(model, 0)):
        generator = torch.Generator().manual_seed(5)
        rule = RenderRule(control_variate="fast_only", sampler=sampler)
        with torch.no_grad():
            found = lit_radiance(model, points, num_directions=16, rule=rule, generator=generator, sky=sky)
        spread.append(float(found.std(dim=0).mean()))
    assert spread[1] < 0.5 * spread[0]


def test_every_light_is_drawn_from_by_itself():
    model = sphere_model(lights=("even", "lamp")).requires_grad_(False).eval()
    texture = torch.full((2, 40, 40, 3), 0.2)
    texture[1, 12:14, 22:24] = 60.0
    model.environment.set_texture(texture.reshape(2, -1, 3))
    picture = model.environment.image(64, 1).sum(dim=-1)
    row, column = divmod(int(picture.argmax()), picture.shape[1])
    towards = direction_from_uv(torch.tensor([[(column + 0.5) / 128, (row + 0.5) / 64]]))[None]
    even, lamp = (float(sky_sampler(model, light).pdf(towards)) for light in (0, 1))
    assert even == pytest.approx(1.0 / (4.0 * math.pi), rel=0.05)
    assert lamp > 20.0 * even


def test_rays_of_a_pixel_follow_each_other():
    order = _by_blocks(camera(0.4, 0.3, side=4), 2, torch.device("cpu"))
    assert order[:8].tolist() == [0, 1, 4, 5, 2, 3, 6, 7]
    assert sorted(order.tolist()) == list(range(16))
    assert _by_blocks(camera(0.4, 0.3, side=4), 1, torch.device("cpu")).tolist() == list(range(16))


@pytest.mark.parametrize("render", ["physical", "relit"])
def test_points_of_a_pixel_avoid_each_others_directions_in_pictures(model, monkeypatch, render):
    """Asked with what: the lattice has to reach the estimator from the pictures."""
    asked, strategies = [], []
    import flashcache.evaluation.lighting as lighting
    import flashcache.evaluation.relighting as relighting

    for module in (lighting, relighting):
        own = module.relight

        def noted(*arguments, own=own, **settings):
            asked.append(settings.get("continued", False))
            strategies.append(type(settings["light"]))
            return own(*arguments, **settings)

        monkeypatch.setattr(module, "relight", noted)
    view, samples = camera(0.4, 0.3, side=6), PictureSamples(num_directions=16, antialias=2)
    if render == "physical":
        render_physical(model, view, samples)
    else:
        sky = torch.ones(8, 16, 3).numpy()
        render_relit(model, view, sky, samples, indirect=False)
    assert asked
    assert all(asked)
    assert set(strategies) == {EnvironmentMapSampler}
