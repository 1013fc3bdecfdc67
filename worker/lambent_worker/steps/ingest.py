"""First step: make sure the capture can be used, and write down what it is."""

from lambent_proto.v1 import scene_pb2

from lambent_worker.check import check_scene
from lambent_worker.errors import SceneRefusedError
from lambent_worker.messages import message_to_dict, read_message
from lambent_worker.pipeline import StepContext
from lambent_worker.run_folder import step_folder, write_json
from lambent_worker.scenes.detect import describe_scene
from lambent_worker.scenes.lights import select_lights


def run(context: StepContext) -> None:
    """Write `scene/manifest.json` with the chosen lights, and `scene/report.json` with all findings.

    Raises `SceneRefusedError` after reporting every finding when the capture cannot be used.
    """
    layout = context.layout or None
    report = check_scene(context.scene_dir, layout)
    for finding in report.findings:
        context.reporter.finding(
            finding.code,
            finding.message,
            subject=finding.subject,
            error=finding.severity == scene_pb2.SEVERITY_ERROR,
        )
    write_json(context.folder / "report.json", message_to_dict(report))
    if not report.usable:
        raise SceneRefusedError(report)
    manifest = select_lights(describe_scene(context.scene_dir, layout), context.lights)
    write_json(context.folder / "manifest.json", message_to_dict(manifest))
    context.progress(1, 1)


def read_manifest(context: StepContext) -> scene_pb2.SceneManifest:
    """Return the manifest that `run` wrote into the run folder."""
    path = step_folder(context.run_dir, "ingest") / "manifest.json"
    return read_message(path, scene_pb2.SceneManifest())
