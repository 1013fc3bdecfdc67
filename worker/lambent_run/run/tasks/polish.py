"""Fourth task, where it is on: materials and light are fitted to all photographs once more."""

from dataclasses import replace

from flashcache.polish.confidence import FILE as CONFIDENCE
from flashcache.polish.polish import NUM_PARTS, polish
from flashcache.training.checkpoint import CheckpointState, checkpoint_folder, save_checkpoint
from lambent_core.files import digest

from lambent_run.run.capture import read_manifest
from lambent_run.run.card_pixels import card_of, check_grey_card
from lambent_run.run.context import TaskContext
from lambent_run.run.tasks.training import load_trained, previews_for, read_scene, training_pixels

STEP = 1
"""Number of the only checkpoint: the polish begins again after a stop, for it takes about a minute."""


def run(context: TaskContext) -> None:
    """Write the polished model to `polish/step_*`; that of stage two, with the reason, where it is kept.

    The confidence of the fit is written next to it, for the uncertainty of materials in reports and bundles.
    A finding says where stage two is kept. With a grey card, albedo and light are brought to what it
    reflects; where that cannot be done a finding says so, too. On the processor whatever the run's device is:
    the compiled fit is there, and a GPU would wait. Meanwhile previews show the model that is polished, from
    ever new sides.
    """
    on_cpu = replace(context, device="cpu")
    scene = read_scene(on_cpu)
    model = load_trained(on_cpu, scene, "joint").eval().requires_grad_(False)
    pixels = training_pixels(on_cpu, scene, model)

    preview = previews_for(on_cpu, scene)

    def pulse() -> None:
        context.stop_if_asked()
        preview.attempt(model, STEP)

    def advance(done: int) -> None:
        context.progress(done, NUM_PARTS)
        pulse()

    asked, card = context.spec.grey_card, None
    if asked is not None:
        manifest = read_manifest(on_cpu)
        check_grey_card(asked, scene, manifest)
        card = card_of(asked, scene, manifest, model)
    report = polish(model, pixels, seed=context.spec.seed, card=card, advance=advance, pulse=pulse)
    preview.tell()
    for code, message in report.findings:
        context.reporter.finding(code, message)
    if report.kept and card is not None:
        context.reporter.finding(
            "grey_card.not_used",
            f"the grey card was not used, and colours are known up to a factor as without it: {report.kept}",
        )
    elif report.kept and not report.findings:
        context.reporter.finding(
            "materials.not_fitted",
            f"materials are those of stage two, without the fit to all photographs: {report.kept}",
        )
    if report.kept:
        context.reporter.log("polish.kept", reason=report.kept, **report.values)
    else:
        context.reporter.log(
            "polish.done", **{name: round(value, 5) for name, value in report.values.items()}
        )
    path = context.folder / CONFIDENCE
    path.unlink(missing_ok=True)
    if report.confidence is not None:
        report.confidence.save(path)
    state = CheckpointState(
        stage=context.task,
        step=STEP,
        seed=context.spec.seed,
        config_sha256=digest(repr(context.config.model)),
    )
    save_checkpoint(checkpoint_folder(context.folder, STEP), model, None, state)
