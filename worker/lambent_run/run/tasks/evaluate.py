"""Fourth task: a quick look at a few test views; `lambent evaluate` does the full evaluation."""

from typing import Any

from jaxtyping import Float32
from lambent_core.errors import UsageError
from lambent_core.scene import Scene, evenly_spaced
from lambent_proto.v1 import evaluation_pb2
from numpy import ndarray

from lambent_run.report.common_factor import CODE, common_factor_note
from lambent_run.report.evaluate import evaluate, preview_sheet
from lambent_run.report.predictions import num_pictures
from lambent_run.report.request import EvaluationRequest, Subject, rule_of
from lambent_run.run.capture import read_manifest
from lambent_run.run.context import TaskContext
from lambent_run.run.folder import task_seconds
from lambent_run.run.tasks.training import load_final, read_scene
from lambent_run.run.true_lights import FOLDER, read_true_lights
from lambent_run.run.uncertainty import keep_uncertainty, uncertainty_of_run

SHEET = "evaluation"
"""Name of the preview with all pictures; server and pages know it (`lambent_server.jobs.previews.SHEET`)."""


def run(context: TaskContext) -> None:
    """Write `evaluation/` with predictions, report.json and report.html for the preset's number of views."""
    settings = context.config.evaluation
    scene = read_scene(context)
    request = EvaluationRequest(
        num_views=settings.num_views,
        num_repeats=settings.num_repeats,
        num_directions=settings.num_directions,
        antialias=settings.antialias,
        max_side=context.config.max_side,
    )
    model = load_final(context, scene)
    uncertainty = uncertainty_of_run(context, model, scene)
    if uncertainty is not None:
        keep_uncertainty(context.run_dir, uncertainty)
    subject = subject_of(
        context,
        request,
        model=model,
        scene=scene,
        maps={},
        out=context.folder,
        dataset=read_manifest(context).layout,
        uncertainty=uncertainty,
        true_lights=_true_lights(context, scene),
    )
    evaluated(context, subject)
    open_factor = common_factor_note(subject)
    if open_factor is not None and not any("albedo" in view.truth for view in scene.test):
        context.reporter.finding(CODE, open_factor)
    context.reporter.preview(SHEET, preview_sheet(subject))
    for name in ("report.json", "report.html"):
        context.reporter.artifact(name, context.folder / name)


def _true_lights(context: TaskContext, scene: Scene) -> dict[str, Float32[ndarray, "rows columns 3"]]:
    """Return the true environments beside the capture; one that cannot be read is a finding."""
    try:
        return read_true_lights(scene.lights, [context.spec.scene / FOLDER])
    except UsageError as error:
        context.reporter.finding(error.code, error.message)
        return {}


def subject_of(context: TaskContext, request: EvaluationRequest, *, scene: Scene, **given: Any) -> Subject:
    """Return the evaluation of a run's model on test views, or on training views where there are none.

    Its pictures are counted into the progress of `context`. `given` are the other members of `Subject`.
    """
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        context.progress(done, num_pictures(subject))
        context.stop_if_asked()

    subject = Subject(
        scene=scene,
        views=evenly_spaced(scene.test or scene.train, request.num_views),
        held_out=bool(scene.test),
        request=request,
        seed=context.spec.seed,
        advance=advance,
        rule=rule_of(context.config.stage_two, request.shadows),
        grey_card=context.spec.grey_card is not None,
        **given,
    )
    return subject


def evaluated(context: TaskContext, subject: Subject) -> evaluation_pb2.EvaluationReport:
    """Evaluate `subject`, log the metrics and return the report."""
    report = evaluate(subject, preset=context.config.preset, seconds=task_seconds(context.run_dir))
    context.reporter.log("evaluated", **{row.name: round(row.value, 4) for row in report.metrics})
    return report
