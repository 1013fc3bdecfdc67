from dataclasses import replace

import pytest
import torch
from flashcache.physical.shading import Estimate, ShadingPoints
from flashcache.training.joint_losses import cache_terms, consistency_terms, physical_loss
from support.joint_stage import stage


def test_where_nothing_is_covered_the_physical_picture_does_not_count():
    made = stage()
    batch = made.pixels.draw(40, torch.Generator().manual_seed(0))
    outside = batch.coverage == 0.0
    assert outside.any()
    cache, picture, other = torch.rand(3, 40, 3, generator=torch.Generator().manual_seed(1))
    picture.requires_grad_()
    physical_loss(made.config, batch, cache, picture, other).backward()
    assert torch.equal(picture.grad.abs().sum(dim=-1) > 0.0, ~outside)


def test_neither_picture_is_too_bright_for_a_photograph_that_is_clipped_everywhere():
    made = stage()
    batch = made.pixels.draw(40, torch.Generator().manual_seed(0))
    batch = replace(batch, colour=0.0 * batch.colour, coverage=torch.ones(40))
    cache, picture, other = 0.1 + torch.rand(3, 40, 3, generator=torch.Generator().manual_seed(1))
    geometry = made.model.nerf.trace(batch.rays, generator=None)
    found = []
    for clipped in (torch.ones(40, 3, dtype=torch.bool), None):
        given = replace(batch, clipped=clipped)
        terms = cache_terms(
            made.model, made.config, given, geometry, cache, torch.Generator(), with_normals=False
        )
        physical = physical_loss(made.config, given, cache, picture, other)
        found.append((float(terms["colour"].detach()), float(physical)))
    assert found[0] == (pytest.approx(1e-3), 0.0)
    assert found[1][0] > 0.1
    assert found[1][1] > 0.0


def test_each_head_of_the_cache_is_taught_by_the_estimate_of_the_same_name():
    model = stage().model
    towards = torch.nn.functional.normalize(torch.randn(20, 3), dim=-1)
    points = ShadingPoints(0.5 * towards, towards, towards, torch.zeros(20, dtype=torch.long))
    hidden = model.nerf.density(points.positions).hidden.detach()
    heads = model.nerf.appearance(points.positions, hidden, points.normal, points.omega_o, points.light_index)
    own = {name: getattr(heads, name).detach() for name in ("diffuse", "specular", "irradiance")}
    told = Estimate(**own, rgb=heads.radiance, variance=None, exact=None)
    agreed = consistency_terms(model, points, hidden, told, torch.ones(20), 1.0)
    assert [float(term.detach()) for term in agreed.values()] == [0.0, 0.0, 0.0]
    for name, values in own.items():
        moved = told._replace(**{name: values + 1.0})
        terms = consistency_terms(model, points, hidden, moved, torch.ones(20), 1.0)
        assert [term for term, value in terms.items() if float(value.detach())] == [f"consistency_{name}"]
