"""First step: make sure the capture can be used, and write down what it is."""

from flashcache.data.scene import Scene
from google.protobuf import json_format
from lambent_proto.v1 import scene_pb2

from lambent_worker.check import check_scene
from lambent_worker.errors import SceneRefusedError, WorkerError
from lambent_worker.pipeline import StepContext
from lambent_worker.run_folder import STEP_FOLDERS, write_json
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


def message_to_dict(message: scene_pb2.SceneManifest | scene_pb2.SceneReport) -> dict[str, object]:
    """Return a message as ProtoJSON values with proto field names, all fields written."""
    return json_format.MessageToDict(
        message, preserving_proto_field_name=True, always_print_fields_with_no_presence=True
    )


def read_manifest(context: StepContext) -> scene_pb2.SceneManifest:
    """Return the manifest that `run` wrote into the run folder."""
    path = context.run_dir / STEP_FOLDERS["ingest"] / "manifest.json"
    try:
        return json_format.Parse(path.read_text(encoding="utf-8"), scene_pb2.SceneManifest())
    except (OSError, json_format.ParseError) as error:
        raise WorkerError(
            "run.manifest_missing", f"{path.name} of the run cannot be read; run the step ingest first"
        ) from error


def ingested_scene(context: StepContext) -> Scene:
    """Return the capture in memory as `run` described it, reduced to the configuration's `max_side` pixels."""
    from lambent_worker.scenes.load import load_scene

    return load_scene(context.scene_dir, read_manifest(context), max_side=context.config.max_side)
