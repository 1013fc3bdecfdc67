import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.losses.shape import ShapePriorConfig, emptiness, flatness, recession, tangent_steps


def test_recession_moves_weight_from_near_to_far_and_leaves_distances_alone():
    weights = torch.full((1, 3), 0.3, requires_grad=True)
    distances = torch.tensor([[0.1, 0.5, 0.9]], requires_grad=True)
    recession(weights, distances, torch.ones(1)).backward()
    near, middle, far = weights.grad[0]
    assert near > middle > far
    assert distances.grad is None


def test_recession_is_least_for_the_farther_of_two_surfaces():
    distances = torch.tensor([[0.2, 0.8]])
    near, far = (
        recession(torch.tensor([weights]), distances, torch.ones(1)) for weights in ([0.9, 0.1], [0.1, 0.9])
    )
    assert far < near < 0.0


def test_recession_does_not_depend_on_how_opaque_a_surface_is():
    distances = torch.tensor([[0.2, 0.8]])
    faint, solid = (
        recession(opacity * torch.tensor([[0.25, 0.75]]), distances, torch.ones(1)) for opacity in (0.3, 1.0)
    )
    torch.testing.assert_close(faint, solid)


def test_recession_ignores_pixels_that_the_object_covers_in_part():
    weights = torch.full((2, 2), 0.4, requires_grad=True)
    recession(weights, torch.tensor([[0.2, 0.8]]).expand(2, 2), torch.tensor([1.0, 0.9])).backward()
    assert weights.grad[0].abs().max() > 0.0
    assert weights.grad[1].abs().max() == 0.0


def test_one_crease_costs_no_more_than_the_same_turn_in_small_steps():
    def along(angles: list[float]) -> torch.Tensor:
        turned = torch.tensor(angles)
        normals = torch.stack([turned.sin(), torch.zeros_like(turned), turned.cos()], dim=-1)
        return len(angles) * flatness(normals[:-1], normals[1:], torch.ones(len(angles) - 1))

    crease, bend = along([0.0, 0.0, 0.0, 0.6, 0.6]), along([0.0, 0.15, 0.3, 0.45, 0.6])
    # Squares would make the crease four times as dear.
    assert crease <= bend * 1.1


def test_equal_normals_have_no_gradient_that_would_move_them():
    normal = torch.tensor([[0.0, 0.6, 0.8]], requires_grad=True)
    flatness(normal, normal.detach().clone(), torch.ones(1)).backward()
    assert normal.grad.abs().max() == 0.0


def test_tangent_steps_stay_on_the_surface_and_have_the_stated_spread():
    normal = torch.nn.functional.normalize(torch.randn(20_000, 3, generator=torch.Generator().manual_seed(1)))
    steps = tangent_steps(normal, 0.05, torch.Generator().manual_seed(2))
    assert (steps * normal).sum(dim=-1).abs().max() < 1e-6
    # Two of three dimensions are left.
    assert steps.square().sum(dim=-1).mean().sqrt() == pytest.approx(0.05 * 2**0.5, rel=0.02)


def test_emptiness_is_the_mean_opacity_of_short_stretches():
    found = emptiness(torch.tensor([0.0, 2.0, 1e6]), 0.5)
    torch.testing.assert_close(found, torch.tensor((0.0 + (1.0 - 2.718281828**-1.0) + 1.0) / 3.0))


@pytest.mark.parametrize("name", ["flatness_rays", "emptiness_points"])
def test_a_prior_without_rays_or_points_is_refused(name):
    with pytest.raises(ConfigError, match=name):
        ShapePriorConfig(**{name: 0})
