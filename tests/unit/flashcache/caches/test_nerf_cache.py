from dataclasses import replace

import pytest
import torch
from flashcache.caches.nerf_cache import SECONDARY_CURVE, NerfCache, NerfCacheConfig
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.errors import ConfigError
from flashcache.fields.appearance import AppearanceConfig
from flashcache.fields.density import DensityConfig
from flashcache.geometry.rays import Rays
from flashcache.volume.proposal_sampling import SampleCounts, midpoints
from support.statistics import assert_mean

GRID = HashGridConfig(finest_resolution=32, log2_table_size=12)
DENSITY = DensityConfig(grid=GRID, width=8, num_layers=1, bias=0.0)
CONFIG = NerfCacheConfig(
    proposals=(DENSITY, DENSITY),
    density=DENSITY,
    appearance=AppearanceConfig(
        grid=GRID, bottleneck=4, factor_width=4, num_degrees=2, reflection_width=4, reflection_layers=1
    ),
    primary_counts=SampleCounts(first=8, second=8, final=6),
    secondary_counts=SampleCounts(first=8, second=8, final=6),
)


def cache(secondary_colours: int = 0) -> NerfCache:
    torch.manual_seed(0)
    made = NerfCache(replace(CONFIG, secondary_colours=secondary_colours), 1.5, 1, (0.05, 2.0))
    with torch.no_grad():
        for grid in (made.density.grid, made.appearance.grid):
            grid.table.normal_(0.0, 0.5)
    return made


def rays(count: int, same: bool = False) -> Rays:
    generator = torch.Generator().manual_seed(1)
    rows = 1 if same else count
    origins = torch.randn(rows, 3, generator=generator).expand(count, 3)
    directions = torch.nn.functional.normalize(torch.randn(rows, 3, generator=generator), dim=-1)
    limits = torch.tensor([0.05, 2.0]).expand(count, 2)
    return Rays(origins, directions.expand(count, 3), limits[:, 0], limits[:, 1])


def light(count: int) -> torch.Tensor:
    return torch.zeros(count, dtype=torch.long)


def test_one_drawn_colour_has_the_mean_of_all_colours():
    count = 4000
    with torch.no_grad():
        exact = cache().incident(rays(1, same=True), light(1), None)
        generator = torch.Generator().manual_seed(2)
        drawn = cache(1).incident(rays(count, same=True), light(count), generator)
    assert_mean(drawn.near_radiance, exact.near_radiance[0])
    assert drawn.near_radiance.std() > 0.0
    torch.testing.assert_close(drawn.opacity, exact.opacity.expand(count))


def test_the_distance_of_an_empty_ray_is_the_far_end():
    made = cache()
    with torch.no_grad():
        made.density.head.bias.fill_(-40.0)
        found = made.incident(rays(5), light(5), None)
    assert (found.distance == 2.0).all()
    assert found.opacity.max() < 1e-6
    assert found.near_radiance.max() < 1e-5


def test_weights_of_primary_rays_sum_to_their_opacity_below_one():
    geometry = cache().trace(rays(20), exponent=1.0, generator=None)
    assert geometry.weights.min() >= 0.0
    assert geometry.opacity.max() <= 1.0
    torch.testing.assert_close(geometry.opacity, geometry.weights.sum(dim=-1))


def test_derived_normals_of_some_rays_change_nothing_else():
    with_some = cache().trace(rays(20), exponent=1.0, generator=None, num_derived=5)
    without = cache().trace(rays(20), exponent=1.0, generator=None)
    assert with_some.derived.shape == (5 * 6, 3)
    assert without.derived is None
    torch.testing.assert_close(with_some.weights, without.weights)
    torch.testing.assert_close(with_some.hidden, without.hidden)


def test_outgoing_radiance_is_asked_for_towards_the_rays_origin():
    made = cache()
    geometry = made.trace(rays(7), exponent=1.0, generator=None)
    found = made.outgoing(geometry, rays(7).directions, light(7))
    direct = made.appearance(
        geometry.samples.positions.reshape(-1, 3),
        geometry.hidden,
        geometry.normal,
        -rays(7).directions.repeat_interleave(6, dim=0),
        light(42),
    )
    torch.testing.assert_close(found.radiance, direct.radiance)


def test_points_of_little_weight_send_nothing_and_the_others_what_they_would():
    made = cache()
    geometry = made.trace(rays(7), exponent=1.0, generator=None)
    whole = made.outgoing(geometry, rays(7).directions, light(7))
    weights = geometry.weights.detach().reshape(-1)
    made.config = replace(made.config, least_weight=float(weights.median()))
    some = made.outgoing(geometry, rays(7).directions, light(7))
    counted = weights > made.config.least_weight
    assert 0 < int(counted.sum()) < len(weights)
    for part, wanted in zip(some, whole, strict=True):
        torch.testing.assert_close(part[counted], wanted[counted])
        assert not part[~counted].any()
    some.radiance.sum().backward()
    assert made.appearance.heads.weight.grad is not None


@pytest.mark.parametrize("weight", [-0.1, 1.0])
def test_a_least_weight_that_leaves_nothing_is_refused(weight):
    with pytest.raises(ConfigError, match="least_weight"):
        NerfCacheConfig(least_weight=weight)


def test_a_negative_number_of_colours_is_refused():
    with pytest.raises(ConfigError, match="secondary_colours"):
        NerfCacheConfig(secondary_colours=-1)


def test_secondary_rays_are_sampled_on_the_power_ladder():
    made = cache()
    with torch.no_grad():
        for density in (*made.proposals, made.density):
            density.head.weight.zero_()
            density.head.bias.fill_(-40.0)
        given = rays(1)
        positions = made.meet(given, 0, None).positions
    distances = (positions - given.origins).norm(dim=-1)
    edges = SECONDARY_CURVE.distance(
        torch.linspace(0.0, 1.0, 7)[None], given.near[:, None], given.far[:, None]
    )
    torch.testing.assert_close(distances, midpoints(edges)[0], rtol=2e-3, atol=2e-3)
    # Half of the samples lie in the first quarter of the way.
    assert int((distances < 0.5).sum()) >= 3


def test_jitter_moves_the_intervals_of_secondary_rays():
    made = cache()
    with torch.no_grad():
        fixed, moved = (
            made.incident(rays(5), light(5), torch.Generator().manual_seed(3), jitter=jitter)
            for jitter in (False, True)
        )
    assert not torch.allclose(fixed.opacity, moved.opacity)
    torch.testing.assert_close(fixed.opacity, moved.opacity, rtol=0.3, atol=0.1)


def test_the_exponent_of_the_configuration_is_the_one_used_after_training():
    made = cache()
    for density in made.proposals:
        with torch.no_grad():
            density.grid.table.normal_(0.0, 3.0)
    other = replace(CONFIG, exponent=0.2)
    with torch.no_grad():
        usual = made.trace(rays(20), generator=None).samples.edges
        flat = made.trace(rays(20), exponent=0.2, generator=None).samples.edges
        made.config = other
        assert torch.equal(made.trace(rays(20), generator=None).samples.edges, flat)
        assert not torch.allclose(usual, flat)
