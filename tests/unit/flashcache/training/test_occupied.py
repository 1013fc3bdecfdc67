"""After stage one, cells that the density leaves empty are ruled out; nothing else gets lost."""

import torch
from flashcache.geometry.rays import Rays
from flashcache.training.occupied import keep_filled
from support.sphere_model import RADIUS, sphere_model

CELLS = 24


def test_cells_around_a_ball_are_kept_and_rays_see_the_same():
    model = sphere_model(cells=CELLS).requires_grad_(False)
    occupancy = model.nerf.occupancy
    assert occupancy is not None
    occupancy.set(torch.ones(CELLS, CELLS, CELLS, dtype=torch.bool))
    generator = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(300, 3, generator=generator), dim=-1)
    aim = torch.rand(300, 3, generator=generator) - 0.5
    rays = Rays(aim - 2.0 * directions, directions, torch.full((300,), 0.1), torch.full((300,), 4.0))
    t = torch.linspace(0.1, 4.0, 400).expand(300, -1)

    def depth() -> torch.Tensor:
        return model.nerf.density.density(rays.at(t)).sum(dim=1) * 3.9 / 400

    before = depth()
    keep_filled(model.nerf)
    kept = occupancy.cells.float().mean()
    assert kept < 0.35
    torch.testing.assert_close(depth(), before, rtol=2e-3, atol=2e-3)
    # It is the ball that is kept.
    centre = CELLS // 2
    assert bool(occupancy.cells[centre, centre, centre])
    assert float(occupancy.share(torch.tensor([[0.0, 0.0, RADIUS]]))) == 1.0


def test_without_a_lattice_nothing_happens():
    model = sphere_model()
    keep_filled(model.nerf)
    assert model.nerf.occupancy is None


def test_secondary_rays_see_what_they_saw_and_nothing_beside_it():
    model = sphere_model(cells=CELLS).requires_grad_(False)
    occupancy = model.nerf.occupancy
    assert occupancy is not None
    occupancy.set(torch.ones(CELLS, CELLS, CELLS, dtype=torch.bool))
    keep_filled(model.nerf)
    near, far = torch.full((4,), 0.05), torch.full((4,), 2.0)
    origins = torch.tensor([[-1.0, 0.0, 0.0], [0.0, 0.1, 1.0], [-1.0, 0.0, 0.9], [0.0, 0.0, 1.1]])
    directions = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    lights = torch.zeros(4, dtype=torch.long)
    found = model.nerf.incident(Rays(origins, directions, near, far), lights, None)
    torch.testing.assert_close(found.opacity, torch.tensor([1.0, 1.0, 0.0, 0.0]), rtol=0.0, atol=0.05)
    assert bool((found.distance[:2] < 0.7).all())
    torch.testing.assert_close(found.distance[2:], far[2:])
    assert bool((found.near_radiance[2:] == 0.0).all())
    assert bool((found.near_radiance[:2] > 0.0).all())
    beside = Rays(origins[2:], directions[2:], near[2:], far[2:])
    met = model.nerf.meet(beside, 1, torch.Generator().manual_seed(0))
    assert bool((met.factors == 0.0).all())
    torch.testing.assert_close(met.distance, far[2:])


def test_a_density_that_is_nothing_everywhere_rules_nothing_out():
    model = sphere_model(cells=CELLS).requires_grad_(False)
    model.nerf.density.head.bias.fill_(-200.0)
    assert model.nerf.occupancy is not None
    before = model.nerf.occupancy.cells.clone()
    keep_filled(model.nerf)
    assert torch.equal(model.nerf.occupancy.cells, before)
