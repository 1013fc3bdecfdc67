"""Secondary rays and profiles for measurements."""

import torch
from flashcache.presets import preset

from benchmarks.gpu_steps import profiled, secondary_rays


def test_rays_begin_within_the_contraction_radius_and_have_unit_directions():
    config = preset("paper_tensoir")
    rays = secondary_rays(500, config, torch.Generator().manual_seed(0))
    assert len(rays) == 500
    assert rays.origins.norm(dim=-1).max() <= config.space.contraction_radius
    torch.testing.assert_close(rays.directions.norm(dim=-1), torch.ones(500))
    assert (rays.near, rays.far) == config.space.secondary


def test_a_profile_names_what_takes_longest_per_step():
    values = torch.ones(400, 400)
    found = profiled(lambda: values @ values, torch.device("cpu"))
    assert found["largest"][0]["name"] == "aten::mm"
    assert found["largest"][0]["calls"] == 1.0
    assert found["busy_ms"] >= found["largest"][0]["ms"] > 0.0
