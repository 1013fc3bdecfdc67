"""Database changes for the messages of a run; called inside the transaction that checked its run number."""

from collections.abc import Iterable, Sequence
from typing import Any

from google.protobuf.json_format import MessageToJson, Parse, ParseError
from lambent_proto import BUNDLE_VERSION
from lambent_proto.v1 import bundle_pb2, job_pb2, worker_pb2
from sqlalchemy import Connection, Table, insert

from lambent_server import provenance
from lambent_server.api import labels as label_rows
from lambent_server.api.problems import Problem, invalid
from lambent_server.api.rest_json import enum_text, to_rest
from lambent_server.core.clock import new_id, now
from lambent_server.core.settings import Settings
from lambent_server.database.columns import next_number
from lambent_server.database.model import JobRow, SceneRow
from lambent_server.database.schema import (
    artifacts,
    bundle_files,
    bundles,
    checkpoint_files,
    checkpoints,
    scenes,
)
from lambent_server.database.tenancy import add, change, find
from lambent_server.jobs.outcomes import Failure, fail, lose
from lambent_server.jobs.preparation import drop_superseded, offered_checkpoints, scene_of_checkpoint
from lambent_server.jobs.previews import SHEET, thin
from lambent_server.jobs.rows import NewEvent, append_event, append_events, owner, set_fields
from lambent_server.provenance import Signer
from lambent_server.running.run_inputs import inputs_of
from lambent_server.scenes.figures import store_figures
from lambent_server.scenes.rows import set_thumbnail
from lambent_server.storage.paths import check_path
from lambent_server.storage.store import BlobStore, touch_all

_WORKER_EVENTS = frozenset({"preview", "log", "finding", "artifact"})
_MESSAGE_CHARACTERS = 8000
_NAME_CHARACTERS = 300
_YOUNG_S = 600.0
_OLD_S = 3600.0


def describe_run(connection: Connection, job: JobRow, settings: Settings) -> worker_pb2.StartResponse:
    """Return the work of the run, and where an earlier run stopped."""
    tenant = owner(job)
    inputs = inputs_of(connection, job)
    response = worker_pb2.StartResponse(
        **{name: getattr(job, name) for name in ("kind", "scene_id", "preset", "params", "gpus", "seed")},
        files=inputs.files,
        check_scene=inputs.check_scene,
        device="cuda" if job.gpus else "cpu",
        adjustments=worker_pb2.Adjustments(
            stages={stage: worker_pb2.StageAdjustments(**own) for stage, own in job.adjustments.items()}
        ),
        progress_interval_s=settings.progress_interval_s,
        preview_interval_s=settings.preview_interval_s,
        scene_name=inputs.name,
        render=inputs.render,
    )
    for row in offered_checkpoints(connection, tenant, job):
        manifest = response.checkpoints.add()
        Parse(row.manifest, manifest)
    return response


def _progress_gap_s(job: JobRow, settings: Settings) -> float:
    """Return the minimum time between stored progress events: the longer a job runs, the fewer are kept."""
    age = now() - (job.started_at or now())
    factor = 1 if age < _YOUNG_S else 10 if age < _OLD_S else 60
    return factor * settings.progress_interval_s


def store_report(
    connection: Connection, job: JobRow, report: worker_pb2.ReportRequest, settings: Settings
) -> None:
    """Store progress and events, unless this report has been stored already."""
    if report.sequence <= job.report_seq:
        return
    values: dict[str, Any] = {"report_seq": report.sequence, "heartbeat_at": now()}
    if report.HasField("progress"):
        progress = to_rest(report.progress)
        values |= {"progress": progress, "progress_at": now()}
        stage_ended = progress["step"] == progress["num_steps"]
        due = not 0.0 <= now() - (job.progress_event_at or 0.0) < 0.9 * _progress_gap_s(job, settings)
        if due or stage_ended or progress["stage"] != (job.progress or {}).get("stage"):
            values["progress_event_at"] = now()
            append_event(connection, job, NewEvent(type="progress", progress=progress))
    previews = [event for event in report.events if event.type == "preview" and event.sha256]
    pictures = [event.sha256 for event in previews if event.name != SHEET]
    if pictures:
        values["preview_sha256"] = pictures[-1]
    set_fields(connection, job, **values)
    for event in report.events:
        if event.type not in _WORKER_EVENTS:
            raise Problem(422, "event_type", f"a run must not report {event.type!r} events")
    new = [
        NewEvent(
            type=event.type,
            message=_plain(event.message, _MESSAGE_CHARACTERS),
            sha256=event.sha256,
            name=_plain(event.name, _NAME_CHARACTERS),
        )
        for event in report.events
    ]
    if new:
        append_events(connection, job, new)
    if previews:
        thin(connection, job)


def _plain(text: str, limit: int) -> str:
    """Return the text without characters that PostgreSQL cannot store, cut where it is too long."""
    text = text.replace("\0", "")
    left_out = len(text) - limit
    return text if left_out <= 0 else f"{text[:limit]}… ({left_out} more characters)"


def store_scene_report(connection: Connection, job: JobRow, request: worker_pb2.ReportSceneRequest) -> None:
    """Store findings and measurements of the scene, and whether jobs may use it."""
    report = request.report
    scene = find(connection, owner(job), SceneRow, job.scene_id, lock=True)
    if scene is None or scene.state not in ("uploaded", "ready"):
        return
    fresh = to_rest(report)
    # Findings from the upload stay valid.
    codes = {(each["code"], each["subject"]) for each in fresh["findings"]}
    earlier = [
        each
        for each in (scene.report or {}).get("findings", [])
        if (each["code"], each["subject"]) not in codes
    ]
    fresh["findings"] = earlier + fresh["findings"]
    statement = change(owner(job), scenes).where(scenes.c.id == scene.id)
    state = "ready" if report.usable else "rejected"
    connection.execute(statement.values(report=fresh, layout=report.layout or None, state=state))
    figures = request.figures if request.HasField("figures") else None
    store_figures(connection, owner(job), scene.id, figures, request.page_sha256)
    set_thumbnail(connection, owner(job), scene, request.thumbnail_sha256)


def store_failure(
    connection: Connection, job: JobRow, request: worker_pb2.FailRequest, settings: Settings
) -> None:
    """End the run according to the cause of its failure; what it made nevertheless is published."""
    _publish_artifacts(connection, job, request.artifacts)
    cause = enum_text(worker_pb2.FailCause, request.cause)
    if cause == "killed":
        set_fields(connection, job, error=None)
        lose(connection, job, _plain(request.message, _MESSAGE_CHARACTERS), settings)
        return
    code = _plain(request.code, _NAME_CHARACTERS) or "run_failed"
    message = _plain(request.message, _MESSAGE_CHARACTERS) or "the run failed; see the log"
    fail(connection, job, Failure(cause, code, message), settings)


def _require_blobs(connection: Connection, job: JobRow, files: Iterable[Any]) -> dict[str, int]:
    """Return the sizes of files by hash; refuse one that was never sent."""
    named = {file.sha256: file.path for file in files}
    sizes = touch_all(connection, owner(job), named)
    for sha256, path in named.items():
        if sha256 not in sizes:
            raise Problem(422, "blob_missing", f"{path}: blob {sha256} was never uploaded")
    return sizes


def store_checkpoint(connection: Connection, job: JobRow, manifest: job_pb2.CheckpointManifest) -> None:
    """Store the checkpoint, and delete those that no later run would use."""
    tenant = owner(job)
    for file in manifest.files:
        check_path(file.path, "#/files")
    _require_blobs(connection, job, manifest.files)
    identifier = new_id("chk")
    text = MessageToJson(manifest, preserving_proto_field_name=True, indent=None)
    connection.execute(
        add(
            tenant,
            checkpoints,
            id=identifier,
            number=next_number(connection, checkpoints.c.number),
            job_id=job.id,
            run=job.run,
            stage=manifest.stage,
            step=manifest.step,
            created_at=now(),
            manifest=text,
            scene_id=scene_of_checkpoint(job, manifest.stage),
        )
    )
    of_checkpoint = {"tenant_id": tenant.id, "checkpoint_id": identifier}
    _insert(
        connection,
        checkpoint_files,
        [{**of_checkpoint, "path": file.path, "sha256": file.sha256} for file in manifest.files],
    )
    set_fields(connection, job, losses_without_checkpoint=0, progress_at=now())
    append_event(
        connection, job, NewEvent(type="checkpoint", name=manifest.stage, message=f"step {manifest.step}")
    )
    drop_superseded(connection, tenant, job, identifier, manifest.stage)


def publish(
    connection: Connection,
    job: JobRow,
    request: worker_pb2.PublishRequest,
    store: BlobStore,
    signer: Signer | None = None,
) -> str | None:
    """Insert the rows that make bundle and artifacts visible; return the bundle's id.

    With a `signer`, a signed statement of where the bundle is from is stored with it.
    """
    tenant = owner(job)
    _require_files(connection, job, request.bundle_files)
    _publish_artifacts(connection, job, request.artifacts)
    if not request.bundle_files:
        return None
    manifest = _check_manifest(request, store)
    bundle_id = new_id("bundle")
    names = {"job_id": job.id, "scene_id": job.scene_id, "labels": job.labels}
    connection.execute(add(tenant, bundles, id=bundle_id, created_at=now(), **names))
    label_rows.store(connection, tenant, bundle_id, job.labels)
    of_bundle = {"tenant_id": tenant.id, "bundle_id": bundle_id}
    _insert(connection, bundle_files, [{**of_bundle, **_file_values(file)} for file in request.bundle_files])
    if signer is not None:
        statement = provenance.statement_of(
            job,
            bundle_id=bundle_id,
            files={file.path: file.sha256 for file in request.bundle_files},
            inputs=[(file.path, file.sha256) for file in inputs_of(connection, job).files],
            generator=to_rest(manifest.generator),
            key_id=signer.key_id,
        )
        provenance.store(connection, tenant, bundle_id, signer.envelope(statement))
    return bundle_id


def _require_files(connection: Connection, job: JobRow, files: Iterable[worker_pb2.PublishedFile]) -> None:
    """Raise the problem of files that were never uploaded, or that have another size or no safe path."""
    given = list(files)
    for file in given:
        check_path(file.path, "#/files")
    sizes = _require_blobs(connection, job, given)
    for file in given:
        if sizes[file.sha256] != int(file.size_bytes):
            raise Problem(422, "size_mismatch", f"{file.path}: the blob has another size")


def _publish_artifacts(
    connection: Connection, job: JobRow, files: Sequence[worker_pb2.PublishedFile]
) -> None:
    """Insert the rows that make artifacts visible."""
    _require_files(connection, job, files)
    of_job = {"tenant_id": owner(job).id, "job_id": job.id}
    values = [{**of_job, **_file_values(file)} for file in files]
    _insert(connection, artifacts, [{**each, "name": each.pop("path")} for each in values])
    told = [NewEvent(type="artifact", name=file.path, sha256=file.sha256) for file in files]
    if told:
        append_events(connection, job, told)


def _insert(connection: Connection, table: Table, values: list[dict[str, Any]]) -> None:
    """Insert rows with one statement: the transaction keeps others from writing meanwhile."""
    if values:
        connection.execute(insert(table), values)


def _file_values(file: worker_pb2.PublishedFile) -> dict[str, Any]:
    return {
        "path": file.path,
        "sha256": file.sha256,
        "size_bytes": file.size_bytes,
        "media_type": file.media_type or "application/octet-stream",
    }


def _check_manifest(request: worker_pb2.PublishRequest, store: BlobStore) -> bundle_pb2.BundleManifest:
    """Return the manifest of a bundle; refuse one that does not match its files exactly."""
    given = {file.path: file for file in request.bundle_files}
    manifest_file = given.pop("manifest.json", None)
    if manifest_file is None:
        raise Problem(422, "bundle_manifest", "a bundle needs a manifest.json")
    try:
        text = store.read_all(manifest_file.sha256)
        manifest = Parse(text, bundle_pb2.BundleManifest(), ignore_unknown_fields=True)
    except (ParseError, UnicodeDecodeError) as error:
        raise Problem(422, "bundle_manifest", f"manifest.json is not a BundleManifest: {error}") from error
    if manifest.schema_version != BUNDLE_VERSION:
        detail = (
            f"the bundle has format version {manifest.schema_version[:32]!r}, this server takes version "
            f"{BUNDLE_VERSION!r} alone; install the same release of Lambent on server and workers"
        )
        raise invalid("bundle_version", "#/schema_version", detail)
    described = {file.path: file.sha256 for file in manifest.files}
    if described != {path: file.sha256 for path, file in given.items()}:
        different = sorted(set(described) ^ set(given)) or sorted(
            path for path, file in given.items() if described[path] != file.sha256
        )
        raise invalid("bundle_manifest", "#/files", f"manifest and files differ in {different[:5]}")
    return manifest
