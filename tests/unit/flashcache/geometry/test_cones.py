"""Cones of pixels: the six points of an interval have its moments, and features fade with their width."""

import math

import pytest
import torch
from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.encoding.multisample import (
    contracted_width,
    encode_cones,
    encode_cones_with_jacobian,
    level_weights,
)
from flashcache.fields.cones import cone_density, cone_density_with_gradient
from flashcache.fields.density import DensityConfig, DensityField
from flashcache.geometry.cones import WIDTH_SCALE, ConePoints, cone_points, pixel_radius
from flashcache.geometry.contraction import contract
from flashcache.geometry.rays import Rays

GRID = HashGridConfig(finest_resolution=64, log2_table_size=13)
RADIUS = 0.03


def rays(count: int = 3, radius: float | None = RADIUS) -> Rays:
    generator = torch.Generator().manual_seed(0)
    origins = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    directions = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    directions = torch.nn.functional.normalize(directions, dim=-1)
    ends = torch.ones(count, dtype=torch.float64)
    width = None if radius is None else radius * ends
    return Rays(origins, directions, ends, 3.0 * ends, width)


EDGES = torch.tensor([[1.0, 1.8, 2.0, 3.0]], dtype=torch.float64).expand(3, 4)


def frustum_moments(start: float, end: float) -> tuple[float, float, float]:
    """Return mean and variance along the axis, and variance across it, of a cone's frustum (mip-NeRF)."""
    middle, half = 0.5 * (start + end), 0.5 * (end - start)
    mean = middle + 2.0 * middle * half**2 / (3.0 * middle**2 + half**2)
    along = (
        half**2 / 3.0 - 4.0 / 15.0 * half**4 * (12.0 * middle**2 - half**2) / (3.0 * middle**2 + half**2) ** 2
    )
    across = RADIUS**2 * (
        middle**2 / 4.0 + 5.0 / 12.0 * half**2 - 4.0 / 15.0 * half**4 / (3.0 * middle**2 + half**2)
    )
    return mean, along, across


@pytest.mark.parametrize("interval", [0, 1, 2])
@pytest.mark.parametrize("seed", [None, 5])
def test_the_six_points_have_the_moments_of_the_frustum(interval, seed):
    given = rays()
    generator = None if seed is None else torch.Generator().manual_seed(seed)
    points = cone_points(given, EDGES, generator).positions.reshape(3, 3, 6, 3)[:, interval]
    relative = points - given.origins[:, None]
    t = (relative * given.directions[:, None]).sum(dim=-1)
    sideways = relative - t[..., None] * given.directions[:, None]
    mean, along, across = frustum_moments(float(EDGES[0, interval]), float(EDGES[0, interval + 1]))
    torch.testing.assert_close(t.mean(dim=1), torch.full((3,), mean, dtype=torch.float64))
    torch.testing.assert_close(t.var(dim=1, unbiased=False), torch.full((3,), along, dtype=torch.float64))
    # Across there are two directions; the pattern is centred up to what its points differ in distance.
    spread = sideways.square().sum(dim=-1).mean(dim=1) / 2.0
    torch.testing.assert_close(spread, torch.full((3,), across, dtype=torch.float64), rtol=2e-3, atol=0.0)
    assert float(sideways.mean(dim=1).norm(dim=-1).max()) < 0.2 * math.sqrt(across)


def test_the_six_points_lie_in_six_directions_around_the_axis():
    given = rays(1)
    points = cone_points(given, EDGES[:1, :2]).positions[0] - given.origins
    t = (points * given.directions).sum(dim=-1, keepdim=True)
    sideways = torch.nn.functional.normalize(points - t * given.directions, dim=-1)
    apart = (sideways[:, None] * sideways[None]).sum(dim=-1)
    # Sixty degrees between neighbours: no other point within that angle.
    assert float((apart - 2.0 * torch.eye(6)).max()) < math.cos(math.pi / 3.0) + 1e-9


def test_rays_without_a_radius_are_lines():
    given = rays(radius=None)
    points = cone_points(given, EDGES)
    relative = points.positions.reshape(3, 18, 3) - given.origins[:, None]
    t = (relative * given.directions[:, None]).sum(dim=-1, keepdim=True)
    torch.testing.assert_close(relative, t * given.directions[:, None])
    assert not points.width.any()


def test_widths_grow_with_distance_as_the_cone_does():
    points = cone_points(rays(), EDGES)
    t = (points.positions.reshape(3, 18, 3) - rays().origins[:, None]).norm(dim=-1)
    expected = WIDTH_SCALE * RADIUS * t / math.sqrt(2.0)
    torch.testing.assert_close(points.width.reshape(3, 18), expected, rtol=2e-3, atol=0.0)


def test_a_pixels_cone_has_the_variance_of_its_square():
    # A square of side 1 / focal has a variance of side^2 / 12 per axis, a disc of radius r one of r^2 / 4.
    radius = pixel_radius(torch.tensor(100.0))
    assert float(radius) ** 2 / 4.0 == pytest.approx((1.0 / 100.0) ** 2 / 12.0)


@pytest.mark.parametrize("distance", [0.5, 2.0, 7.0])
def test_contracted_widths_follow_the_volume_of_the_map(distance):
    position = distance * torch.nn.functional.normalize(torch.tensor([[1.0, 2.0, -0.5]]).double(), dim=-1)
    jacobian = torch.autograd.functional.jacobian(lambda x: contract(x, 1.5), position)[0, :, 0]
    expected = jacobian.det().abs() ** (1.0 / 3.0) * 0.1
    found = contracted_width(position, torch.tensor([0.1]).double(), 1.5)
    torch.testing.assert_close(found[0], expected)


def test_a_level_fades_where_its_voxels_are_smaller_than_the_blob():
    grid = HashGrid(GRID)
    sharp, wide = (level_weights(grid, torch.tensor(width)).reshape(3, 2)[:, 0] for width in (1e-5, 0.05))
    torch.testing.assert_close(sharp, torch.ones(3))
    assert (wide.diff() < 0.0).all()
    # erf(1 / sqrt(8 s^2 n^2)) with n = 64 / 2 voxels per unit of length.
    assert float(wide[2]) == pytest.approx(math.erf(1.0 / (math.sqrt(8.0) * 0.05 * 32.0)), rel=1e-5)


def test_points_of_no_width_at_one_place_have_the_features_of_the_place():
    grid = HashGrid(GRID)
    with torch.no_grad():
        grid.table.normal_()
    place = torch.tensor([[0.3, -0.2, 0.7]])
    points = ConePoints(place[:, None].expand(1, 6, 3).contiguous(), torch.zeros(1, 6))
    torch.testing.assert_close(encode_cones(grid, points, 1.5), grid(contract(place, 1.5)))
    features, jacobian = encode_cones_with_jacobian(grid, points, 1.5)
    torch.testing.assert_close(features, encode_cones(grid, points, 1.5))
    expected = grid.encode_with_jacobian(contract(place, 1.5))[1]
    torch.testing.assert_close(jacobian.sum(dim=1), expected)


def test_the_gradient_of_density_is_its_slope_when_the_blob_moves():
    torch.manual_seed(0)
    field = DensityField(DensityConfig(grid=GRID, width=8, num_layers=1), 1.5).double()
    with torch.no_grad():
        field.grid.table.normal_(0.0, 0.3)
    points = cone_points(rays(), EDGES)
    points = ConePoints(points.positions, points.width)
    sample, gradient = cone_density_with_gradient(field, points)
    torch.testing.assert_close(sample.density, cone_density(field, points).density)
    step = 1e-6
    for axis in range(3):
        moved = points.positions.clone()
        moved[..., axis] += step
        # Widths in contracted space change a little with the position; the gradient holds them fixed.
        inside = points.positions.norm(dim=-1).amax(dim=1) < 1.5 - 2 * step
        found = cone_density(field, ConePoints(moved, points.width)).density.log() - sample.density.log()
        torch.testing.assert_close(found[inside] / step, gradient[inside, axis], rtol=1e-3, atol=1e-4)
    assert inside.any()
