"""The points and directions at which the cache learns from materials instead of photographs."""

import torch
from flashcache.randomness import generator_for
from flashcache.training.passes import shade
from flashcache.training.unobserved import BLOCKED, unobserved_points
from support.joint_stage import stage


def made_pass():
    made = stage(num_rays=200)
    with torch.no_grad():
        # A fog that stops half of all secondary rays.
        made.model.nerf.density.head.bias.add_(1.5)
    generator = generator_for(0, "test", 0, "rays", torch.device("cpu"))
    batch = made.pixels.draw(200, generator)
    geometry = made.model.nerf.trace(batch.rays, generator=generator)
    first = shade(made.model, made.config, batch, geometry, generator)
    # Hits lie further out than what was shaded, so that this makes them face where their ray came from.
    inwards = lambda _, inputs, __: -torch.nn.functional.normalize(inputs[0], dim=-1)  # noqa: E731
    made.model.nerf.normals.register_forward_hook(inwards)
    return made.model, first


def of_the_pass(points, first) -> torch.Tensor:
    """Return which of `points` were shaded in the pass."""
    return (points.positions[:, None] == first.points.positions).all(dim=-1).any(dim=1)


def test_points_face_their_viewer_and_half_of_them_are_seen_by_secondary_rays_only():
    model, first = made_pass()
    generator = torch.Generator().manual_seed(0)
    points, hidden = unobserved_points(model, first, 120, generator)
    assert len(points.positions) == len(hidden)
    assert 40 < len(points.positions) <= 120
    assert ((points.normal * points.omega_o).sum(dim=-1) > 0.0).all()
    torch.testing.assert_close(points.omega_o.norm(dim=-1), torch.ones(len(points.omega_o)))
    assert 0.2 < float(of_the_pass(points, first).float().mean()) < 0.8


def test_hits_lie_on_blocked_rays_at_their_distance_and_are_looked_at_along_them():
    model, first = made_pass()
    points, _ = unobserved_points(model, first, 120, torch.Generator().manual_seed(0))
    exact = first.estimate.exact
    blocked = exact.nerf.opacity > BLOCKED
    ends = exact.rays.origins + exact.nerf.distance[:, None] * exact.rays.directions
    known = of_the_pass(points, first)
    assert not known.all()
    for position, omega_o in zip(points.positions[~known], points.omega_o[~known], strict=True):
        row = int((ends[blocked] - position).norm(dim=-1).argmin())
        torch.testing.assert_close(ends[blocked][row], position)
        torch.testing.assert_close(-exact.rays.directions[blocked][row], omega_o)


def test_without_exact_rays_only_new_directions_remain():
    model, first = made_pass()
    bare = type(first)(
        first.picture,
        first.estimate._replace(exact=None),
        first.points,
        first.materials,
        first.mixture,
        first.index,
    )
    points, _ = unobserved_points(model, bare, 120, torch.Generator().manual_seed(0))
    assert of_the_pass(points, first).all()
    assert len(points.positions) <= 60
