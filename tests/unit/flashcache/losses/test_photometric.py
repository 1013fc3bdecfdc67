import pytest
import torch
from flashcache.color import linear_from_srgb
from flashcache.losses.photometric import (
    cache_photometric,
    carving,
    charbonnier,
    consistency,
    mask_loss,
    physical_photometric,
)
from support.statistics import assert_mean

ONES = torch.ones(4)


def colours(seed: int) -> torch.Tensor:
    return torch.rand(4, 3, generator=torch.Generator().manual_seed(seed))


def test_the_smooth_absolute_value_is_the_absolute_value_away_from_zero():
    torch.testing.assert_close(charbonnier(torch.tensor([-3.0, 0.0])), torch.tensor([3.0, 1e-3]))


def test_the_cache_loss_is_least_at_the_photograph():
    photograph = colours(1)
    assert cache_photometric(photograph, photograph) < cache_photometric(colours(2), photograph)


def test_the_cache_loss_is_the_distance_of_the_two_colours_in_srgb():
    predicted, photograph = (linear_from_srgb(torch.full((4, 3), level)) for level in (0.7, 0.4))
    expected = charbonnier(torch.tensor(0.3))
    torch.testing.assert_close(cache_photometric(predicted, photograph), expected)


def test_dark_pixels_count_more_than_bright_ones_for_the_same_linear_error():
    dark, bright = torch.full((4, 3), 0.02), torch.full((4, 3), 0.8)
    errors = [cache_photometric(level + 0.02, level) for level in (dark, bright)]
    assert errors[0] > 3.0 * errors[1]


def test_carving_does_not_ask_a_half_opaque_ray_of_the_right_colour_for_more():
    photograph, opacity = colours(1), torch.full((4,), 0.7, requires_grad=True)
    premultiplied = opacity[:, None] * photograph
    carving(premultiplied, opacity, photograph, ONES).backward()
    assert opacity.grad.abs().max() < 1e-6


def test_carving_fills_the_inside_and_empties_the_outside():
    photograph, opacity = colours(1), torch.full((4,), 0.3, requires_grad=True)
    coverage = torch.tensor([1.0, 1.0, 0.0, 0.0])
    carving(opacity[:, None] * photograph, opacity, photograph, coverage).backward()
    assert (opacity.grad[:2] < 0.0).all()
    assert (opacity.grad[2:] > 0.0).all()


def test_the_mask_loss_is_least_at_the_coverage():
    coverage = torch.tensor([0.0, 0.3, 0.7, 1.0])
    assert mask_loss(coverage, coverage) < mask_loss(coverage.flip(0), coverage)


def test_the_physical_loss_leaves_out_clipped_channels_that_the_cache_sees_brighter():
    photograph = torch.ones(4, 3)
    cache = torch.tensor([[2.0, 0.9, 2.0]]).expand(4, 3)
    estimate = torch.full((4, 3), 3.0, requires_grad=True)
    physical_photometric(photograph, estimate, estimate.detach(), cache, ONES).backward()
    assert (estimate.grad.abs().sum(dim=0) > 0.0).tolist() == [False, True, False]


def test_only_the_first_estimate_gets_a_gradient():
    first, second = colours(2).requires_grad_(), colours(3).requires_grad_()
    cache = colours(4).requires_grad_()
    physical_photometric(colours(1), first, second, cache, ONES).backward()
    assert first.grad is not None
    assert second.grad is None
    assert cache.grad is None


def test_a_clipped_channel_lets_the_cache_be_brighter_and_not_darker():
    photograph = torch.full((4, 3), 0.95)
    predicted = torch.tensor([[3.0, 0.5, 3.0]]).repeat(4, 1).requires_grad_()
    clipped = torch.tensor([[True, True, False]]).expand(4, 3)
    cache_photometric(predicted, photograph, clipped).backward()
    assert predicted.grad[0].sign().tolist() == [0.0, -1.0, 1.0]


def test_flags_without_a_clipped_channel_change_nothing():
    predicted, photograph, none = 2.0 * colours(1), colours(2), torch.zeros(4, 3, dtype=torch.bool)
    given = colours(3), colours(4), colours(5), colours(6), ONES
    assert cache_photometric(predicted, photograph, none) == cache_photometric(predicted, photograph)
    assert physical_photometric(*given, none) == physical_photometric(*given)
    assert carving(predicted, ONES, photograph, ONES, none) == carving(predicted, ONES, photograph, ONES)


def test_carving_lets_a_clipped_channel_be_brighter():
    photograph, clipped = torch.full((4, 3), 0.95), torch.tensor([[True, False, True]]).expand(4, 3)
    colour = torch.full((4, 3), 2.0, requires_grad=True)
    carving(colour, ONES, photograph, ONES, clipped).backward()
    assert colour.grad[0].sign().tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize(
    ("cache", "other", "sign"), [(2.0, 2.0, 0.0), (2.0, 0.5, -1.0), (0.5, 2.0, 1.0), (0.5, 0.5, -1.0)]
)
def test_a_clipped_channel_is_left_out_where_cache_and_estimate_agree_that_it_was_brighter(
    cache, other, sign
):
    photograph, clipped = torch.full((4, 3), 0.95), torch.ones(4, 3, dtype=torch.bool)
    estimate = torch.full((4, 3), 1.5, requires_grad=True)
    others = torch.full((4, 3), other), torch.full((4, 3), cache)
    physical_photometric(photograph, estimate, *others, ONES, clipped).backward()
    assert (estimate.grad.sign() == sign).all()


def test_white_of_a_brightened_photograph_is_a_value_like_others_where_flags_are_known():
    # 1.5 is what a photograph shows that was exposed half as long as the first: nothing is clipped.
    photograph, cache = torch.full((4, 3), 1.5), torch.full((4, 3), 2.0)
    estimate = torch.full((4, 3), 2.0, requires_grad=True)
    none = torch.zeros(4, 3, dtype=torch.bool)
    physical_photometric(photograph, estimate, estimate.detach(), cache, ONES, none).backward()
    assert (estimate.grad > 0.0).all()


@pytest.mark.parametrize(("flagged", "low", "high"), [(True, 2.95, 3.05), (False, 0.9, 1.1)])
def test_a_highlight_that_one_photograph_shows_unclipped_gets_its_true_brightness(flagged, low, high):
    # Radiance 3; three photographs are clipped at 1, and one was exposed a quarter as long, clipped at 4.
    photograph = torch.tensor([1.0, 1.0, 1.0, 3.0])[:, None].expand(4, 3)
    clipped = torch.tensor([True, True, True, False])[:, None].expand(4, 3) if flagged else None
    radiance = torch.full((3,), 0.5, requires_grad=True)
    optimiser = torch.optim.Adam([radiance], lr=0.05)
    for _ in range(200):
        optimiser.zero_grad()
        cache_photometric(radiance.expand(4, 3), photograph, clipped).backward()
        optimiser.step()
    assert low < float(radiance.detach().min()) <= float(radiance.detach().max()) < high


def test_the_mean_gradient_is_that_of_the_squared_error_to_the_mean():
    rows = 5000
    generator = torch.Generator().manual_seed(0)
    expected = torch.tensor([0.4, 0.1, 0.8], dtype=torch.float64)
    physical = expected * (0.4 + 1.2 * torch.rand(rows, 3, generator=generator, dtype=torch.float64))
    start = torch.tensor([0.6, 0.3, 0.2], dtype=torch.float64)
    cache = start.expand(rows, 3).clone().requires_grad_()
    (rows * consistency(cache, physical, torch.ones(rows, dtype=torch.float64))).backward()
    assert_mean(cache.grad, 2.0 * (start - expected) / (start + 0.01) / 3.0)


def test_the_physical_estimate_gets_no_gradient_and_uncovered_points_do_not_count():
    cache, physical = torch.rand(3, 3).requires_grad_(), torch.rand(3, 3).requires_grad_()
    consistency(cache, physical, torch.tensor([1.0, 0.0, 1.0])).backward()
    assert physical.grad is None
    assert not cache.grad[1].any()
    assert cache.grad[0].any()
