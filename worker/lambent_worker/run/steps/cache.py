"""Second step: stage one, the NeRF cache learns the photographs."""

from flashcache.training.stage_one import StageOne

from lambent_worker.run.context import StepContext
from lambent_worker.run.steps.training import drive, new_model, read_scene, training_pixels


def run(context: StepContext) -> None:
    """Train stage one into `cache/step_*`; resumes from the last checkpoint."""
    scene = read_scene(context)
    model = new_model(context, scene)
    pixels = training_pixels(context, scene)
    drive(context, StageOne(model, pixels, context.config.stage_one, seed=context.seed))
