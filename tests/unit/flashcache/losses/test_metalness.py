import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.losses.metalness import (
    MetalnessPriorConfig,
    Variation,
    directional_variation,
    directions_around,
    variation_prior,
)

GREY = torch.full((1, 8, 3), 0.3)
FLICKER = torch.tensor([0.0, 1.0] * 4)[None, :, None].expand(1, 8, 3)
ALONE = torch.ones(1)
"""The weight of a single point."""


def test_a_matt_surface_does_not_vary_and_a_mirror_does():
    assert directional_variation(GREY, torch.zeros_like(GREY), ALONE).own.item() == 0.0
    assert directional_variation(torch.zeros_like(GREY), FLICKER, ALONE).own.item() > 1.0


def test_a_faint_highlight_on_a_bright_surface_varies_little():
    assert directional_variation(GREY, 0.04 * FLICKER, ALONE).own.item() < 0.1


def test_a_dark_dielectric_beside_a_white_surface_is_no_metal():
    diffuse, specular = torch.cat([0.01 * GREY, GREY]), torch.cat([0.04 * FLICKER, 0.04 * FLICKER])
    own, (dark, white) = directional_variation(diffuse, specular, torch.ones(2))
    assert dark.item() == pytest.approx(white.item(), rel=0.2)
    # Beside its own radiance the highlight is large; alone, it could be a metal's in a dark place.
    assert own[0].item() > 0.8
    assert directional_variation(0.01 * GREY, 0.04 * FLICKER, ALONE).bright.item() > 0.8


def test_what_the_photographs_do_not_show_sets_no_scale():
    diffuse, specular = torch.cat([GREY, 100.0 * GREY]), torch.cat([FLICKER, FLICKER])
    found = directional_variation(diffuse, specular, torch.tensor([1.0, 0.0]))
    assert found.bright[0].item() == pytest.approx(directional_variation(GREY, FLICKER, ALONE).bright.item())


def test_a_metal_in_uniform_light_gives_itself_away_by_nothing():
    assert max(directional_variation(torch.zeros_like(GREY), GREY, ALONE)).item() < 1e-5


@pytest.mark.parametrize(("variation", "rises"), [(0.0, False), (1.0, True)])
def test_the_prior_moves_metalness_towards_what_variation_suggests(variation, rises):
    metalness = torch.full((1, 1), 0.5, requires_grad=True)
    given = Variation(torch.tensor([variation]), torch.zeros(1))
    variation_prior(metalness, (0.12, 0.95), given, torch.ones(1), MetalnessPriorConfig()).backward()
    assert (metalness.grad.item() < 0.0) == rises


def test_the_prior_is_content_at_its_own_ends_and_leaves_uncovered_points_alone():
    config = MetalnessPriorConfig(range=(0.1, 0.9))
    ends = torch.tensor([[0.1], [0.9], [0.5]])
    weight = torch.tensor([1.0, 1.0, 0.0])
    given = torch.tensor([0.0, 2.0, 2.0])
    assert variation_prior(ends, config.range, Variation(given, given), weight, config).item() < 1e-12


@pytest.mark.parametrize(
    ("own", "bright", "wanted"), [(2.0, 2.0, 0.9), (2.0, 0.0, 0.1), (0.0, 2.0, 0.1), (2.0, 0.075, 0.5)]
)
def test_with_both_measures_a_metal_must_pass_both(own, bright, wanted):
    config = MetalnessPriorConfig(range=(0.1, 0.9), bright_variation=(0.03, 0.12))
    given = Variation(torch.tensor([own]), torch.tensor([bright]))
    prior = variation_prior(torch.tensor([[wanted]]), config.range, given, torch.ones(1), config)
    assert prior.item() < 1e-12


def test_directions_lie_above_the_surface_with_nearly_the_mean_cosine_of_diffuse_light():
    normal = torch.nn.functional.normalize(torch.randn(4000, 3, generator=torch.Generator().manual_seed(3)))
    found = directions_around(normal, 16, torch.Generator().manual_seed(4))
    cosine = (found * normal[:, None]).sum(dim=-1)
    torch.testing.assert_close(found.norm(dim=-1), torch.ones(4000, 16))
    assert cosine.min() > 0.0
    assert cosine.mean().item() == pytest.approx(2.0 / 3.0, abs=0.05)


@pytest.mark.parametrize(
    "settings", [{"num_directions": 1}, {"variation": (0.3, 0.3)}, {"bright_variation": (0.3, 0.2)}]
)
def test_settings_that_say_nothing_are_refused(settings):
    with pytest.raises(ConfigError):
        MetalnessPriorConfig(**settings)


def test_what_varies_with_direction_is_taken_for_smooth():
    dull = torch.full((1, 1), 0.6, requires_grad=True)
    shiny = Variation(torch.ones(1), torch.zeros(1))
    variation_prior(dull, (0.5, 0.25), shiny, torch.ones(1), MetalnessPriorConfig()).backward()
    assert dull.grad.item() > 0.0
