import pytest
import torch
from flashcache.data.ray_batches import TrainingPixels
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.halves import Halves
from flashcache.training.stage_one import StageOne
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


def test_the_halves_together_have_the_gradient_of_their_mean_loss(threads):
    threads(2)
    split, whole = model(), model()
    assert Halves(split, nerf_of).differentiate(density_loss) == [0, 1]
    (0.5 * (density_loss(whole, 0)[0] + density_loss(whole, 1)[0])).backward()
    expected, found = gradients(whole), gradients(split)
    assert expected.keys() == found.keys()
    for name, gradient in expected.items():
        torch.testing.assert_close(found[name], gradient, msg=name)


def test_with_one_thread_the_batch_stays_whole(threads):
    threads(1)
    split, whole = model(), model()
    assert Halves(split, nerf_of).differentiate(density_loss) == [0]
    density_loss(whole, 0)[0].backward()
    assert all(torch.equal(gradients(split)[name], gradient) for name, gradient in gradients(whole).items())


def test_a_second_step_does_not_remember_the_gradients_of_the_first(threads):
    threads(2)
    made = model()
    halves = Halves(made, nerf_of)
    halves.differentiate(density_loss)
    once = gradients(made)
    made.zero_grad(set_to_none=False)
    halves.differentiate(density_loss)
    assert all(torch.equal(once[name], gradient) for name, gradient in gradients(made).items())


def test_both_halves_see_the_values_that_the_optimiser_changed(threads):
    threads(2)
    made = model()
    halves = Halves(made, nerf_of)
    with torch.no_grad():
        made.nerf.density.head.bias.fill_(1.0)
    seen = halves.differentiate(
        lambda model, _: (model.nerf.density.head.bias.sum(), float(model.nerf.density.head.bias.detach()))
    )
    assert seen == [1.0, 1.0]


def test_the_halves_of_an_odd_batch_are_the_whole_of_it(threads):
    threads(2)
    halves = Halves(model(), nerf_of)
    pixels = TrainingPixels(SCENE, tiny().pixels, torch.device("cpu"))
    batch = pixels.draw(7, torch.Generator().manual_seed(0))
    parts = [halves.part_of(batch, half).rays.directions for half in range(halves.count)]
    assert torch.equal(torch.cat(parts), batch.rays.directions)


def test_two_threads_give_the_same_bits_every_time_and_use_every_ray(threads):
    threads(2)
    values = []
    for _ in range(2):
        config, made = tiny(), model()
        pixels = TrainingPixels(SCENE, config.pixels, torch.device("cpu"))
        stage = StageOne(made, pixels, config.stage_one, seed=0)
        rays = []
        for copy in stage.halves._models:
            count_rays(copy, rays)
        stage.step(), stage.step()
        assert rays == 4 * [config.stage_one.num_rays // 2]
        values.append({name: value.clone() for name, value in made.state_dict().items()})
    assert all(torch.equal(values[0][name], values[1][name]) for name in values[0])
