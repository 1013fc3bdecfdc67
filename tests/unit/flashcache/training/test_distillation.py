"""At the end of stage two the fast cache alone learns, from a NeRF cache that stays as it is."""

from dataclasses import replace

import pytest
import torch
from flashcache.config import Config, DistilConfig
from flashcache.data.ray_batches import TrainingPixels
from flashcache.errors import ConfigError
from flashcache.geometry.directions import dot
from flashcache.parallel.processes import Processes
from flashcache.physical.estimator import DirectionCounts
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.checkpoint import CheckpointState, load_checkpoint, save_checkpoint
from flashcache.training.distil import Distillation, taught_rays
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from support.lit_sphere import lit_domain, lit_sphere

CPU = torch.device("cpu")
SCENE = lit_sphere()
DOMAIN = lit_domain(SCENE)
JOINT = 3
ONLY_DIFFUSE = DirectionCounts(cosine=1, sampler=0, specular=0)


def configured(num_steps: int) -> Config:
    base = tiny()
    return replace(
        base,
        stage_one=replace(base.stage_one, num_steps=120, num_rays=256, warmup_steps=5),
        stage_two=replace(
            base.stage_two,
            num_steps=JOINT,
            num_rays=32,
            warmup_steps=1,
            distil=DistilConfig(num_steps=num_steps, num_points=64),
        ),
    )


@pytest.fixture(scope="module")
def solid() -> dict[str, torch.Tensor]:
    """Return the values of a model whose NeRF cache has a surface."""
    config = configured(0)
    torch.manual_seed(0)
    model = InverseModel(config.model, DOMAIN)
    stage = StageOne(model, TrainingPixels(SCENE, config.pixels, CPU), config.stage_one, seed=0)
    while not stage.finished:
        stage.step()
    return {name: value.clone() for name, value in model.state_dict().items()}


def stage_of(solid: dict[str, torch.Tensor], num_steps: int) -> StageTwo:
    config = configured(num_steps)
    torch.manual_seed(0)
    model = InverseModel(config.model, DOMAIN)
    model.load_state_dict(solid)
    return StageTwo(model, TrainingPixels(SCENE, config.pixels, CPU), config.stage_two, seed=0)


def values(stage: StageTwo) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in stage.model.state_dict().items()}


def test_nothing_but_the_fast_cache_moves(solid):
    stage = stage_of(solid, 4)
    for _ in range(JOINT):
        stage.step()
    before = values(stage)
    records = []
    while not stage.finished:
        records.append(stage.step())
    moved = {name for name, value in values(stage).items() if not torch.equal(value, before[name])}
    assert moved
    assert {name.partition(".")[0] for name in moved} == {"fast"}
    assert [(record.step, record.num_steps) for record in records] == [
        (JOINT + k, JOINT + 4) for k in (1, 2, 3, 4)
    ]
    assert stage.num_skipped == 0


def test_the_fast_cache_comes_nearer_to_the_nerf_cache(solid):
    stage = stage_of(solid, 60)
    batch = stage.pixels.draw(256, torch.Generator().manual_seed(5))
    with torch.no_grad():
        rays = taught_rays(stage.model, batch, stage.config.distil, torch.Generator().manual_seed(6))
        wanted = stage.model.ask_nerf(rays, torch.Generator().manual_seed(7)).opacity

    def error() -> float:
        with torch.no_grad():
            found = stage.model.fast(rays.origins, rays.directions, rays.light_index).opacity
        return float((found - wanted).abs().mean())

    stage.steps_done = JOINT
    before = error()
    while not stage.finished:
        stage.step()
    assert error() < 0.85 * before


def test_taught_rays_leave_the_surface_outwards(solid):
    stage = stage_of(solid, 1)
    batch = stage.pixels.draw(256, torch.Generator().manual_seed(5))
    with torch.no_grad():
        rays = taught_rays(stage.model, batch, stage.config.distil, torch.Generator().manual_seed(6))
    assert len(rays) > 256
    # The sphere is round: its normal is the direction from its middle, roughly, after so few steps.
    outwards = torch.nn.functional.normalize(rays.origins, dim=-1)
    assert float(dot(outwards, rays.directions).mean()) > 0.15
    assert float((rays.directions.norm(dim=-1) - 1.0).abs().max()) < 1e-5


def test_two_processes_teach_what_one_does(solid):
    """Their rays are drawn apart, so that the gradients agree in the mean only."""
    found = {}
    for count in (1, 2):
        with Processes(count) as processes:
            stage = stage_of(solid, 1)
            stage.optimiser.zero_grad(set_to_none=False)
            config = DistilConfig(num_points=4096)
            distillation = Distillation(stage.model, stage.pixels, config, seed=0, processes=processes)
            assert distillation.parts.count == count
            distillation.differentiate(0)
        head = stage.model.fast.distance_head.parameters()
        found[count] = torch.cat([one.grad.flatten() for one in head])
        others = [*stage.model.nerf.parameters(), *stage.model.materials.parameters()]
        assert not any(one.grad.any() for one in others if one.grad is not None)
    one, two = found[1], found[2]
    assert float(torch.nn.functional.cosine_similarity(one, two, dim=0)) > 0.98
    assert 0.9 < float(two.norm() / one.norm()) < 1.1


@pytest.mark.parametrize("stop", [JOINT - 1, JOINT, JOINT + 2])
def test_resuming_equals_not_stopping_bit_for_bit(solid, stop, tmp_path):
    whole = stage_of(solid, 4)
    while not whole.finished:
        whole.step()
    first = stage_of(solid, 4)
    for _ in range(stop):
        first.step()
    state = CheckpointState(stage="joint", step=stop, seed=0, config_sha256="x")
    save_checkpoint(tmp_path / "step", first.model, first.optimiser, state)
    second = stage_of(solid, 4)
    second.steps_done = load_checkpoint(tmp_path / "step", second.model, second.optimiser).step
    while not second.finished:
        second.step()
    expected, found = values(whole), values(second)
    assert all(torch.equal(expected[name], found[name]) for name in expected)


def test_a_cache_without_a_surface_teaches_nothing_and_breaks_nothing():
    config = configured(2)
    torch.manual_seed(0)
    model = InverseModel(config.model, DOMAIN)
    with torch.no_grad():
        model.nerf.density.head.bias.fill_(-50.0)
    distillation = Distillation(
        model, TrainingPixels(SCENE, config.pixels, CPU), config.stage_two.distil, seed=0
    )
    assert distillation.differentiate(0) == 0.0
    assert all(one.grad is None or not one.grad.any() for one in model.fast.parameters())


@pytest.mark.parametrize("change", [{"num_points": 0}, {"num_steps": -1}, {"taught": ONLY_DIFFUSE}])
def test_numbers_that_mean_nothing_are_refused(change):
    with pytest.raises(ConfigError, match=r"stage_two\.distil"):
        DistilConfig(**change)
