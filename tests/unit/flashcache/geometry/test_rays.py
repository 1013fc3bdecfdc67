"""Rays through pixels and their stretch inside the scene."""

import pytest
import torch
from flashcache.geometry.rays import Rays, clip_to_box, pixel_directions

BOX = torch.tensor([-1.0, -1.0, -1.0]), torch.tensor([1.0, 1.0, 1.0])


def test_the_middle_looks_along_minus_z_rows_grow_downwards_and_columns_to_the_right():
    focal, centre = torch.tensor([50.0, 50.0]), torch.tensor([32.0, 32.0])
    columns, rows = torch.tensor([[32.0, 32.0, 60.0], [32.0, 60.0, 32.0]])
    middle, down, right = pixel_directions(columns, rows, focal, centre, torch.eye(4))
    assert torch.allclose(middle, torch.tensor([0.0, 0.0, -1.0]))
    assert down[1] < 0.0
    assert right[0] > 0.0


@pytest.mark.parametrize(("limits", "stretch"), [((0.5, 10.0), (3.0, 5.0)), ((3.5, 4.0), (3.5, 4.0))])
def test_a_ray_is_cut_to_the_box_and_to_its_limits(limits, stretch):
    rays = clip_to_box(torch.tensor([[-4.0, 0.0, 0.0]]), torch.tensor([[1.0, 0.0, 0.0]]), *BOX, *limits)
    assert (float(rays.near), float(rays.far)) == pytest.approx(stretch)


@pytest.mark.parametrize(("height", "along"), [(3.0, 1.0), (0.0, -1.0)])
def test_a_ray_that_misses_the_box_or_looks_away_has_an_empty_stretch(height, along):
    origins, directions = torch.tensor([[-4.0, height, 0.0]]), torch.tensor([[along, 0.0, 0.0]])
    rays = clip_to_box(origins, directions, *BOX, 0.5, 10.0)
    assert rays.near == rays.far


def test_points_along_a_ray_lie_at_their_distances():
    rays = Rays(torch.zeros(1, 3), torch.tensor([[0.0, 1.0, 0.0]]), torch.zeros(1), torch.ones(1))
    assert torch.equal(rays.at(torch.tensor([[2.0, 3.0]]))[0, :, 1], torch.tensor([2.0, 3.0]))
