"""Rays that leave the fused surface, and what they find."""

import numpy as np
import pytest
import torch
from flashcache.evaluation.relighting import MapLight
from flashcache.physical.brdf import Materials
from support.lit_sphere import RADIUS, TOP

from benchmarks.oracle_light import ProxySurface, points_at, shade

CPU = torch.device("cpu")


def lamp() -> MapLight:
    image = np.full((8, 16, 3), 0.3, np.float32)
    image[1, 3] = (9.0, 5.0, 2.0)
    return MapLight.from_image(image, CPU)


@pytest.mark.slow
def test_a_ray_from_a_convex_surface_meets_nothing_also_if_it_begins_inside(surface: ProxySurface):
    generator = torch.Generator().manual_seed(0)
    normal = torch.nn.functional.normalize(torch.randn(500, 3, generator=generator), dim=-1)
    for height in (-0.05, 0.05):
        hits = surface.first_hits((RADIUS + height) * normal, normal)
        assert len(hits.index) == 0


@pytest.mark.slow
def test_a_ray_towards_the_surface_finds_its_distance_normal_and_material(surface: ProxySurface):
    generator = torch.Generator().manual_seed(0)
    towards = torch.nn.functional.normalize(torch.randn(500, 3, generator=generator), dim=-1)
    towards[:, 2] = towards[:, 2].abs() + 0.3
    towards = torch.nn.functional.normalize(towards, dim=-1)
    hits = surface.first_hits(2.0 * towards, -towards)
    assert len(hits.index) == 500
    order = hits.index
    assert torch.allclose(hits.distance, torch.full((500,), 2.0 - RADIUS), atol=0.02)
    assert (hits.normal * towards[order]).sum(dim=-1).min() > 0.98
    assert torch.allclose(hits.materials.albedo, torch.tensor(TOP).expand(500, 3), atol=0.02)


@pytest.mark.slow
def test_no_rays_meet_nothing(surface: ProxySurface):
    assert len(surface.first_hits(torch.zeros(0, 3), torch.zeros(0, 3)).index) == 0


@pytest.mark.slow
@pytest.mark.parametrize("bounces", [0, 1])
def test_a_convex_object_looks_alike_with_and_without_its_own_shadow_and_bounce(
    surface: ProxySurface, bounces: int
):
    generator = torch.Generator().manual_seed(0)
    normal = torch.nn.functional.normalize(torch.randn(300, 3, generator=generator), dim=-1)
    points = points_at(RADIUS * normal, normal, normal)
    materials = Materials(torch.full((300, 3), 0.6), torch.full((300, 1), 0.3), torch.zeros(300, 1))

    def radiance(count: int | None) -> torch.Tensor:
        return shade(surface, points, materials, lamp(), bounces=count, num_directions=64, seed=0)

    assert (radiance(None) - radiance(bounces)).abs().mean() < 0.02 * radiance(None).mean()


@pytest.mark.slow
def test_values_of_vertices_are_interpolated_where_rays_hit(surface: ProxySurface):
    generator = torch.Generator().manual_seed(3)
    towards = torch.nn.functional.normalize(torch.randn(100, 3, generator=generator), dim=-1)
    hits = surface.first_hits(2.0 * towards, -towards)
    vertices = torch.tensor(surface.vertices, dtype=torch.float32)
    expected = (2.0 - hits.distance)[:, None] * towards[hits.index]
    assert torch.allclose(hits.interpolate(vertices), expected, atol=1e-4)


@pytest.mark.slow
def test_no_points_have_no_radiance(surface: ProxySurface):
    none = torch.zeros(0, 3)
    materials = Materials(none, none[:, :1], none[:, :1])
    points = points_at(none, none, none)
    assert shade(surface, points, materials, lamp(), bounces=1, num_directions=8, seed=0).shape == (0, 3)
