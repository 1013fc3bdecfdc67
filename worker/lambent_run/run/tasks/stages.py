"""Second and third task: the two stages of training, `cache` and `joint`."""

from flashcache.data.hull import fit_occupancy
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo

from lambent_run.run.capture import read_manifest
from lambent_run.run.card_pixels import check_grey_card
from lambent_run.run.context import TaskContext
from lambent_run.run.tasks.training import (
    capture_for,
    drive,
    load_trained,
    new_model,
    previews_for,
    processes_for,
    read_scene,
    training_pixels,
)


def cache(context: TaskContext) -> None:
    """Train stage one into `cache/step_*`: the NeRF cache learns the photographs. Resumes from a checkpoint.

    Raises `UsageError` for a grey card that cannot be used with this capture: later would be too late.
    """
    config, seed, ranks = context.config.stage_one, context.spec.seed, context.ranks
    with processes_for(context, config.num_rays) as processes:
        scene = read_scene(context)
        if context.spec.grey_card is not None:
            check_grey_card(context.spec.grey_card, scene, read_manifest(context))
        model = new_model(context, scene)
        fit_occupancy(model, scene)
        pixels, capture = training_pixels(context, scene, model), capture_for(context)
        stage = StageOne(model, pixels, config, seed=seed, processes=processes, capture=capture, ranks=ranks)
        drive(context, stage, previews_for(context, scene))


def joint(context: TaskContext) -> None:
    """Train stage two into `joint/step_*` from the end of stage one; resumes from its last checkpoint.

    Materials, light and the fast cache learn jointly with the NeRF cache.
    """
    config, seed, ranks = context.config.stage_two, context.spec.seed, context.ranks
    with processes_for(context, max(config.num_rays, config.distil.num_points)) as processes:
        scene = read_scene(context)
        # Materials, fast cache and sampler were not touched by stage one: they start fresh.
        model = load_trained(context, scene, "cache")
        pixels, capture = training_pixels(context, scene, model), capture_for(context)
        stage = StageTwo(model, pixels, config, seed=seed, processes=processes, capture=capture, ranks=ranks)
        drive(context, stage, previews_for(context, scene))
