"""Fixed shapes: what is computed stays the same, and the host of a GPU waits for nothing."""

from dataclasses import replace

import pytest
import torch
from flashcache.caches.environment import Environment, EnvironmentConfig
from flashcache.config import Config, DistilConfig
from flashcache.data.hull import fit_occupancy
from flashcache.data.ray_batches import PixelChoice, TrainingPixels
from flashcache.encoding.occupancy import OccupancyConfig
from flashcache.losses.metalness import directional_variation
from flashcache.losses.shape import ShapePriorConfig
from flashcache.physical.estimator import EstimatorConfig
from flashcache.physical.model import InverseModel
from flashcache.presets import preset, tiny
from flashcache.rows import Rows, fixed_shapes, mean_where, shapes_are_fixed
from flashcache.training.distil import Distillation
from flashcache.training.stage_one import StageOne, masked_psnr
from flashcache.training.stage_two import StageTwo
from support.host_waits import host_waits
from support.joint_stage import DOMAIN, EVERYTHING, SCENE

CPU = torch.device("cpu")


def model_of(config: Config, cells: int = 16, colours: int | None = None) -> InverseModel:
    """Return a model with a surface: an opaque ball in haze."""
    torch.manual_seed(0)
    nerf = config.model.nerf
    nerf = replace(nerf, secondary_colours=nerf.secondary_colours if colours is None else colours)
    nerf = replace(nerf, secondary_sure_opacity=0.5)
    settings = replace(config.model, nerf=nerf, occupancy=OccupancyConfig(cells=cells))
    model = InverseModel(settings, DOMAIN)
    fit_occupancy(model, SCENE)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.02 * torch.randn(parameter.shape))
        model.nerf.density.head.bias += 2.0
    return model


def stage_one(fixed: bool, cells: int = 16, **settings) -> StageOne:
    config = tiny()
    model = model_of(config, cells)
    pixels = TrainingPixels(SCENE, config.pixels, CPU, model.nerf.occupancy)
    prior = ShapePriorConfig(recession_weight=0.2, flatness_weight=0.03, emptiness_weight=0.1)
    everything = {"num_rays": 48, "normal_every": 1, "grid_decay": 0.1, "shape_prior": prior}
    one = replace(config.stage_one, **(everything | settings))
    return StageOne(model, pixels, one, seed=0, fixed=fixed)


def stage_two(fixed: bool, cells: int = 16, colours: int | None = None, **settings) -> StageTwo:
    config = tiny()
    model = model_of(config, cells, colours)
    pixels = TrainingPixels(SCENE, replace(config.pixels, clipped="at_least"), CPU, model.nerf.occupancy)
    distil = DistilConfig(num_steps=4, num_points=48)
    two = replace(config.stage_two, **(EVERYTHING | {"num_steps": 20, "distil": distil} | settings))
    return StageTwo(model, pixels, two, seed=0, fixed=fixed)


def test_rows_are_picked_out_or_stay_in_place():
    counted = torch.tensor([True, False, True])
    values, background = torch.tensor([[1.0], [2.0], [3.0]]), torch.full((3, 1), 9.0)
    for fixed in (False, True):
        with fixed_shapes(fixed):
            rows = Rows.where(counted)
            assert len(rows.of(values)) == (3 if fixed else 2)
            assert rows.into(background, 10.0 * rows.of(values))[:, 0].tolist() == [10.0, 9.0, 30.0]
            assert float(mean_where(values, counted)) == 2.0
    assert not shapes_are_fixed()


def test_the_mean_of_no_rows_is_zero_with_fixed_shapes():
    with fixed_shapes():
        values = torch.ones(3, requires_grad=True)
        mean = mean_where(values, torch.zeros(3, dtype=torch.bool))
        mean.backward()
    assert float(mean.detach()) == 0.0
    assert not values.grad.any()


@pytest.mark.parametrize("cells", [0, 16])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_no_step_of_stage_one_waits_for_a_gpu(cells, share):
    stage = stage_one(True, cells, carving_share=0.1, specular_from=0.5)
    stage.steps_done = round(share * stage.config.num_steps)
    stage.step()
    assert host_waits(stage.step) == {}


SETTINGS = {
    "everything": {},
    "one pass with gradients": {"symmetric": False},
    "warm-up": {"warmup_steps": 10},
    "two points by halves": {"points_per_ray": 2, "fast_by_half": True, "points": "categorical"},
    "depth": {"points": "depth"},
    "jitter": {"secondary_jitter": True, "random_background": True},
    "without correction": {"estimator": EstimatorConfig(control_variate="fast_only", stratified=True)},
    "NeRF cache alone": {"estimator": EstimatorConfig(control_variate="off", sampler="none")},
}


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS)
def test_no_step_of_stage_two_waits_for_a_gpu(settings):
    stage = stage_two(True, num_rays=16, **settings)
    stage.step()
    assert host_waits(stage.step) == {}


def test_no_step_of_the_distillation_waits_for_a_gpu():
    stage = stage_two(True)
    stage.steps_done = stage.config.num_steps
    stage.step()
    assert host_waits(stage.step) == {}


def test_steps_that_pick_rows_out_do_wait():
    """Otherwise the tests above would say nothing."""
    stage = stage_two(False)
    stage.step()
    assert {"nonzero", "_local_scalar_dense", "index by a mask"} <= host_waits(stage.step).keys()


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("name", ["standard", "paper_tensoir", "paper_glossy"])
def test_no_step_of_a_large_preset_waits_for_a_gpu(name):
    config = preset(name)
    model = InverseModel(config.model, DOMAIN)
    pixels = TrainingPixels(SCENE, config.pixels, CPU, model.nerf.occupancy)
    one, two = replace(config.stage_one, num_rays=64), replace(config.stage_two, num_rays=8)
    for stage in (
        StageOne(model, pixels, one, seed=0, fixed=True),
        StageTwo(model, pixels, two, seed=0, fixed=True),
    ):
        stage.steps_done = round(0.9 * stage.config.num_steps)
        stage.step()
        assert host_waits(stage.step) == {}


@pytest.mark.parametrize("rotated", [False, True])
def test_no_look_up_in_environments_waits_for_a_gpu(rotated):
    rotations = (0.0, 30.0, 120.0) if rotated else ()
    made = Environment(EnvironmentConfig(known_height=4), 3, rotations_deg=rotations, known=(1,))
    directions = torch.nn.functional.normalize(torch.randn(20, 3), dim=-1)
    index = torch.arange(20) % 3
    assert host_waits(lambda: made(directions, index)) == {}


def test_no_draw_of_pixels_waits_for_a_gpu():
    choice = PixelChoice(inside_share=0.5, clipped="at_least")
    pixels = TrainingPixels(SCENE, choice, CPU)
    generator = torch.Generator().manual_seed(0)
    assert host_waits(lambda: pixels.draw(64, generator)) == {}


def gradients(stage: StageOne | StageTwo) -> dict[str, torch.Tensor]:
    with fixed_shapes(stage.fixed):
        stage._differentiate()
    return {n: p.grad.clone() for n, p in stage.model.named_parameters() if p.grad is not None}


def assert_alike(found: dict[str, torch.Tensor], expected: dict[str, torch.Tensor]) -> None:
    assert found.keys() == expected.keys()
    for name, gradient in expected.items():
        scale = float(gradient.abs().max())
        torch.testing.assert_close(found[name], gradient, rtol=2e-3, atol=2e-5 * scale + 1e-10, msg=name)


@pytest.mark.parametrize("cells", [0, 16])
@pytest.mark.parametrize("share", [0.0, 0.9])
def test_gradients_of_stage_one_are_those_of_picked_rows(cells, share):
    found = []
    for fixed in (False, True):
        stage = stage_one(fixed, cells, carving_share=0.1)
        stage.steps_done = round(share * stage.config.num_steps)
        found.append(gradients(stage))
    assert any(bool(gradient.any()) for gradient in found[0].values())
    assert_alike(found[1], found[0])


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS)
def test_gradients_of_stage_two_are_those_of_picked_rows(settings):
    """Where all points of secondary rays answer: drawing some takes numbers by the ray."""
    settings = settings | {"secondary_jitter": False}
    one, other = (gradients(stage_two(fixed, colours=0, **settings)) for fixed in (False, True))
    assert any(bool(gradient.any()) for gradient in one.values())
    assert_alike(other, one)


@pytest.mark.slow
def test_gradients_of_the_distillation_are_those_of_picked_rows_in_the_mean():
    found = []
    for fixed in (False, True):
        stage = stage_two(fixed)
        stage.optimiser.zero_grad(set_to_none=False)
        distillation = Distillation(stage.model, stage.pixels, DistilConfig(num_points=2048), seed=0)
        with fixed_shapes(fixed):
            loss = float(distillation.differentiate(0))
        head = torch.cat([one.grad.flatten() for one in stage.model.fast.distance_head.parameters()])
        found.append((loss, head))
    (loss, one), (other_loss, other) = found
    assert other_loss == pytest.approx(loss, rel=0.03)
    assert float(torch.nn.functional.cosine_similarity(one, other, dim=0)) > 0.98
    assert 0.9 < float(other.norm() / one.norm()) < 1.1


def test_rays_that_meet_no_surface_teach_nothing_with_fixed_shapes():
    stage = stage_two(True)
    with torch.no_grad():
        stage.model.nerf.density.head.bias.fill_(-50.0)
    distillation = Distillation(stage.model, stage.pixels, DistilConfig(num_points=32), seed=0)
    stage.optimiser.zero_grad(set_to_none=False)
    with fixed_shapes():
        assert float(distillation.differentiate(0)) == 0.0
    assert not any(one.grad.any() for one in stage.model.fast.parameters() if one.grad is not None)


def test_brightness_and_psnr_are_those_of_picked_rows():
    torch.manual_seed(0)
    diffuse, specular = torch.rand(2, 41, 6, 3)
    stage = stage_one(True)
    batch = stage.pixels.draw(64, torch.Generator().manual_seed(0))
    picture = torch.rand(64, 3)
    for weight in ((torch.rand(41) > 0.5).float(), torch.zeros(41), torch.eye(41)[3]):
        covered = replace(batch, coverage=torch.ones(64) * weight.max())
        found = []
        for fixed in (False, True):
            with fixed_shapes(fixed):
                found.append(
                    (directional_variation(diffuse, specular, weight), masked_psnr(picture, covered))
                )
        (picked, psnr), (masked, same) = found
        torch.testing.assert_close(masked.bright, picked.bright)
        assert float(same) == pytest.approx(psnr, rel=1e-5)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cache", "joint"])
def test_losses_fall_alike_with_fixed_shapes(kind):
    """Their difference is within that of two seeds."""
    curves = {}
    for fixed, seed in ((False, 0), (False, 1), (True, 0), (True, 1)):
        made = stage_one(fixed, num_rays=128) if kind == "cache" else stage_two(fixed, num_rays=32)
        made.seed = made.losses.seed = seed
        made.config = replace(made.config, num_steps=30)
        made.losses.config = made.config
        values = [made.step().read().loss for _ in range(30)]
        curves[fixed, seed] = torch.tensor(values).reshape(6, 5).mean(dim=1)
    seeds = (curves[False, 0] - curves[False, 1]).abs().max()
    means = [sum(curves[fixed, seed] for seed in (0, 1)) / 2.0 for fixed in (False, True)]
    assert float((means[0] - means[1]).abs().max()) < float(seeds)
