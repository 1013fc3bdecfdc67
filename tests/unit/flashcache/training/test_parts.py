"""Parts of a batch together are the batch: gradients, rays, random numbers, and the same bits every time."""

from dataclasses import dataclass, replace

import pytest
import torch
from flashcache.data.ray_batches import RayBatch, TrainingPixels
from flashcache.parallel.processes import Processes
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.cache_losses import CacheLosses
from flashcache.training.parts import LEAST_RAYS, Parts, num_parts
from flashcache.training.stage_one import StageOne
from support.joint_stage import stage
from support.lit_sphere import lit_domain, lit_sphere

SCENE = lit_sphere()
DOMAIN = lit_domain(SCENE)
CONFIG = replace(tiny().stage_one, normal_every=1)
LOSSES = CacheLosses(CONFIG, 0, (SCENE.bounds_min, SCENE.bounds_max))
STEP = CONFIG.num_steps // 2


@pytest.fixture(scope="module")
def processes():
    with Processes(3) as made:
        yield made


@pytest.fixture
def one_thread():
    """Let torch add in one order: several threads add to a table in any."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def model() -> InverseModel:
    torch.manual_seed(0)
    return InverseModel(tiny().model, DOMAIN)


def batch(num_rays: int, seed: int = 0) -> RayBatch:
    pixels = TrainingPixels(SCENE, tiny().pixels, torch.device("cpu"))
    return pixels.draw(num_rays, torch.Generator().manual_seed(seed))


def parts_of(whole: InverseModel, count: int, processes: Processes | None) -> Parts:
    for parameter in whole.nerf.parameters():
        parameter.grad = torch.zeros_like(parameter)
    parts = Parts(whole, lambda found: found.nerf, LOSSES, count * LEAST_RAYS, processes)
    assert parts.count == count
    return parts


def gradients(whole: InverseModel) -> dict[str, torch.Tensor]:
    return {n: p.grad.clone() for n, p in whole.nerf.named_parameters() if p.grad is not None}


@pytest.mark.parametrize("count", [2, 3])
def test_the_parts_together_have_the_gradient_of_their_mean_loss(processes, count):
    split, whole, rays = model(), model(), batch(count * LEAST_RAYS)
    parts = parts_of(split, count, processes)
    found = parts.differentiate(rays, STEP)
    losses = [LOSSES(whole, parts.of(rays, part), STEP, part, count) for part in range(count)]
    (sum(loss for loss, _ in losses) / count).backward()
    for (terms, picture), (_, (expected_terms, expected)) in zip(found, losses, strict=True):
        assert terms == pytest.approx(expected_terms, rel=1e-5, abs=1e-8)
        torch.testing.assert_close(picture, expected)
    expected, added = gradients(whole), gradients(split)
    assert any(bool(gradient.any()) for gradient in expected.values())
    for name, gradient in expected.items():
        torch.testing.assert_close(added[name], gradient, msg=name, rtol=1e-4, atol=1e-7)


@pytest.mark.usefixtures("one_thread")
def test_without_processes_the_batch_stays_whole():
    split, whole, rays = model(), model(), batch(4 * LEAST_RAYS)
    parts = Parts(split, lambda found: found.nerf, LOSSES, len(rays))
    assert parts.count == 1
    parts.differentiate(rays, STEP)
    LOSSES(whole, rays, STEP, 0, 1)[0].backward()
    found = gradients(split)
    assert all(torch.equal(found[name], gradient) for name, gradient in gradients(whole).items())


def test_a_second_step_does_not_remember_the_gradients_of_the_first(processes):
    made, rays = model(), batch(2 * LEAST_RAYS)
    parts = parts_of(made, 2, processes)
    parts.differentiate(rays, STEP)
    once = gradients(made)
    made.zero_grad(set_to_none=False)
    parts.differentiate(rays, STEP)
    assert all(torch.equal(once[name], gradient) for name, gradient in gradients(made).items())


def test_gradients_are_added_to_those_that_are_there(processes):
    made, rays = model(), batch(2 * LEAST_RAYS)
    parts = parts_of(made, 2, processes)
    parts.differentiate(rays, STEP)
    once = gradients(made)
    parts.differentiate(rays, STEP)
    for name, gradient in gradients(made).items():
        torch.testing.assert_close(gradient, 2.0 * once[name], rtol=1e-4, atol=1e-7)


@dataclass
class Bias:
    """Losses that tell the bias that a process sees; importable in tests only, so not for other processes."""

    def __call__(self, model, batch, step, part, count):
        bias = model.nerf.density.head.bias
        return bias.sum(), float(bias.detach())


def test_all_parts_see_the_values_that_the_optimiser_changed(processes):
    made, rays = model(), batch(3 * LEAST_RAYS)
    parts = parts_of(made, 3, processes)
    before = parts.differentiate(rays, STEP)
    with torch.no_grad():
        made.nerf.density.head.bias.add_(3.0)
    after = parts.differentiate(rays, STEP)
    for (_, one), (_, other) in zip(before, after, strict=True):
        assert float((one - other).abs().max()) > 1e-3


def test_the_parts_of_an_odd_batch_are_the_whole_of_it(processes):
    parts = parts_of(model(), 3, processes)
    rays = batch(7)
    pieces = [parts.of(rays, part).rays.directions for part in range(3)]
    assert torch.equal(torch.cat(pieces), rays.rays.directions)


def test_small_batches_are_not_divided():
    found = [num_parts(rays, 4) for rays in (1, LEAST_RAYS, 2 * LEAST_RAYS, 100 * LEAST_RAYS)]
    assert found == [1, 1, 2, 4]


def test_operations_of_a_part_use_one_core():
    seen = []

    def losses(model, batch, step, part, count):
        seen.append(torch.get_num_threads())
        return Bias()(model, batch, step, part, count)

    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        Parts(model(), lambda found: found.nerf, losses, 64).differentiate(batch(64), 0)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert seen == [1]


def test_what_is_not_trained_has_no_gradients(processes):
    made = model()
    made.nerf.proposals.requires_grad_(False)
    parts = Parts(made, lambda found: found.nerf, LOSSES, 2 * LEAST_RAYS, processes)
    own = {id(parameter) for parameter in parts._own.parameters}
    assert len(parts._gradients[0]) == len(own)
    assert not own & {id(parameter) for parameter in made.nerf.proposals.parameters()}


@pytest.mark.parametrize("here", [True, False])
def test_a_failure_in_any_part_ends_the_step_and_operations_get_their_threads_back(processes, here):
    threads, rays = torch.get_num_threads(), batch(2 * LEAST_RAYS)
    parts = parts_of(model(), 2, processes)
    own = parts._own
    if not here:
        parts._own = lambda *question: None
    with pytest.raises(OverflowError):
        parts.differentiate(rays, 10**400)
    assert torch.get_num_threads() == threads
    parts._own = own
    assert len(parts.differentiate(rays, STEP)) == 2


@pytest.mark.parametrize("symmetric", [True, False])
def test_stage_two_in_two_processes_takes_the_same_step_every_time(processes, symmetric):
    settings = {"num_rays": 2 * LEAST_RAYS, "symmetric": symmetric}
    values = []
    for _ in range(2):
        made = stage(processes=processes, **settings)
        assert made.parts.count == 2
        made.step(), made.step()
        values.append({name: value.clone() for name, value in made.model.state_dict().items()})
    assert all(torch.equal(values[0][name], values[1][name]) for name in values[0])


def test_the_parts_of_stage_two_draw_numbers_of_their_own():
    made = stage()
    rays = made.draw()
    pictures = [made.losses.terms(made.model, rays, 0, part)[1] for part in (0, 0, 1)]
    assert torch.equal(pictures[0], pictures[1])
    assert not torch.equal(pictures[0], pictures[2])


def test_two_processes_give_the_same_bits_every_time(processes):
    values = []
    for _ in range(2):
        config, made = tiny(), model()
        pixels = TrainingPixels(SCENE, config.pixels, torch.device("cpu"))
        settings = replace(config.stage_one, num_rays=2 * LEAST_RAYS)
        one = StageOne(made, pixels, settings, seed=0, processes=processes)
        one.step(), one.step()
        values.append({name: value.clone() for name, value in made.state_dict().items()})
    assert all(torch.equal(values[0][name], values[1][name]) for name in values[0])
