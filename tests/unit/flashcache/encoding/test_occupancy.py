"""Cells that may hold something: where they are, and the stretch of a ray that they fill."""

import pytest
import torch
from flashcache.encoding.occupancy import Occupancy, OccupancyConfig
from flashcache.errors import ConfigError
from flashcache.geometry.rays import Rays
from flashcache.kernels import dispatch

LOW, HIGH = (-1.0, -1.0, -2.0), (1.0, 1.0, 2.0)


def with_ball(resolution: int = 32, radius: float = 0.5) -> Occupancy:
    """Return a lattice whose cells with middles in a ball around the origin may hold something."""
    occupancy = Occupancy(LOW, HIGH, resolution)
    axes = [
        low + (torch.arange(resolution) + 0.5) * (high - low) / resolution
        for low, high in zip(LOW, HIGH, strict=True)
    ]
    middles = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)
    occupancy.set(middles.norm(dim=-1) < radius)
    return occupancy


def holds(occupancy: Occupancy, positions: torch.Tensor) -> torch.Tensor:
    """Return whether positions lie in a cell that may hold something."""
    place = (positions - occupancy.low) / occupancy.size
    count = occupancy.cells.shape[0]
    inside = ((place >= 0.0) & (place < count)).all(dim=-1)
    x, y, z = place.long().clamp(0, count - 1).unbind(dim=-1)
    return inside & (occupancy.cells[x, y, z] > 0)


def test_every_point_with_a_share_lies_in_a_cell():
    occupancy = with_ball()
    points = 2.4 * torch.rand(20_000, 3, generator=torch.Generator().manual_seed(1)) - 1.2
    assert bool((holds(occupancy, points) | (occupancy.share(points) == 0.0)).all())


def random_rays(count: int) -> Rays:
    generator = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    aim = torch.rand(count, 3, generator=generator) - 0.5
    near = 0.2 * torch.rand(count, generator=generator)
    return Rays(aim - 3.0 * directions, directions, near, near + 6.0)


def test_the_share_is_one_among_occupied_cells_and_fades_to_zero_within_them():
    occupancy = Occupancy(LOW, HIGH, 8)
    cells = torch.zeros(8, 8, 8, dtype=torch.bool)
    cells[2:6, 1:4, 3:6] = True  # Middles of x -0.375 to 0.375, y -0.625 to -0.125, z -0.25 to 0.75.
    occupancy.set(cells)
    points = torch.tensor(
        [
            [0.0, -0.375, 0.25],
            [0.25, -0.375, 0.25],
            [0.375, -0.375, 0.25],
            [0.0, -0.25, 0.25],
            [0.0, -0.375, 0.5],
            [0.0, -0.375, -0.3],
            [0.9, 0.9, 1.9],
        ]
    )
    expected = torch.tensor([1.0, 0.5, 0.0, 0.5, 0.5, 0.0, 0.0])
    torch.testing.assert_close(occupancy.share(points), expected)


def test_nothing_is_outside_of_the_box():
    occupancy = Occupancy(LOW, HIGH, 8)
    points = torch.tensor([[0.0, 0.0, 0.0], [1.01, 0.0, 0.0], [0.0, 0.0, -5.0]])
    torch.testing.assert_close(occupancy.share(points), torch.tensor([1.0, 0.0, 0.0]))


@pytest.mark.parametrize("choice", ["auto", "reference"])
def test_the_stretch_holds_every_occupied_point_of_the_ray_and_little_more(choice):
    occupancy, rays = with_ball(), random_rays(400)
    with dispatch.using(choice):
        narrow = occupancy.narrowed(rays)
    t = torch.linspace(0.0, 6.2, 4000)
    hit = holds(occupancy, rays.at(t.expand(400, -1)))
    step = 0.5 * float(occupancy.size.min())
    for ray in range(400):
        found = t[hit[ray]]
        near, far = narrow.near[ray], narrow.far[ray]
        # At either end a corner that is shorter than a step may be missed.
        missed = (found < near) | (found > far)
        assert int(missed.sum()) * float(t[1]) < 2.0 * step
        if not len(found):
            assert near == far
        elif far > near:
            assert near >= found[0] - 2.0 * step
            assert far <= found[-1] + 2.0 * step
    assert bool((narrow.far > narrow.near).any())
    assert bool((narrow.far == narrow.near).any())


def test_compiled_and_plain_stretches_are_equal():
    occupancy, rays = with_ball(), random_rays(2000)
    compiled = occupancy.narrowed(rays)
    with dispatch.using("reference"):
        plain = occupancy.narrowed(rays)
    # A point on a wall between cells may fall to either side.
    apart = ((compiled.near - plain.near).abs() > 1e-5) | ((compiled.far - plain.far).abs() > 1e-5)
    assert apart.float().mean() < 0.005


def test_a_stretch_stays_within_near_and_far():
    occupancy = with_ball()
    rays = Rays(torch.zeros(1, 3), torch.tensor([[1.0, 0.0, 0.0]]), torch.tensor([0.1]), torch.tensor([0.3]))
    narrow = occupancy.narrowed(rays)
    torch.testing.assert_close(narrow.near, torch.tensor([0.1]))
    torch.testing.assert_close(narrow.far, torch.tensor([0.3]))


@pytest.mark.parametrize("wrong", [{"cells": 1}, {"cells": 500}, {"dissent": 1.0}, {"margin_px": -1.0}])
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ConfigError, match=r"model\.occupancy"):
        OccupancyConfig(**wrong)


def test_a_checkpoint_brings_the_cells_and_the_shares_that_follow_from_them():
    trained, fresh = with_ball(16), Occupancy(LOW, HIGH, 16)
    kept = trained.state_dict()
    assert list(kept) == ["cells"]
    fresh.load_state_dict(kept)
    points = 2.0 * torch.rand(500, 3, generator=torch.Generator().manual_seed(2)) - 1.0
    torch.testing.assert_close(fresh.share(points), trained.share(points))
    assert 0.0 < float(fresh.share(points).mean()) < 1.0
