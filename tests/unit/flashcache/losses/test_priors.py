"""Priors on environments and grids, and that the colour of an object is not taken for that of the light."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.data.ray_batches import TrainingPixels
from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.losses.priors import grey_prior, grid_decay, tint_prior
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.joint_losses import environment_terms
from flashcache.training.stage_two import StageTwo
from lambent_core.scene import Scene, View
from support.joint_stage import stage
from support.lit_sphere import lit_domain, lit_sphere

STEPS = 20
PAINT = np.array([0.9, 1.0, 0.1, 1.0], np.float32)


def yellow_sphere() -> Scene:
    """Return the sphere with hardly any blue in it."""

    def painted(view: View) -> View:
        return replace(view, images={light: image * PAINT for light, image in view.images.items()})

    scene = lit_sphere(num_views=4)
    return replace(scene, train=tuple(map(painted, scene.train)), test=tuple(map(painted, scene.test)))


def tint_after_training(weight: float) -> float:
    """Return the tint of the light after `STEPS` of stage two in which materials and light are learned."""
    scene, config = yellow_sphere(), tiny()
    torch.manual_seed(0)
    model = InverseModel(config.model, lit_domain(scene))
    pixels = TrainingPixels(scene, config.pixels, torch.device("cpu"))
    asked = replace(
        config.stage_two, num_steps=STEPS, warmup_steps=0, grey_weight=0.0, tint_weight=weight, num_rays=32
    )
    made = StageTwo(model, pixels, asked, seed=0)
    for _ in range(STEPS):
        made.step()
    directions = torch.nn.functional.normalize(
        torch.randn(2000, 3, generator=torch.Generator().manual_seed(0)), dim=-1
    )
    with torch.no_grad():
        return float(tint_prior(model.environment(directions, torch.zeros(2000, dtype=torch.long))))


def test_a_yellow_object_is_not_explained_by_yellow_light():
    weight = tiny().stage_two.tint_weight
    assert weight > 0.0
    assert tint_after_training(0.0) > 0.2
    assert tint_after_training(weight) < 0.02


def test_a_blue_sky_with_a_red_sun_has_no_tint_where_their_sum_is_white():
    radiance = torch.tensor([[0.2, 0.5, 0.9], [0.9, 0.6, 0.2]])
    assert float(tint_prior(radiance)) == pytest.approx(0.0, abs=1e-6)
    assert float(grey_prior(radiance)) > 0.1


def test_tint_is_relative_to_the_brightness_of_the_light():
    radiance = torch.rand(64, 3) * torch.tensor([1.3, 1.0, 0.2])
    assert float(tint_prior(7.0 * radiance)) == pytest.approx(float(tint_prior(radiance)), rel=1e-4)


def test_tint_of_a_known_colour():
    radiance = torch.tensor([2.0, 1.0, 0.5]).expand(9, 3)
    assert float(tint_prior(radiance)) == pytest.approx(2.0 / 3.0 * torch.tensor(2.0).log().item() ** 2)


def test_light_without_a_channel_has_a_finite_gradient_that_brings_it_back():
    radiance = torch.tensor([[1.0, 1.0, 0.0]], requires_grad=True)
    tint_prior(radiance).backward()
    assert torch.isfinite(radiance.grad).all()
    raised = torch.tensor([[1.0, 1.0, 1e-3]], requires_grad=True)
    tint_prior(raised).backward()
    assert float(raised.grad[0, 2]) < 0.0


@pytest.mark.parametrize(("name", "other"), [("grey", "tint"), ("tint", "grey")])
def test_each_prior_has_a_weight_of_its_own(name: str, other: str):
    made = stage()
    config = replace(made.config, **{f"{name}_weight": 0.5, f"{other}_weight": 0.0})
    terms = environment_terms(made.model, config, torch.Generator().manual_seed(0))
    twice = replace(config, **{f"{name}_weight": 1.0})
    more = environment_terms(made.model, twice, torch.Generator().manual_seed(0))
    assert list(terms) == [name]
    assert more[name].item() == pytest.approx(2.0 * terms[name].item())


def test_known_light_has_no_prior():
    made = stage()
    made.model.environment.register_buffer("learned_lights", torch.zeros(0, dtype=torch.long))
    assert environment_terms(made.model, made.config, torch.Generator()) == {}


def levels(made: HashGrid) -> list[torch.Tensor]:
    return [made.table[level.first_row :][: level.num_rows] for level in made.layout.levels]


def grid(finest: int = 64) -> HashGrid:
    torch.manual_seed(0)
    made = HashGrid(HashGridConfig(finest_resolution=finest, log2_table_size=13))
    with torch.no_grad():
        made.table.normal_()
    return made


def test_every_level_counts_by_its_own_mean():
    made = grid()
    expected = sum(0.5 * level.square().mean() for level in levels(made))
    torch.testing.assert_close(grid_decay([made]), expected)


def test_the_decay_of_several_grids_is_the_sum_of_theirs():
    one, two = grid(), grid(32)
    torch.testing.assert_close(grid_decay([one, two]), grid_decay([one]) + grid_decay([two]))
