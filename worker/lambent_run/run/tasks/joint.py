"""Third task: stage two, materials, light and the fast cache learn jointly with the NeRF cache."""

from flashcache.training.stage_two import StageTwo

from lambent_run.run.context import TaskContext
from lambent_run.run.tasks.training import (
    capture_for,
    drive,
    load_trained,
    previews_for,
    processes_for,
    read_scene,
    training_pixels,
)


def run(context: TaskContext) -> None:
    """Train stage two into `joint/step_*` from the end of stage one; resumes from its last checkpoint."""
    config, seed = context.config.stage_two, context.spec.seed
    with processes_for(context, max(config.num_rays, config.distil.num_points)) as processes:
        scene = read_scene(context)
        # Materials, fast cache and sampler were not touched by stage one: they start fresh.
        model = load_trained(context, scene, "cache")
        pixels = training_pixels(context, scene, model)
        drive(
            context,
            StageTwo(
                model,
                pixels,
                config,
                seed=seed,
                processes=processes,
                capture=capture_for(context),
                ranks=context.ranks,
            ),
            previews_for(context, scene),
        )
