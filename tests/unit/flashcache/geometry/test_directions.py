"""Unit vectors, frames and the environment convention."""

import math

import pytest
import torch
from flashcache.geometry.directions import (
    direction_from_uv,
    environment_directions,
    environment_solid_angles,
    from_frame,
    normalize,
    reflect,
    tangent_frame,
    uv_from_direction,
)
from support.sphere import sphere_quadrature


def _directions() -> torch.Tensor:
    axes = torch.cat([torch.eye(3), -torch.eye(3)]).double()
    return torch.cat([axes, sphere_quadrature(16, 32)[0]])


def test_normalized_vectors_have_length_one_however_small_they_were():
    vectors = torch.tensor([[3.0, 4.0, 0.0], [1e-6, 0.0, 0.0], [0.0, 1e9, 1e9]])
    torch.testing.assert_close(normalize(vectors).norm(dim=-1), torch.ones(3))


def test_normalizing_zero_gives_zero_and_a_finite_gradient():
    vectors = torch.zeros(2, 3, requires_grad=True)
    result = normalize(vectors)
    result.sum().backward()
    assert torch.equal(result, torch.zeros(2, 3))
    assert vectors.grad.abs().max() < 1e4


def test_the_gradient_of_normalizing_is_right_where_vectors_are_long_enough():
    vectors = torch.tensor([[0.3, -0.2, 0.9], [0.01, 0.02, -0.003]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(normalize, (vectors,))


def test_reflecting_twice_is_the_identity_and_keeps_the_angle_to_the_axis():
    omega, axis = _directions(), _directions().flip(0)
    mirrored = reflect(omega, axis)
    torch.testing.assert_close(reflect(mirrored, axis), omega)
    torch.testing.assert_close((mirrored * axis).sum(-1), (omega * axis).sum(-1))


def test_tangent_frames_are_orthonormal_and_right_handed_in_every_direction():
    normal = _directions()
    tangent, bitangent = tangent_frame(normal)
    frame = torch.stack([tangent, bitangent, normal], dim=-1)
    identity = torch.eye(3, dtype=torch.float64).expand_as(frame)
    torch.testing.assert_close(frame.mT @ frame, identity)
    torch.testing.assert_close(torch.linalg.det(frame), torch.ones(len(normal), dtype=torch.float64))


def test_the_tangent_of_an_upright_wall_is_horizontal():
    tangent, bitangent = tangent_frame(torch.tensor([1.0, 0.0, 0.0]))
    torch.testing.assert_close(tangent, torch.tensor([0.0, 1.0, 0.0]))
    torch.testing.assert_close(bitangent, torch.tensor([0.0, 0.0, 1.0]))


def test_the_local_z_axis_becomes_the_normal():
    normal = _directions()
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(from_frame(up, normal), normal)


@pytest.mark.parametrize(
    ("u", "v", "direction"),
    [
        (0.5, 0.5, (1.0, 0.0, 0.0)),
        (0.25, 0.5, (0.0, 1.0, 0.0)),
        (0.75, 0.5, (0.0, -1.0, 0.0)),
        (0.0, 0.5, (-1.0, 0.0, 0.0)),
        (0.5, 0.0, (0.0, 0.0, 1.0)),
        (0.5, 1.0, (0.0, 0.0, -1.0)),
    ],
)
def test_environment_pictures_have_z_on_top_x_in_the_middle_and_azimuth_falling_to_the_right(u, v, direction):
    uv = torch.tensor([u, v], dtype=torch.float64)
    expected = torch.tensor(direction, dtype=torch.float64)
    torch.testing.assert_close(direction_from_uv(uv), expected, atol=1e-12, rtol=0.0)
    if 0.0 < v < 1.0:
        torch.testing.assert_close(uv_from_direction(expected), uv, atol=1e-12, rtol=0.0)


def test_pixel_centres_survive_the_round_trip_in_float32():
    directions = environment_directions(32, 64)
    uv = uv_from_direction(directions)
    u = ((torch.arange(64) + 0.5) / 64).expand(32, 64)
    v = ((torch.arange(32) + 0.5) / 32)[:, None].expand(32, 64)
    torch.testing.assert_close(uv, torch.stack([u, v], dim=-1), atol=1e-5, rtol=0.0)


def test_the_pixels_of_a_picture_cover_the_sphere_once():
    solid_angle = environment_solid_angles(24, 48, torch.float64)
    assert math.isclose(float(solid_angle.sum() * 48), 4.0 * math.pi, rel_tol=1e-12)
    centre = environment_directions(24, 48, torch.float64)
    mean = (centre * solid_angle[:, None, None]).sum(dim=(0, 1))
    torch.testing.assert_close(mean, torch.zeros(3, dtype=torch.float64), atol=1e-12, rtol=0.0)
