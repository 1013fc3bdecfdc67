from dataclasses import replace

import torch
from flashcache.caches.fast_cache import CacheAnswer, FastCacheConfig
from flashcache.caches.nerf_cache import NerfCache, NerfCacheConfig
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.fields.appearance import Appearance, AppearanceConfig, AppearanceField
from flashcache.fields.density import DensityConfig

CONFIG = AppearanceConfig(
    grid=HashGridConfig(finest_resolution=32, log2_table_size=12),
    bottleneck=8,
    factor_width=8,
    num_degrees=3,
    reflection_width=8,
    reflection_layers=2,
)


def unit(*shape: int, seed: int) -> torch.Tensor:
    values = torch.randn(*shape, generator=torch.Generator().manual_seed(seed))
    return torch.nn.functional.normalize(values, dim=-1)


def answer(num_lights: int = 1, light: int = 0, view_seed: int = 3, **settings) -> Appearance:
    torch.manual_seed(0)
    made = AppearanceField(CONFIG, 4, 1.5, num_lights)
    hidden = torch.randn(10, 4, generator=torch.Generator().manual_seed(1))
    index = torch.full((10,), light)
    return made(
        unit(10, 3, seed=1), hidden, unit(10, 3, seed=2), unit(10, 3, seed=view_seed), index, **settings
    )


def test_only_the_specular_part_depends_on_the_view():
    one, other = answer(view_seed=3), answer(view_seed=4)
    assert torch.equal(one.diffuse, other.diffuse)
    assert torch.equal(one.irradiance, other.irradiance)
    assert not torch.allclose(one.specular, other.specular)


def test_radiance_is_positive_and_the_sum_of_its_parts():
    found = answer()
    assert (found.radiance > 0.0).all()
    assert torch.equal(found.radiance, found.diffuse + found.specular)


def test_every_light_has_heads_of_its_own():
    first, second = answer(num_lights=2, light=0), answer(num_lights=2, light=1)
    assert not torch.allclose(first.diffuse, second.diffuse)
    assert not torch.allclose(first.specular, second.specular)
    assert not torch.allclose(first.irradiance, second.irradiance)


def test_without_specular_only_the_specular_part_is_missing():
    whole, part = answer(), answer(with_specular=False)
    assert not part.specular.any()
    assert torch.equal(part.diffuse, whole.diffuse)


class Wall(torch.nn.Module):
    """Answers every reflected ray with the same radiance and opacity."""

    def __init__(self, opacity: float) -> None:
        super().__init__()
        self.opacity = opacity

    def forward(self, origins: torch.Tensor, directions: torch.Tensor, light_index: torch.Tensor):
        opacity = torch.full((len(origins),), self.opacity)
        return CacheAnswer(0.25 * self.opacity * torch.ones_like(origins), opacity, opacity)


def reflected(opacity: float, seed: int = 3) -> torch.Tensor:
    """Return the specular radiance over what remains of it where reflections are white."""
    torch.manual_seed(0)
    config = replace(CONFIG, architecture="fast_like")
    made = AppearanceField(config, 4, 1.5, 1, Wall(opacity))
    with torch.no_grad():
        made.reflection_head.weight.mul_(20.0)
    hidden = torch.randn(10, 4, generator=torch.Generator().manual_seed(1))
    index = torch.zeros(10, dtype=torch.long)
    return made(unit(10, 3, seed=1), hidden, unit(10, 3, seed=2), unit(10, 3, seed=seed), index).specular


def test_an_opaque_reflection_hides_the_far_field_and_a_clear_one_shows_it():
    hidden, clear, half = (reflected(opacity) for opacity in (1.0, 0.0, 0.5))
    torch.testing.assert_close(half, 0.5 * (hidden + clear))
    share = clear / hidden
    assert share.std() > 0.05  # the far field varies with direction, the wall does not


def test_reflected_radiance_trains_through_the_ray_that_it_looks_along():
    config = NerfCacheConfig(
        appearance=replace(CONFIG, architecture="fast_like"),
        density=DensityConfig(grid=CONFIG.grid, width=8, num_layers=1),
        reflected=FastCacheConfig(distance_grid=CONFIG.grid, feature_grid=CONFIG.grid),
    )
    cache = NerfCache(config, 1.5, 1, (0.05, 2.0))
    normal = unit(10, 3, seed=2).requires_grad_()
    hidden, index = torch.randn(10, 8), torch.zeros(10, dtype=torch.long)
    found = cache.appearance(unit(10, 3, seed=1), hidden, normal, unit(10, 3, seed=3), index)
    found.specular.sum().backward()
    network = cache.appearance.reflected
    assert network.feature_grid.table.grad.abs().max() > 0.0
    assert network.distance_head.weight.grad.abs().max() > 0.0
    assert cache.appearance.reflection_head.weight.grad.abs().max() > 0.0
    assert normal.grad.abs().max() > 0.0
