import torch
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.fields.appearance import Appearance, AppearanceConfig, AppearanceField

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
