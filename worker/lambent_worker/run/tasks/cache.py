"""Second task: stage one, the NeRF cache learns the photographs."""

from flashcache.data.hull import fit_occupancy
from flashcache.training.stage_one import StageOne

from lambent_worker.run.context import TaskContext
from lambent_worker.run.tasks.training import drive, new_model, read_scene, training_pixels


def run(context: TaskContext) -> None:
    """Train stage one into `cache/step_*`; resumes from the last checkpoint."""
    scene = read_scene(context)
    model = new_model(context, scene)
    fit_occupancy(model, scene)
    pixels = training_pixels(context, scene, model)
    drive(context, StageOne(model, pixels, context.spec.config.stage_one, seed=context.spec.seed))
