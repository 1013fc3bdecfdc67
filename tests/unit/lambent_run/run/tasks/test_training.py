"""The two training tasks of a run resume from what they kept."""

import json
from dataclasses import replace

import pytest
import torch
from flashcache.config import Config, DistilConfig
from flashcache.data.hull import hull_of
from flashcache.data.ray_batches import TrainingPixels
from flashcache.data.space import SpaceConfig
from flashcache.encoding.occupancy import OccupancyConfig
from flashcache.presets import tiny
from flashcache.training.stage_two import StageTwo
from lambent_core.errors import Stopped
from lambent_run.run.context import TaskContext
from lambent_run.run.tasks import stages
from lambent_run.run.tasks.training import domain_for, drive, load_trained, new_model, training_pixels
from support.lit_sphere import lit_sphere
from support.task_context import task_context

SCENE = lit_sphere(num_views=3)


def context_of(tmp_path, config: Config, stop_after: int | None = None) -> TaskContext:
    return task_context(tmp_path, config, "joint", stop_after)


def joint(context: TaskContext, fixed: bool | None = None) -> StageTwo:
    pixels = TrainingPixels(SCENE, context.spec.config.pixels, torch.device("cpu"))
    return StageTwo(new_model(context, SCENE), pixels, context.spec.config.stage_two, seed=0, fixed=fixed)


def short(**changes) -> Config:
    """Return a configuration whose stage two has five steps."""
    two = replace(
        tiny().stage_two, num_steps=5, num_rays=32, warmup_steps=0, distil=DistilConfig(), **changes
    )
    return replace(tiny(), stage_two=two, checkpoint_steps=3)


def test_a_checkpoint_counts_if_it_was_made_with_the_settings_of_now_and_others_leave_no_trace(tmp_path):
    first, second = short(smoothness_weight=0.5), short(smoothness_weight=0.0)
    drive(context_of(tmp_path, first), joint(context_of(tmp_path, first)))
    stopped = context_of(tmp_path, second, stop_after=0)
    with pytest.raises(Stopped):
        drive(stopped, joint(stopped))
    names = [fields["folder"] for fields in stopped.reporter.named("checkpoint.other_settings")]
    assert names == ["step_0000005", "step_0000003"]
    assert [path.name for path in stopped.folder.glob("step_*")] == ["step_0000001"]
    again = context_of(tmp_path, second)
    drive(again, joint(again))
    assert [fields["step"] for fields in again.reporter.named("checkpoint.resumed")] == [1]


def test_a_checkpoint_counts_the_skipped_steps_that_a_gpu_has_not_told_yet(tmp_path):
    context = context_of(tmp_path, short(), stop_after=0)
    stage = joint(context, fixed=True)
    with torch.no_grad():
        stage.model.environment.head.bias[0] = torch.nan
    with pytest.raises(Stopped):
        drive(context, stage)
    (folder,) = context.folder.glob("step_*")
    assert json.loads((folder / "state.json").read_text())["num_skipped"] == 1
    assert stage.num_skipped == 1


def test_the_log_says_when_graphs_are_given_up(tmp_path):
    context = context_of(tmp_path, short())
    stage = joint(context, fixed=True)
    stage.graphs.problem = "no capture"
    drive(context, stage)
    (fields,) = context.reporter.named("graphs.given_up")
    assert fields == {"step": 1, "reason": "no capture"}


def test_the_space_of_a_preset_is_that_of_its_models(tmp_path):
    config = replace(tiny(), space=SpaceConfig(contraction_radius=3.0, secondary=(0.1, 1.0)))
    domain = domain_for(context_of(tmp_path, config), SCENE)
    assert (domain.contraction_radius, domain.secondary) == (3.0, (0.1, 1.0))
    assert domain.primary == SCENE.primary


def test_stage_one_trains_in_the_hull_and_stage_two_goes_on_in_what_is_left_of_it(tmp_path, monkeypatch):
    base = short()
    config = replace(
        base,
        model=replace(base.model, occupancy=OccupancyConfig(cells=16)),
        stage_one=replace(base.stage_one, num_steps=2, num_rays=32, warmup_steps=0),
    )
    context = context_of(tmp_path, config)
    cache_context = replace(context, task="cache")
    cache_context.folder.mkdir()
    monkeypatch.setattr(stages, "read_scene", lambda context: SCENE)
    stages.cache(cache_context)
    model = load_trained(context, SCENE, "cache")
    hull = hull_of(SCENE, config.model.occupancy)
    assert hull is not None
    assert model.nerf.occupancy is not None
    assert 0.0 < model.nerf.occupancy.cells.float().mean() <= hull.mean() < 1.0
    pixels = training_pixels(context, SCENE, model)
    assert pixels.meeting is not None
    assert len(pixels.meeting) < pixels.num_positions
