"""Pixels of test views as points to shade."""

import numpy as np
import pytest
import torch
from support.lit_sphere import RADIUS
from support.measured_sphere import measured_views

from benchmarks.oracle_light import ProxySurface
from benchmarks.oracle_views import TrueSurface, behind_pixels


@pytest.mark.slow
def test_pixels_at_the_outline_are_shaded_at_several_points_and_the_others_at_one(surface: ProxySurface):
    view = measured_views()[3]
    true = TrueSurface(view, surface, grid=3)
    (centres, one), (fine, several) = true.samples
    assert (one, several) == (1, 9)
    alpha = torch.tensor(view.truth["albedo"][..., 3]).flatten()[true.pixels]
    assert (alpha[centres.owner] == 1.0).float().mean() > 0.9
    assert set(centres.owner.tolist()).isdisjoint(fine.owner.tolist())
    assert len(set(centres.owner.tolist()) | set(fine.owner.tolist())) == len(true.pixels)


@pytest.mark.slow
def test_points_behind_pixels_lie_on_the_surface_in_front_of_the_viewer(surface: ProxySurface):
    view = measured_views()[3]
    middle = torch.tensor([24 * 48 + 24, 20 * 48 + 20])
    samples, hits = behind_pixels(surface, view.camera, middle, 2)
    assert samples.owner.sort().values.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]
    assert torch.allclose(samples.points.positions.norm(dim=-1), torch.tensor(RADIUS), atol=0.02)
    assert (samples.points.normal * samples.points.omega_o).sum(dim=-1).min() > 0.5
    assert torch.equal(hits.materials.albedo, samples.materials.albedo)


@pytest.mark.slow
def test_values_of_pixels_come_back_in_place(surface: ProxySurface):
    view = measured_views()[7]
    true = TrueSurface(view, surface, grid=1)
    albedo = torch.tensor(view.truth["albedo"][..., :3]).flatten(0, 1)[true.pixels]
    assert np.array_equal(true.as_map(albedo), view.truth["albedo"][..., :3])
