"""A light bake finds the radiance of equilibrium, and changes nothing of the cache but its radiance."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.config import Rates
from flashcache.errors import ConfigError
from flashcache.evaluation.relighting import MapLight
from flashcache.physical.estimator import DirectionCounts
from flashcache.physical.incident import SecondaryRays
from flashcache.training.light_bake import LightBake, LightBakeConfig, adaptable
from support.bake_scenes import Fog, small_cache
from support.statistics import assert_mean

NONE = DirectionCounts(cosine=0, sampler=0, specular=0)
FEW = DirectionCounts(cosine=1, sampler=1, specular=2)
QUICK = LightBakeConfig(
    num_steps=30, num_points=24, fast=FEW, rates=Rates(grid=2e-2, network=1e-2), final_rate=0.02
)
BELIEVED = 0.5  # the opacity of the cache of these tests
RADIANCE = ("feature_grid.", "decoder.", "decoder_head.")


def constant_light(value: float) -> MapLight:
    return MapLight.from_image(np.full((8, 16, 3), value, np.float32), torch.device("cpu"))


def lamp() -> MapLight:
    image = np.full((8, 16, 3), 0.05, np.float32)
    image[2, 3] = (20.0, 10.0, 5.0)
    return MapLight.from_image(image, torch.device("cpu"))


def bake(fast, scene, light, config=QUICK, *, brightness=1.0, seed=0) -> LightBake:
    return LightBake(adaptable(fast, 0), scene, light, config, brightness=brightness, seed=seed)


def finished(state: LightBake) -> LightBake:
    while not state.finished:
        state.step()
    return state


def seen_along(state: LightBake, seed: int = 5) -> tuple[torch.Tensor, torch.Tensor]:
    rays = state.taught_rays(torch.Generator().manual_seed(seed))
    with torch.no_grad():
        answer = state.model(rays.origins, rays.directions, rays.light_index)
    return answer.near_radiance, answer.opacity


def test_white_walls_under_a_constant_light_tend_to_the_furnace():
    # What hides a share `a` of a constant light and reflects all of it sends `a` of it: nothing shows.
    # 0.97 is diffuse and about 0.03 comes from the highlight.
    state = bake(small_cache(), Fog(BELIEVED, 0.97), constant_light(2.0), brightness=2.0)
    before, opacity = seen_along(state)
    near, _ = seen_along(finished(state))
    assert float(opacity.mean()) == pytest.approx(BELIEVED)
    assert float(before.mean()) < 0.2
    # So few steps leave three to four percent of the last bounces.
    assert float(near.mean()) == pytest.approx(2.0 * BELIEVED, rel=0.06)
    assert float(near.std() / near.mean()) < 0.05


@pytest.mark.parametrize("told", [0.2, BELIEVED, 0.9])
def test_estimate_is_what_is_met_and_not_what_the_cache_believes_of_the_first_bounce(told):
    """The correction takes away what is between the cache's opacity and what really is there."""
    scene = Fog(told, 0.8)
    state = bake(small_cache(), scene, constant_light(1.0))
    with torch.no_grad():
        state.model.decoder_head.weight.zero_()
        state.model.decoder_head.bias.fill_(-30.0)  # a cache that sends nothing
    rays = state.taught_rays(torch.Generator().manual_seed(1))
    rays = SecondaryRays(rays.origins[:1], rays.directions[:1], rays.near, rays.far, rays.light_index[:1])
    many = SecondaryRays(
        rays.origins.expand(4000, 3),
        rays.directions.expand(4000, 3),
        rays.near,
        rays.far,
        rays.light_index.expand(4000),
    )
    with torch.no_grad():
        found = state.radiance(many, torch.Generator().manual_seed(2))[:, 0]
    reflectance = _reflectance(scene)
    # Two bounces: light past the true wall, and what the wall met then reflects past the believed one.
    once = reflectance * (1.0 - told)
    twice = reflectance * told * reflectance * (1.0 - BELIEVED)
    assert_mean(found, told * (once + twice))


def _reflectance(scene: Fog) -> float:
    """Return what a wall seen straight on reflects of a constant light, by quadrature."""
    from flashcache.physical.brdf import lambert_cos, specular_brdf_cos

    u = (torch.arange(400, dtype=torch.float64) + 0.5) / 400
    cosine, azimuth = torch.meshgrid(u, 2.0 * torch.pi * u, indexing="ij")
    sine = (1.0 - cosine**2).sqrt()
    omega_i = torch.stack([sine * azimuth.cos(), sine * azimuth.sin(), cosine], dim=-1).reshape(-1, 3)
    up = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).expand_as(omega_i)
    materials = scene.materials(up)
    terms = scene.albedo * lambert_cos(omega_i, up) + specular_brdf_cos(up, omega_i, up, materials)
    return float(terms[:, 0].mean() * 2.0 * torch.pi)


def test_only_the_radiance_learns():
    state = bake(small_cache(), Fog(0.6, 0.5), lamp(), replace(QUICK, num_steps=3))
    before = {name: value.clone() for name, value in state.model.state_dict().items()}
    finished(state)
    changed = {
        name for name, value in state.model.state_dict().items() if not torch.equal(value, before[name])
    }
    assert changed
    assert all(name.startswith(RADIANCE) for name in changed)
    assert {name.split(".")[0] for name in changed} == {"feature_grid", "decoder", "decoder_head"}


def test_geometry_of_an_adapted_cache_is_the_trained_one():
    cache = small_cache(num_lights=2)
    state = finished(bake(cache, Fog(0.6, 0.5), lamp(), replace(QUICK, num_steps=5)))
    rays = state.taught_rays(torch.Generator().manual_seed(9))
    with torch.no_grad():
        old = cache(rays.origins, rays.directions, rays.light_index)
        new = state.model(rays.origins, rays.directions, rays.light_index)
    assert torch.equal(old.opacity, new.opacity)
    assert torch.equal(old.distance, new.distance)


def test_an_adaptable_cache_starts_as_the_chosen_head():
    cache = small_cache(num_lights=2)
    rays = Fog(0.5, 0.5).starts(20, torch.Generator().manual_seed(0))
    index = torch.ones(20, dtype=torch.long)
    with torch.no_grad():
        wanted = cache(rays.positions, rays.normal, index).near_radiance
        found = adaptable(cache, 1)(rays.positions, rays.normal, 0 * index).near_radiance
    assert torch.equal(found, wanted)


def test_two_lights_make_two_caches_and_equal_seeds_make_equal_ones():
    cache, scene = small_cache(), Fog(0.6, 0.5)
    config = replace(QUICK, num_steps=4)
    first, again, other = (
        seen_along(finished(bake(cache, scene, light, config)))[0]
        for light in (lamp(), lamp(), constant_light(0.5))
    )
    assert torch.equal(first, again)
    assert float((first - other).abs().mean()) > 0.1 * float(other.mean())


def test_a_light_that_is_already_there_changes_nothing_beyond_noise():
    scene = Fog(BELIEVED, 0.7)
    learned = finished(bake(small_cache(), scene, constant_light(1.0), QUICK))
    before, _ = seen_along(learned)
    after, _ = seen_along(finished(bake(learned.model, scene, constant_light(1.0), seed=8)))
    assert float((after - before).abs().mean()) < 0.03 * float(before.mean())


def test_a_bake_without_directions_is_refused():
    with pytest.raises(ConfigError, match="fast"):
        replace(QUICK, fast=NONE)
