"""Steps by graphs are the steps without, with a stand-in that repeats operations on the same memory."""

from dataclasses import replace

import pytest
import torch
from flashcache.config import DistilConfig
from flashcache.data.ray_batches import TrainingPixels
from flashcache.encoding.occupancy import OccupancyConfig
from flashcache.kernels import dispatch
from flashcache.losses.shape import ShapePriorConfig
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.cache_losses import CacheLosses
from flashcache.training.checkpoint import CheckpointState, load_checkpoint, save_checkpoint
from flashcache.training.cuda_graphs import CHECKED, WARM_UP, Capture, CudaCapture, Graphs
from flashcache.training.optimiser import Steps, build_optimiser
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from support.joint_stage import DOMAIN, SCENE
from support.recorded_steps import Recorded, rates_as_tensors


@pytest.fixture
def plain_torch():
    """The compiled loops of a processor are not operations of torch: nothing could repeat them."""
    with dispatch.using("reference"):
        yield


def stage_of(kind: str, capture: Capture | None, device: str = "cpu") -> StageOne | StageTwo:
    config = tiny()
    torch.manual_seed(0)
    nerf = replace(config.model.nerf, least_weight=1e-3)
    settings = replace(config.model, nerf=nerf, occupancy=OccupancyConfig())
    model = InverseModel(settings, DOMAIN).to(device)
    with torch.no_grad():
        model.nerf.density.head.bias += 2.0
    pixels = TrainingPixels(SCENE, config.pixels, torch.device(device))
    if kind == "cache":
        prior = ShapePriorConfig(recession_weight=0.2, flatness_weight=0.03, emptiness_weight=0.1)
        one = replace(
            config.stage_one,
            num_steps=16,
            num_rays=16,
            warmup_steps=4,
            carving_share=0.4,
            specular_from=0.0,
            distortion_from=0.0,
            normal_every=1,
            normal_ramp=(0.0, 0.9),
            shape_prior=prior,
        )
        made: StageOne | StageTwo = StageOne(model, pixels, one, seed=0, fixed=True, capture=capture)
    else:
        distil = DistilConfig(num_steps=7, num_points=16)
        two = replace(
            config.stage_two,
            num_steps=8,
            num_rays=8,
            warmup_steps=0,
            gloss_from=0.0,
            normal_every=1,
            distil=distil,
        )
        made = StageTwo(model, pixels, two, seed=0, fixed=True, capture=capture)
    if device == "cpu":
        rates_as_tensors(made)
    if isinstance(capture, Recorded):
        capture.stage = made
    return made


def trained(stage: StageOne | StageTwo) -> tuple[list[float], dict[str, torch.Tensor]]:
    records = []
    while not stage.finished:
        records.append(stage.step())
    # Read at the end: a later step must not have written over an earlier one's numbers.
    losses = [record.read().loss for record in records]
    return losses, {name: value.clone() for name, value in stage.model.state_dict().items()}


@pytest.mark.slow
@pytest.mark.usefixtures("plain_torch")
@pytest.mark.parametrize("kind", ["cache", "joint"])
def test_training_by_graphs_is_training_without(kind):
    expected, weights = trained(stage_of(kind, None))
    capture = Recorded()
    stage = stage_of(kind, capture)
    found, moved = trained(stage)
    assert stage.graphs.problem is None
    # Two phases that are long enough; one of stage one has a single step.
    assert capture.num_captured == 2
    assert capture.num_replayed == len(expected) - 2 * WARM_UP - (kind == "cache")
    assert found == pytest.approx(expected, rel=1e-5)
    for name, value in weights.items():
        torch.testing.assert_close(moved[name], value, rtol=1e-4, atol=1e-6, msg=name)


@pytest.mark.slow
@pytest.mark.usefixtures("plain_torch")
def test_a_resumed_training_by_graphs_is_one_that_never_stopped(tmp_path):
    whole, expected = trained(stage_of("joint", Recorded()))
    first = stage_of("joint", Recorded())
    for _ in range(6):
        first.step()
    state = CheckpointState(stage="joint", step=6, seed=0, config_sha256="")
    save_checkpoint(tmp_path / "step", first.model, first.optimiser, state)
    second = stage_of("joint", Recorded())
    second.steps_done = load_checkpoint(tmp_path / "step", second.model, second.optimiser).step
    losses, found = trained(second)
    assert losses == pytest.approx(whole[6:], rel=1e-5)
    for name, value in expected.items():
        torch.testing.assert_close(found[name], value, rtol=1e-4, atol=1e-6, msg=name)


@pytest.mark.usefixtures("plain_torch")
def test_what_cannot_be_captured_is_said_and_training_goes_on_without():
    capture = Recorded()
    capture.fails = True
    stage = stage_of("joint", capture)
    losses, _ = trained(stage)
    assert stage.graphs.problem is not None
    assert "no capture today" in stage.graphs.problem
    assert capture.num_replayed == 0
    assert losses == pytest.approx(trained(stage_of("joint", None))[0], rel=1e-5)


@pytest.mark.usefixtures("plain_torch")
def test_a_graph_that_keeps_a_number_of_its_first_step_is_found_out(monkeypatch):
    monkeypatch.setattr(CacheLosses, "prepare", lambda self, step, device: None)
    capture = Recorded()
    stage = stage_of("cache", capture)
    trained(stage)
    assert stage.graphs.problem is not None
    assert "by its graph" in stage.graphs.problem
    # The first one has the numbers of its own step.
    assert capture.num_replayed == CHECKED


@pytest.mark.usefixtures("plain_torch")
def test_a_broken_step_is_skipped_and_counted_by_a_graph_too():
    capture = Recorded()
    stage = stage_of("joint", capture)
    for _ in range(WARM_UP + CHECKED):
        stage.step()
    with torch.no_grad():
        stage.model.environment.head.bias[0] = torch.nan
    before = stage.model.materials.head.weight.clone()
    stage.step()
    assert capture.num_replayed == CHECKED + 1
    assert torch.equal(stage.model.materials.head.weight, before)
    assert stage.steps.read() == 1


def test_without_a_capture_there_are_no_graphs():
    model = torch.nn.Linear(2, 1)
    optimiser = build_optimiser([{"params": list(model.parameters()), "lr": 0.1, "peak": 0.1}])
    graphs = Graphs(None)

    def differentiate():
        model.weight.grad.fill_(1.0)
        return {"loss": 2.0}

    before = model.weight.clone()
    for step in range(2 * WARM_UP):
        assert graphs.take("all", step, differentiate, Steps(optimiser)) == {"loss": 2.0}
    assert not torch.equal(model.weight, before)


@pytest.mark.gpu
@pytest.mark.parametrize("kind", ["cache", "joint"])
def test_graphs_train_on_a_gpu(kind):
    expected, _ = trained(stage_of(kind, None, "cuda"))
    stage = stage_of(kind, CudaCapture(torch.device("cuda")), "cuda")
    found, _ = trained(stage)
    assert stage.graphs.problem is None
    # Additions come in any order, and differences grow from step to step.
    assert found == pytest.approx(expected, rel=0.05)


@pytest.mark.gpu
@pytest.mark.parametrize("kind", ["cache", "joint"])
def test_the_host_never_waits_for_a_step_on_a_gpu(kind):
    stage = stage_of(kind, None, "cuda")
    for _ in range(2):
        stage.step()
    torch.cuda.set_sync_debug_mode("error")
    try:
        for _ in range(3):
            stage.step()
    finally:
        torch.cuda.set_sync_debug_mode("default")
