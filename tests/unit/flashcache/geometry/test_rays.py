"""Rays through pixels and their stretch inside the scene."""

import torch
from flashcache.geometry.rays import Rays, clip_to_box, pixel_directions

BOX = torch.tensor([-1.0, -1.0, -1.0]), torch.tensor([1.0, 1.0, 1.0])


def test_the_middle_of_the_picture_looks_along_minus_z_of_the_camera():
    pose = torch.eye(4)
    direction = pixel_directions(
        torch.tensor([32.0]),
        torch.tensor([32.0]),
        torch.tensor([50.0, 50.0]),
        torch.tensor([32.0, 32.0]),
        pose,
    )
    assert torch.allclose(direction, torch.tensor([[0.0, 0.0, -1.0]]))


def test_rows_grow_downwards_and_columns_to_the_right():
    pose = torch.eye(4)
    focal, centre = torch.tensor([50.0, 50.0]), torch.tensor([32.0, 32.0])
    down = pixel_directions(torch.tensor([32.0]), torch.tensor([60.0]), focal, centre, pose)
    right = pixel_directions(torch.tensor([60.0]), torch.tensor([32.0]), focal, centre, pose)
    assert down[0, 1] < 0.0
    assert right[0, 0] > 0.0


def test_a_ray_is_cut_to_the_box():
    rays = clip_to_box(torch.tensor([[-4.0, 0.0, 0.0]]), torch.tensor([[1.0, 0.0, 0.0]]), *BOX, 0.5, 10.0)
    assert torch.allclose(rays.near, torch.tensor([3.0]))
    assert torch.allclose(rays.far, torch.tensor([5.0]))


def test_a_ray_that_misses_the_box_has_an_empty_stretch():
    rays = clip_to_box(torch.tensor([[-4.0, 3.0, 0.0]]), torch.tensor([[1.0, 0.0, 0.0]]), *BOX, 0.5, 10.0)
    assert rays.near == rays.far


def test_a_ray_that_looks_away_from_the_box_has_an_empty_stretch():
    rays = clip_to_box(torch.tensor([[-4.0, 0.0, 0.0]]), torch.tensor([[-1.0, 0.0, 0.0]]), *BOX, 0.5, 10.0)
    assert rays.near == rays.far


def test_near_and_far_limit_the_stretch():
    rays = clip_to_box(torch.tensor([[-4.0, 0.0, 0.0]]), torch.tensor([[1.0, 0.0, 0.0]]), *BOX, 3.5, 4.0)
    assert (rays.near, rays.far) == (torch.tensor([3.5]), torch.tensor([4.0]))


def test_points_along_a_ray_lie_at_their_distances():
    rays = Rays(torch.zeros(1, 3), torch.tensor([[0.0, 1.0, 0.0]]), torch.zeros(1), torch.ones(1))
    assert torch.equal(rays.at(torch.tensor([[2.0, 3.0]]))[0, :, 1], torch.tensor([2.0, 3.0]))
