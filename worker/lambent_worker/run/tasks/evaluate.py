"""Fourth task: a quick look at a few test views; `lambent evaluate` does the full evaluation."""

from dataclasses import replace

from flashcache.data.scene import Scene, View

from lambent_worker.report.evaluate import evaluate, preview_sheet
from lambent_worker.report.predictions import num_pictures
from lambent_worker.report.request import EvaluationRequest, Subject, evenly_spaced, rule_of
from lambent_worker.run.context import TaskContext
from lambent_worker.run.folder import task_seconds
from lambent_worker.run.tasks.ingest import read_manifest
from lambent_worker.run.tasks.training import load_trained, read_scene
from lambent_worker.run.uncertainty import keep_uncertainty, uncertainty_of_run


def run(context: TaskContext) -> None:
    """Write `evaluation/` with predictions, report.json and report.html for the preset's number of views."""
    settings = context.spec.config.evaluation
    scene = read_scene(context)
    request = EvaluationRequest(
        num_views=settings.num_views,
        num_repeats=settings.num_repeats,
        num_directions=settings.num_directions,
        antialias=settings.antialias,
        max_side=context.spec.config.max_side,
    )
    views, held_out = evaluated_views(scene, settings.num_views)
    model = load_trained(context, scene, "joint")
    uncertainty = uncertainty_of_run(context, model, scene)
    if uncertainty is not None:
        keep_uncertainty(context.run_dir, uncertainty)
    subject = Subject(
        model=model,
        scene=scene,
        views=views,
        held_out=held_out,
        maps={},
        request=request,
        seed=context.spec.seed,
        out=context.folder,
        advance=lambda: None,
        rule=rule_of(context.spec.config.stage_two),
        dataset=read_manifest(context).layout,
        uncertainty=uncertainty,
    )
    subject = with_progress(subject, context)
    report = evaluate(subject, preset=context.spec.config.preset, seconds=task_seconds(context.run_dir))
    context.reporter.preview("evaluation", preview_sheet(subject))
    for name in ("report.json", "report.html"):
        context.reporter.artifact(name, context.folder / name)
    context.reporter.log("evaluated", **{row.name: round(row.value, 4) for row in report.metrics})


def evaluated_views(scene: Scene, count: int) -> tuple[tuple[View, ...], bool]:
    """Return at most `count` test views (0: all), or training views where there are none, and which it is."""
    return evenly_spaced(scene.test or scene.train, count), bool(scene.test)


def with_progress(subject: Subject, context: TaskContext) -> Subject:
    """Return `subject` with its pictures counted into the progress of `context`."""
    total, done = num_pictures(subject), 0

    def advance() -> None:
        nonlocal done
        done += 1
        context.progress(done, total)
        context.stop_if_asked()

    return replace(subject, advance=advance)
