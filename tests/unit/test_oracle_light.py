"""Shading of true surfaces: the albedo that explains a photograph, and rays that leave the fused surface."""

import numpy as np
import pytest
import torch
from flashcache.evaluation.relighting import MapLight
from flashcache.physical.brdf import Materials
from flashcache.physical.estimator import DirectionCounts
from flashcache.physical.incident import unoccluded
from flashcache.physical.shading import ShadingPoints
from make_sample_scene import llvm_library
from oracle_geometry import fuse
from oracle_light import ProxySurface, TrueSurface, lit, solve_albedo
from support.lit_sphere import BOTTOM, RADIUS, TOP
from support.measured_sphere import measured_views

BOX = ((-0.8, -0.8, -0.8), (0.8, 0.8, 0.8))
CPU = torch.device("cpu")


def lamp() -> MapLight:
    image = np.full((8, 16, 3), 0.3, np.float32)
    image[1, 3] = (9.0, 5.0, 2.0)
    return MapLight.from_image(image, CPU)


@pytest.mark.parametrize("metalness", [0.0, 0.6, 1.0])
def test_the_albedo_behind_a_picture_is_found_again_whatever_the_metalness(metalness: float):
    count, light = 20, lamp()
    generator = torch.Generator().manual_seed(1)
    albedo = torch.rand(count, 3, generator=generator) * 0.9 + 0.05
    normal = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    tilt = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    omega_o = torch.nn.functional.normalize(normal + 0.4 * tilt, dim=-1)
    points = ShadingPoints(torch.zeros(count, 3), normal, omega_o, torch.zeros(count, dtype=torch.long))

    def picture(colour: torch.Tensor) -> torch.Tensor:
        materials = Materials(colour, torch.full((count, 1), 0.3), torch.full((count, 1), metalness))
        same = torch.Generator().manual_seed(2)
        return lit(points, materials, light, unoccluded, DirectionCounts.split(64), same)

    black, white = picture(torch.zeros(count, 3)), picture(torch.ones(count, 3))
    found = solve_albedo(picture(albedo), black, white)
    assert torch.allclose(found, albedo, atol=1e-4)


def test_albedo_without_light_is_bounded():
    dark = torch.zeros(2, 3)
    assert solve_albedo(torch.ones(2, 3), dark, dark).max() <= 4.0


@pytest.fixture(scope="module")
def surface() -> ProxySurface:
    if llvm_library() is None:
        pytest.skip("needs an LLVM library to cast rays with (Debian: libllvm19)")
    views = measured_views()
    return ProxySurface(fuse(views, views, *BOX, resolution=40))


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
    view = measured_views()[3]
    true = TrueSurface(view, surface, grid=2)
    plain = true.radiance(lamp(), None, 64, 0)
    own = true.radiance(lamp(), bounces, 64, 0)
    assert (plain - own).abs().mean() < 0.02 * plain.mean()


@pytest.mark.slow
def test_pixels_at_the_outline_are_shaded_at_several_points_and_the_others_at_one(surface: ProxySurface):
    view = measured_views()[3]
    centres, fine = TrueSurface(view, surface, grid=3).samples
    assert centres.share == 1
    assert fine.share == 9
    alpha = torch.tensor(view.truth["albedo"][..., 3]).flatten()
    pixels = TrueSurface(view, surface, grid=3).pixels
    assert (alpha[pixels[centres.owner]] == 1.0).float().mean() > 0.9
    assert set(centres.owner.tolist()).isdisjoint(fine.owner.tolist())
    assert len(set(centres.owner.tolist()) | set(fine.owner.tolist())) == len(pixels)


@pytest.mark.slow
def test_values_of_pixels_come_back_in_place(surface: ProxySurface):
    view = measured_views()[7]
    true = TrueSurface(view, surface, grid=1)
    found = true.as_map(true.albedo())
    assert np.array_equal(found, view.truth["albedo"][..., :3])
    assert np.abs(found).max() <= max(TOP.max(), BOTTOM.max()) + 1e-6
