"""What the two training steps of a job keep and find again."""

from dataclasses import replace

import torch
from flashcache.config import Config
from flashcache.data.ray_batches import TrainingPixels
from flashcache.data.space import SpaceConfig
from flashcache.presets import tiny
from flashcache.training.stage_two import StageTwo
from lambent_worker.run.context import StepContext
from lambent_worker.run.steps.training import domain_for, new_model
from support.lit_sphere import lit_sphere
from support.recording_reporter import RecordingReporter

SCENE = lit_sphere(num_views=3)


def context_of(tmp_path, config: Config, stop_after: int | None = None) -> StepContext:
    made = StepContext(
        run_dir=tmp_path / "run",
        scene_dir=tmp_path / "scene",
        config=config,
        seed=0,
        device="cpu",
        reporter=RecordingReporter(stop_after),
        stage="joint",
    )
    made.folder.mkdir(parents=True, exist_ok=True)
    return made


def joint(context: StepContext) -> StageTwo:
    pixels = TrainingPixels(SCENE, context.config.pixels, torch.device("cpu"))
    return StageTwo(new_model(context, SCENE), pixels, context.config.stage_two, seed=0)


def test_the_space_of_a_preset_is_that_of_its_models(tmp_path):
    config = replace(tiny(), space=SpaceConfig(contraction_radius=3.0, secondary=(0.1, 1.0)))
    domain = domain_for(context_of(tmp_path, config), SCENE)
    assert (domain.contraction_radius, domain.secondary) == (3.0, (0.1, 1.0))
    assert domain.primary == SCENE.primary
