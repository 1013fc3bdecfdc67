"""The method on a GPU says what it says on the processor, in value and gradient, and learns there too."""

from dataclasses import replace

import pytest
import torch
from flashcache.config import Config, DistilConfig
from flashcache.data.ray_batches import TrainingPixels
from flashcache.evaluation.gbuffer import render_gbuffer
from flashcache.evaluation.views import PictureSamples, render_physical, render_relit
from flashcache.kernels import dispatch, reference
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from support.lit_sphere import lit_domain, lit_sphere

pytestmark = pytest.mark.gpu
CUDA = torch.device("cuda")
SCENE = lit_sphere()


def model_on(device: torch.device, config: Config) -> InverseModel:
    torch.manual_seed(0)
    return InverseModel(config.model, lit_domain(SCENE)).to(device)


def short() -> Config:
    base = tiny()
    return replace(
        base,
        stage_one=replace(base.stage_one, num_steps=40, num_rays=256, warmup_steps=2),
        stage_two=replace(
            base.stage_two, num_steps=8, num_rays=64, warmup_steps=2, distil=DistilConfig(num_steps=2)
        ),
    )


def test_the_grid_answers_as_on_the_processor_in_value_and_gradient():
    torch.manual_seed(0)
    grid = model_on(torch.device("cpu"), tiny()).nerf.density.grid
    with torch.no_grad():
        grid.table.normal_()
    z = 1.8 * torch.rand(500, 3) - 0.9
    answers = {}
    for device in (torch.device("cpu"), CUDA):
        table = grid.table.detach().to(device).requires_grad_()
        features, jacobian = dispatch.encode_with_jacobian(z.to(device), table, grid.layout)
        (features.square().mean() + 1e-3 * jacobian.square().mean()).backward()
        assert table.grad is not None
        answers[device.type] = [value.detach().cpu() for value in (features, jacobian, table.grad)]
    expected, _ = reference.encode_with_jacobian(z.double(), grid.table.detach().double(), grid.layout)
    torch.testing.assert_close(answers["cuda"][0].double(), expected, rtol=1e-4, atol=1e-4)
    for ours, theirs in zip(answers["cuda"], answers["cpu"], strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-3, atol=1e-3 * float(theirs.abs().max()))


def test_both_stages_train_there_and_no_step_is_skipped():
    config = short()
    model = model_on(CUDA, config)
    pixels = TrainingPixels(SCENE, config.pixels, CUDA)
    one = StageOne(model, pixels, config.stage_one, seed=0)
    psnr = []
    while not one.finished:
        psnr.append(one.step().psnr)
    two = StageTwo(model, pixels, config.stage_two, seed=0)
    while not two.finished:
        two.step()
    assert sum(psnr[-5:]) > sum(psnr[:5]) + 5.0
    assert one.num_skipped == two.num_skipped == 0
    assert all(bool(torch.isfinite(value).all()) for value in model.state_dict().values())
    assert all(value.is_cuda for value in model.parameters())


def test_pictures_of_the_same_model_agree_with_the_processors():
    model = model_on(torch.device("cpu"), tiny())
    with torch.no_grad():
        model.nerf.density.head.bias += 3.0
    camera = SCENE.train[0].camera
    here = render_gbuffer(model, camera)
    light = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(1)).numpy()
    samples = PictureSamples(num_directions=16, num_repeats=4)
    physical = render_physical(model, camera, samples)
    relit = render_relit(model, camera, light, samples)
    there = model.to(CUDA)
    buffer = render_gbuffer(there, camera)
    for name in ("opacity", "distance", "normal", "albedo", "cache_rgb"):
        ours, theirs = torch.tensor(getattr(buffer, name)), torch.tensor(getattr(here, name))
        torch.testing.assert_close(ours, theirs, rtol=1e-3, atol=1e-3)
    for wanted, found in (
        (physical, render_physical(there, camera, samples)),
        (relit, render_relit(there, camera, light, samples)),
    ):
        # Generators of the two devices draw different numbers: the means differ by their noise.
        noise = (wanted.standard_error**2 + found.standard_error**2).mean() / wanted.rgb[..., 0].size / 3
        assert abs(wanted.rgb.mean() - found.rgb.mean()) < 6.0 * noise**0.5 + 1e-3 * wanted.rgb.mean()
