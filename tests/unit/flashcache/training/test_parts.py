"""Parts of a batch together are the batch: gradients, rays, random numbers, and the same bits every time."""

from dataclasses import replace

import pytest
import torch
from flashcache.data.ray_batches import TrainingPixels
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.parts import LEAST_RAYS, Parts, twin_of
from flashcache.training.stage_one import StageOne
from support.joint_stage import stage
from support.lit_sphere import lit_domain, lit_sphere

SCENE = lit_sphere()
DOMAIN = lit_domain(SCENE)


@pytest.fixture
def threads():
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


def model() -> InverseModel:
    torch.manual_seed(0)
    return InverseModel(tiny().model, DOMAIN)


def nerf_of(whole: InverseModel) -> torch.nn.Module:
    return whole.nerf


def parts_of(whole: InverseModel, count: int) -> Parts:
    parts = Parts(whole, nerf_of, count * LEAST_RAYS)
    assert parts.count == count
    return parts


def positions(number: int) -> torch.Tensor:
    return torch.rand(16, 3, generator=torch.Generator().manual_seed(number)) - 0.5


def density_loss(model: InverseModel, number: int) -> tuple[torch.Tensor, int]:
    return model.nerf.density.density(positions(number)).square().mean(), number


def gradients(model: InverseModel) -> dict[str, torch.Tensor]:
    return {n: p.grad.clone() for n, p in model.nerf.density.named_parameters() if p.grad is not None}


def count_rays(model: InverseModel, counts: list[int]) -> None:
    trace = model.nerf.trace

    def counting(rays, **settings):
        counts.append(len(rays))
        return trace(rays, **settings)

    model.nerf.trace = counting


@pytest.mark.parametrize("count", [2, 3])
def test_the_parts_together_have_the_gradient_of_their_mean_loss(threads, count):
    threads(count)
    split, whole = model(), model()
    assert parts_of(split, count).differentiate(density_loss) == list(range(count))
    (sum(density_loss(whole, part)[0] for part in range(count)) / count).backward()
    expected, found = gradients(whole), gradients(split)
    assert expected.keys() == found.keys()
    for name, gradient in expected.items():
        torch.testing.assert_close(found[name], gradient, msg=name)


def test_with_one_thread_the_batch_stays_whole(threads):
    threads(1)
    split, whole = model(), model()
    assert parts_of(split, 1).differentiate(density_loss) == [0]
    density_loss(whole, 0)[0].backward()
    assert all(torch.equal(gradients(split)[name], gradient) for name, gradient in gradients(whole).items())


def test_a_second_step_does_not_remember_the_gradients_of_the_first(threads):
    threads(2)
    made = model()
    parts = parts_of(made, 2)
    parts.differentiate(density_loss)
    once = gradients(made)
    made.zero_grad(set_to_none=False)
    parts.differentiate(density_loss)
    assert all(torch.equal(once[name], gradient) for name, gradient in gradients(made).items())


def test_all_parts_see_the_values_that_the_optimiser_changed(threads):
    threads(2)
    made = model()
    parts = parts_of(made, 2)
    with torch.no_grad():
        made.nerf.density.head.bias.fill_(1.0)
    seen = parts.differentiate(
        lambda model, _: (model.nerf.density.head.bias.sum(), float(model.nerf.density.head.bias.detach()))
    )
    assert seen == [1.0, 1.0]


def test_the_parts_of_an_odd_batch_are_the_whole_of_it(threads):
    threads(3)
    parts = parts_of(model(), 3)
    pixels = TrainingPixels(SCENE, tiny().pixels, torch.device("cpu"))
    batch = pixels.draw(7, torch.Generator().manual_seed(0))
    parts = [parts.of(batch, part).rays.directions for part in range(parts.count)]
    assert torch.equal(torch.cat(parts), batch.rays.directions)


def test_small_batches_are_not_divided(threads):
    threads(4)
    assert [Parts(model(), nerf_of, rays).count for rays in (1, 2 * LEAST_RAYS, 100 * LEAST_RAYS)] == [
        1,
        2,
        4,
    ]


def test_operations_of_an_undivided_batch_use_one_core(threads):
    threads(2)
    seen = parts_of(model(), 1).differentiate(
        lambda model, part: (density_loss(model, part)[0], torch.get_num_threads())
    )
    assert seen == [1]
    assert torch.get_num_threads() == 2


def test_what_is_not_trained_has_no_gradients(threads):
    threads(2)
    made = model()
    made.nerf.proposals.requires_grad_(False)
    parts = parts_of(made, 2)
    parts.differentiate(density_loss)
    frozen = [p for each in parts._models for p in each.nerf.proposals.parameters()]
    assert all(parameter.grad is None for parameter in frozen)


def test_a_twin_shares_values_and_not_gradients():
    made = model()
    made.materials.head.bias.grad = torch.ones_like(made.materials.head.bias)
    twin = twin_of(made)
    with torch.no_grad():
        made.materials.head.bias.add_(1.0)
    assert torch.equal(twin.materials.head.bias, made.materials.head.bias)
    assert twin.materials.head.bias.grad is None
    assert twin.light_sampler.offsets is made.light_sampler.offsets


def test_a_failure_in_any_part_ends_the_step_and_operations_get_their_threads_back(threads):
    threads(2)
    parts = parts_of(model(), 2)

    def broken(model: InverseModel, part: int) -> tuple[torch.Tensor, int]:
        assert torch.get_num_threads() == 1
        if part:
            raise RuntimeError("no light")
        return density_loss(model, part)

    with pytest.raises(RuntimeError, match="no light"):
        parts.differentiate(broken)
    assert torch.get_num_threads() == 2


@pytest.mark.parametrize("symmetric", [True, False])
def test_stage_two_on_two_threads_takes_the_same_step_every_time(threads, symmetric):
    threads(2)
    settings = {"num_rays": 2 * LEAST_RAYS, "symmetric": symmetric}
    values = []
    for _ in range(2):
        made = stage(**settings)
        assert made.parts.count == 2
        made.step(), made.step()
        values.append({name: value.clone() for name, value in made.model.state_dict().items()})
    assert all(torch.equal(values[0][name], values[1][name]) for name in values[0])


def test_the_parts_of_stage_two_draw_numbers_of_their_own(threads):
    threads(1)
    made = stage()
    batch = made.draw()
    pictures = [made.losses(made.model, batch, part)[1] for part in (0, 0, 1)]
    assert torch.equal(pictures[0], pictures[1])
    assert not torch.equal(pictures[0], pictures[2])


def test_two_threads_give_the_same_bits_every_time_and_use_every_ray(threads):
    threads(2)
    values = []
    for _ in range(2):
        config, made = tiny(), model()
        pixels = TrainingPixels(SCENE, config.pixels, torch.device("cpu"))
        settings = replace(config.stage_one, num_rays=2 * LEAST_RAYS)
        one = StageOne(made, pixels, settings, seed=0)
        rays = []
        for copy in one.parts._models:
            count_rays(copy, rays)
        one.step(), one.step()
        assert rays == 4 * [LEAST_RAYS]
        values.append({name: value.clone() for name, value in made.state_dict().items()})
    assert all(torch.equal(values[0][name], values[1][name]) for name in values[0])
