"""The two passes of stage two are independent, and it finds materials which are known."""

from dataclasses import replace

import pytest
import torch
from flashcache.config import DistilConfig, Rates
from flashcache.data.ray_batches import TrainingPixels
from flashcache.losses.metalness import MetalnessPriorConfig
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.randomness import generator_for
from flashcache.training import stage_two
from support.joint_stage import SCENE, stage, terms_of_step
from support.lit_sphere import BOTTOM, RADIUS, TOP, lit_domain
from support.sphere_model import make_ball, small_config
from support.statistics import assert_mean


@pytest.mark.parametrize("symmetric", [True, False])
def test_the_noise_of_one_pass_says_nothing_about_the_noise_of_the_other(monkeypatch, symmetric):
    def of_two_steps(seed, stage, step, stream, device):
        # The same rays in every step: what differs is the noise of the passes.
        return generator_for(seed, stage, 0 if stream == "rays" else step, stream, device)

    passes = []
    right = stage_two.shade
    monkeypatch.setattr(stage_two, "generator_for", of_two_steps)
    monkeypatch.setattr(
        stage_two, "shade", lambda *given, **options: passes.append(right(*given, **options)) or passes[-1]
    )
    made = stage(num_rays=256, symmetric=symmetric, normal_weight=0.0)
    pictures = []
    for step in range(2):
        made.steps_done = step
        passes.clear()
        made.losses.terms(made.model, made.draw(), made.steps_done)
        pictures.append([picture.detach() for found in passes for picture in found.pictures])
    noise_a, noise_b = (one - other for one, other in zip(*pictures, strict=True))
    rough = (noise_a.abs().sum(dim=-1) > 0.0) & (noise_b.abs().sum(dim=-1) > 0.0)
    assert int(rough.sum()) > 100
    # On the scale of the noise itself, so that a few bright rays do not decide.
    scale = (noise_a.square() + noise_b.square()).sum(dim=-1)[rough]
    assert_mean((noise_a * noise_b).sum(dim=-1)[rough] / scale, 0.0)


@pytest.mark.parametrize(("symmetric", "calls"), [(True, 1), (False, 2)])
def test_passes_draw_new_numbers_in_every_step(monkeypatch, symmetric, calls):
    seeds = []
    right = stage_two.shade

    def shade(model, config, batch, geometry, generator, **options):
        seeds.append(generator.initial_seed())
        return right(model, config, batch, geometry, generator, **options)

    monkeypatch.setattr(stage_two, "shade", shade)
    made = stage(symmetric=symmetric)
    for step in range(3):
        made.losses.terms(made.model, made.draw(), step)
    assert len(set(seeds)) == len(seeds) == 3 * calls


def test_the_physical_loss_compares_each_pass_with_the_other(monkeypatch):
    compared = []
    right = stage_two.physical_loss
    monkeypatch.setattr(
        stage_two, "physical_loss", lambda *given: compared.append(given[-2:]) or right(*given)
    )
    terms_of_step(stage(num_rays=64, symmetric=True, normal_weight=0.0))
    (first, its_other), (second, other) = compared
    assert torch.equal(first, other)
    assert torch.equal(second, its_other)
    assert not torch.equal(first, second)


def test_gradients_reach_the_materials_through_both_passes_alike(monkeypatch):
    """With the passes exchanged, a symmetric loss and its gradient stay what they are."""
    right = stage_two.shade

    def exchanged(*given, **options):
        found = right(*given, **options)
        return replace(found, pictures=found.pictures.flip(0))

    def gradient() -> torch.Tensor:
        made = stage(symmetric=True)
        made.optimiser.zero_grad(set_to_none=False)
        terms_of_step(made)["physical"].backward()
        return made.model.materials.head.weight.grad.clone()

    usual = gradient()
    monkeypatch.setattr(stage_two, "shade", exchanged)
    assert usual.any()
    torch.testing.assert_close(gradient(), usual, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("rate", [0.0, 1e-2])
def test_width_and_metalness_with_a_grid_of_their_own_move_at_rates_of_their_own(rate):
    config = tiny()
    materials = replace(config.model.materials, gloss_grid=config.model.materials.grid)
    config = replace(config, model=replace(config.model, materials=materials))
    made = stage(config, gloss_rates=Rates(grid=rate, network=rate))
    own, other = made.model.materials.gloss, made.model.materials.grid
    before = own.grid.table.clone(), own.head.weight.clone(), other.table.clone()
    made.step()
    for parameter, old in zip((own.grid.table, own.head.weight), before, strict=False):
        assert torch.equal(parameter, old) == (rate == 0.0)
    assert not torch.equal(other.table, before[2])


def test_without_symmetry_the_second_pass_is_a_constant(monkeypatch):
    passes = []
    right = stage_two.shade
    monkeypatch.setattr(
        stage_two, "shade", lambda *given, **options: passes.append(right(*given, **options)) or passes[-1]
    )
    terms_of_step(stage(symmetric=False))
    assert [made.pictures.requires_grad for made in passes] == [True, False]


class Radial(torch.nn.Module):
    """Normals of a ball at the origin."""

    def forward(self, positions: torch.Tensor, hidden: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.normalize(positions, dim=-1)


@pytest.mark.slow
def test_stage_two_finds_the_albedo_of_a_ball_under_a_known_light_to_eight_hundredths():
    base = tiny()
    small = small_config(own_normal_grid=False, softplus_beta=10.0, distance_layers=2).nerf
    nerf = replace(small, proposals=(small.density, small.density), secondary_colours=1)
    torch.manual_seed(0)
    domain = replace(lit_domain(SCENE), known_lights=SCENE.lights)
    model = InverseModel(replace(base.model, nerf=nerf), domain)
    for field in (model.nerf.density, *model.nerf.proposals):
        make_ball(field, RADIUS / SCENE.contraction_radius)
    model.nerf.normals = Radial()
    rows = base.model.environment.known_height
    model.environment.set_known(0, torch.ones(rows, 2 * rows, 3))
    settings = replace(
        base.stage_two,
        num_steps=70,
        num_rays=64,
        warmup_steps=0,
        normal_weight=0.0,
        smoothness_weight=0.0,
        metalness_prior=MetalnessPriorConfig(),
        distil=DistilConfig(),
    )
    made = stage_two.StageTwo(
        model, TrainingPixels(SCENE, base.pixels, torch.device("cpu")), settings, seed=0
    )
    while not made.finished:
        made.step()
    points = torch.nn.functional.normalize(torch.randn(400, 3), dim=-1)
    points = RADIUS * points[points[:, 2].abs() > 0.2]
    found = model.materials(points).albedo.detach()
    for half, albedo in ((points[:, 2] > 0.0, TOP), (points[:, 2] < 0.0, BOTTOM)):
        assert float((found[half] - torch.from_numpy(albedo)).abs().mean()) < 0.08
