import torch
from flashcache.caches.fast_cache import CacheAnswer, FastCache, FastCacheConfig
from flashcache.caches.nerf_cache import SECONDARY_CURVE
from flashcache.encoding.hash_grid import HashGridConfig

GRID = HashGridConfig(finest_resolution=32, log2_table_size=12)
NEAR, FAR = 0.05, 2.0


def cache(num_lights: int = 1) -> FastCache:
    torch.manual_seed(0)
    config = FastCacheConfig(
        distance_grid=GRID,
        feature_grid=GRID,
        code_width=8,
        distance_width=8,
        distance_layers=2,
        decoder_widths=(8, 8),
    )
    return FastCache(config, 1.5, num_lights, (NEAR, FAR))


def ask(made: FastCache, light: int = 0) -> CacheAnswer:
    generator = torch.Generator().manual_seed(1)
    directions = torch.nn.functional.normalize(torch.randn(30, 3, generator=generator), dim=-1)
    return made(torch.randn(30, 3, generator=generator), directions, torch.full((30,), light))


def unsettled(made: FastCache) -> FastCache:
    """Return the cache with a distance head whose outputs are large."""
    with torch.no_grad():
        made.distance_head.weight.normal_(0.0, 20.0)
        made.distance_head.bias.normal_(0.0, 20.0)
    return made


def test_a_new_cache_spreads_its_samples_over_the_uniform_ladder():
    ladder = SECONDARY_CURVE.distance(torch.linspace(0, 1, 8), torch.tensor(NEAR), torch.tensor(FAR))
    found = ask(cache())
    torch.testing.assert_close(found.opacity, torch.sigmoid(torch.tensor(2.0)).expand(30))
    torch.testing.assert_close(found.distance, ladder.mean().expand(30))


def test_samples_stay_between_near_and_far_however_large_their_offsets():
    offset, gate = 20.0 * torch.randn(2, 30, 8, generator=torch.Generator().manual_seed(1))
    distances = cache()._sample_distances(offset, gate)
    assert distances.min() >= NEAR - 1e-5
    assert distances.max() <= FAR + 1e-5
    assert distances.std() > 0.1


def test_distance_is_the_mean_over_the_weights_of_the_samples(monkeypatch):
    places = torch.linspace(0.2, 1.6, 8)
    monkeypatch.setattr(FastCache, "_sample_distances", lambda *_: places.expand(30, 8))
    made = cache()
    with torch.no_grad():
        made.distance_head.bias[16:24] = torch.arange(8.0)
    weights = torch.softmax(torch.arange(8.0), dim=0)
    torch.testing.assert_close(ask(made).distance, (weights * places).sum().expand(30))


def test_an_empty_ray_is_black_and_ends_far_away():
    made = cache()
    with torch.no_grad():
        made.distance_head.bias[-1] = -50.0
    found = ask(made)
    assert found.near_radiance.max() < 1e-6
    assert (found.distance == FAR).all()


def test_only_radiance_depends_on_the_light():
    first, second = ask(cache(num_lights=2)), ask(cache(num_lights=2), light=1)
    assert not torch.allclose(first.near_radiance, second.near_radiance)
    assert torch.equal(first.opacity, second.opacity)
    assert torch.equal(first.distance, second.distance)
