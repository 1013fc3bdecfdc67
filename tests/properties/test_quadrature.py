"""The estimator from K of N points against the full quadrature, in value and in gradient."""

import pytest
import torch
from flashcache.volume.quadrature import draw_points, median_point, render_weights
from support.statistics import assert_mean

DRAWS = 40_000
DENSITY = torch.tensor([[0.3, 2.0, 0.4, 5.0, 1.0]], dtype=torch.float64)
EDGES = torch.tensor([[1.0, 1.3, 1.5, 1.9, 2.0, 2.6]], dtype=torch.float64)
RADIANCE = torch.tensor([0.2, 1.5, 9.0, 0.7, 0.1], dtype=torch.float64)


def uniforms(num_points: int, rows: int = DRAWS) -> torch.Tensor:
    generator = torch.Generator().manual_seed(num_points)
    return torch.rand(rows, num_points, generator=generator, dtype=torch.float64)


def test_weights_sum_to_the_light_that_the_volume_absorbs():
    weights = render_weights(DENSITY, EDGES)
    depth = (DENSITY * EDGES.diff(dim=-1)).sum()
    torch.testing.assert_close(weights.sum(), 1.0 - torch.exp(-depth))


def test_splitting_an_interval_does_not_change_its_weight():
    middle = EDGES[:, 1:2] * 0.5 + EDGES[:, :1] * 0.5
    edges = torch.cat([EDGES[:, :1], middle, EDGES[:, 1:]], dim=-1)
    weights = render_weights(torch.cat([DENSITY[:, :1], DENSITY], dim=-1), edges)
    merged = torch.cat([weights[:, :2].sum(dim=-1, keepdim=True), weights[:, 2:]], dim=-1)
    torch.testing.assert_close(merged, render_weights(DENSITY, EDGES))


@pytest.mark.parametrize("num_points", [1, 2, 4, 8])
@pytest.mark.parametrize("opaque", [False, True])
def test_k_drawn_points_have_the_mean_of_the_full_sum(num_points: int, opaque: bool):
    density = DENSITY.clone()
    density[0, -1] = 1e4 if opaque else 1.0
    weights = render_weights(density, EDGES)
    draw = draw_points(weights.expand(DRAWS, -1), uniforms(num_points))
    estimates = (draw.weight * RADIANCE[draw.index]).sum(dim=-1)
    assert_mean(estimates, (weights[0] * RADIANCE).sum())


def test_the_gradient_by_density_has_the_mean_of_the_full_gradient():
    density = DENSITY.expand(DRAWS, -1).clone().requires_grad_()
    draw = draw_points(render_weights(density, EDGES.expand(DRAWS, -1)), uniforms(1))
    (draw.weight * RADIANCE[draw.index]).sum().backward()
    single = DENSITY.clone().requires_grad_()
    (render_weights(single, EDGES) * RADIANCE).sum().backward()
    assert_mean(density.grad, single.grad[0])


@pytest.mark.parametrize("num_points", [1, 4])
def test_rays_with_little_on_them_are_asked_seldom_and_count_for_the_others(num_points: int):
    weights = (0.01 * render_weights(DENSITY, EDGES)).expand(DRAWS, -1).clone().requires_grad_()
    opacity = float(weights[0].detach().sum())
    draw = draw_points(weights, uniforms(num_points), sure_from=4.0 * opacity)
    estimates = (draw.weight * RADIANCE[draw.index]).sum(dim=-1)
    assert_mean(estimates.detach(), (weights[0] * RADIANCE).sum().detach())
    asked = (draw.weight > 0.0).double().mean()
    assert float(asked) == pytest.approx(0.25, abs=0.01)
    estimates.sum().backward()
    assert_mean(weights.grad, RADIANCE)


def test_rays_with_enough_on_them_are_always_asked():
    weights, u = render_weights(DENSITY, EDGES).expand(DRAWS, -1), uniforms(2)
    some, all_of_them = draw_points(weights, u, sure_from=0.1), draw_points(weights, u)
    assert float(weights[0].sum()) > 0.1
    torch.testing.assert_close(some.index, all_of_them.index)
    torch.testing.assert_close(some.weight, all_of_them.weight)


def test_a_point_without_weight_is_never_drawn():
    density = DENSITY.clone()
    density[0, 2] = 0.0
    draw = draw_points(render_weights(density, EDGES).expand(DRAWS, -1), uniforms(2))
    assert not (draw.index == 2).any()


def test_an_empty_ray_gets_its_first_point_with_weight_zero():
    draw = draw_points(torch.zeros(3, 5, dtype=torch.float64), uniforms(2, rows=3))
    assert (draw.index == 0).all()
    assert (draw.weight == 0.0).all()


def test_the_median_point_carries_all_of_the_opacity():
    weights = render_weights(DENSITY, EDGES)
    draw = median_point(weights)
    torch.testing.assert_close(draw.weight[0, 0], weights.sum())
    before = weights[0, : int(draw.index)].sum()
    assert before < weights.sum() / 2 <= before + weights[0, int(draw.index)]
