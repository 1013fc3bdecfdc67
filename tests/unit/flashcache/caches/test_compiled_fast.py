"""The compiled fast cache against torch."""

from dataclasses import replace

import pytest
import torch
from flashcache.caches.fast_cache import CacheAnswer, FastCache, FastCacheConfig
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.encoding.turns import IDENTITY, LightTurns
from flashcache.kernels import dispatch

GRID = HashGridConfig(finest_resolution=64, num_features=4, log2_table_size=12)
CONFIG = FastCacheConfig(
    distance_grid=GRID,
    feature_grid=replace(GRID, half_extent=2.0, output_scale=3.0),
    code_width=12,
    distance_width=20,
    distance_layers=2,
    decoder_widths=(16, 24),
)
SHAPES = {
    "plain": CONFIG,
    "joined": replace(CONFIG, distance_layers=4),
    "one feature": replace(CONFIG, distance_grid=replace(GRID, num_features=1)),
    "no code": replace(CONFIG, code_layers=0),
    "frequencies": replace(CONFIG, num_frequencies=0, num_samples=5),
}


def trained(config: FastCacheConfig, num_lights: int = 1, **options) -> FastCache:
    """Return a cache whose outputs vary as much as those of a trained one."""
    torch.manual_seed(0)
    made = FastCache(config, 1.5, num_lights, (0.05, 2.0), **options)
    with torch.no_grad():
        for name, parameter in made.named_parameters():
            if name.endswith("table"):
                parameter.normal_(0.0, 0.5 if "distance" in name else 0.2)
            if name.endswith("bias"):
                parameter.normal_(0.0, 0.3)
        made.distance_head.weight.normal_(0.0, 0.5)
        made.distance_head.bias[-1] = -3.0
    return made


def rays(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    directions = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    return torch.randn(count, 3, generator=generator), directions


def answers(made: FastCache, count: int, light: torch.Tensor) -> tuple[CacheAnswer, CacheAnswer]:
    """Return the compiled answer and that of torch."""
    with torch.no_grad():
        compiled = made(*rays(count), light)
        with dispatch.using("reference"):
            return compiled, made(*rays(count), light)


@pytest.mark.parametrize("count", [0, 1, 63, 64, 129, 700])
@pytest.mark.parametrize("shape", list(SHAPES))
def test_the_compiled_answer_is_that_of_torch(shape, count):
    compiled, expected = answers(trained(SHAPES[shape]), count, torch.zeros(count, dtype=torch.long))
    for found, wanted in zip(compiled, expected, strict=True):
        assert found.shape == wanted.shape
        torch.testing.assert_close(found, wanted, rtol=1e-4, atol=2e-5)


def test_every_ray_gets_the_radiance_of_its_light():
    light = torch.randint(3, (200,), generator=torch.Generator().manual_seed(2))
    made = trained(CONFIG, num_lights=3)
    compiled, expected = answers(made, 200, light)
    torch.testing.assert_close(compiled.near_radiance, expected.near_radiance, rtol=1e-4, atol=2e-5)
    other, _ = answers(made, 200, (light + 1) % 3)
    assert not torch.allclose(other.near_radiance, expected.near_radiance)


def test_an_empty_ray_ends_far_away():
    made = trained(CONFIG)
    with torch.no_grad():
        made.distance_head.bias[-1] = -50.0
    compiled, expected = answers(made, 50, torch.zeros(50, dtype=torch.long))
    assert torch.equal(compiled.distance, torch.full((50,), 2.0))
    torch.testing.assert_close(compiled.near_radiance, expected.near_radiance, rtol=1e-3, atol=1e-7)


def test_a_light_that_is_not_there_is_refused():
    with torch.no_grad(), pytest.raises(IndexError, match="light"):
        trained(CONFIG, num_lights=2)(*rays(2), torch.tensor([0, 2]))


def test_answers_do_not_depend_on_the_number_of_threads(monkeypatch):
    made, light = trained(CONFIG), torch.zeros(1500, dtype=torch.long)
    alone, _ = answers(made, 1500, light)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 3)
    several, _ = answers(made, 1500, light)
    assert all(torch.equal(a, b) for a, b in zip(alone, several, strict=True))


def test_a_step_of_training_is_seen_by_the_next_query():
    made, light = trained(CONFIG), torch.zeros(20, dtype=torch.long)
    before, _ = answers(made, 20, light)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.mul_(1.1)
    after, expected = answers(made, 20, light)
    assert not torch.allclose(before.near_radiance, after.near_radiance)
    torch.testing.assert_close(after.near_radiance, expected.near_radiance, rtol=1e-4, atol=2e-5)


def test_views_that_are_not_contiguous_are_read_as_they_are():
    made, (origins, directions) = trained(CONFIG), rays(40)
    one = origins[:1].expand(40, 3)
    with torch.no_grad():
        found = made(one, directions.T.contiguous().T, torch.zeros(1, dtype=torch.long).expand(40))
        wanted = made(one.contiguous(), directions, torch.zeros(40, dtype=torch.long))
    assert torch.equal(found.near_radiance, wanted.near_radiance)


@pytest.fixture
def calls(monkeypatch) -> list[int]:
    """Return the numbers of rays that compiled code answers during the test."""
    made: list[int] = []
    original = FastCache._answer_compiled

    def record(cache, origins, *rest):
        made.append(len(origins))
        return original(cache, origins, *rest)

    monkeypatch.setattr(FastCache, "_answer_compiled", record)
    return made


def test_compiled_code_answers_where_no_gradients_are_recorded(calls):
    made, light = trained(CONFIG), torch.zeros(4, dtype=torch.long)
    assert made(*rays(4), light).near_radiance.requires_grad
    with torch.no_grad():
        for choice in ("reference", "encoder"):
            with dispatch.using(choice):
                made(*rays(4), light)
        made.double()(*(part.double() for part in rays(4)), light)
        assert calls == []
        made.float()(*rays(4), light)
    assert calls == [4]


@pytest.mark.parametrize("options", [{"turns": LightTurns([IDENTITY])}, {"origin_frequencies": 2}])
def test_a_decoder_that_sees_more_than_features_is_torchs(options, calls):
    with torch.no_grad():
        trained(CONFIG, **options)(*rays(4), torch.zeros(4, dtype=torch.long))
    assert calls == []
