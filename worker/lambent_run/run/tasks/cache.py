"""Second task: stage one, the NeRF cache learns the photographs."""

from flashcache.data.hull import fit_occupancy
from flashcache.training.stage_one import StageOne

from lambent_run.run.capture import read_manifest
from lambent_run.run.card_pixels import check_grey_card
from lambent_run.run.context import TaskContext
from lambent_run.run.tasks.training import (
    capture_for,
    drive,
    new_model,
    previews_for,
    processes_for,
    read_scene,
    training_pixels,
)


def run(context: TaskContext) -> None:
    """Train stage one into `cache/step_*`; resumes from the last checkpoint.

    Raises `UsageError` for a grey card that cannot be used with this capture: later would be too late.
    """
    config, seed = context.config.stage_one, context.spec.seed
    with processes_for(context, config.num_rays) as processes:
        scene = read_scene(context)
        if context.spec.grey_card is not None:
            check_grey_card(context.spec.grey_card, scene, read_manifest(context))
        model = new_model(context, scene)
        fit_occupancy(model, scene)
        pixels = training_pixels(context, scene, model)
        drive(
            context,
            StageOne(
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
