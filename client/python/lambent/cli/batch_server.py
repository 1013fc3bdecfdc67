"""batch --server: the same pictures, made by the jobs of a server and fetched when they are done."""

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path, PurePosixPath

from lambent_core.pictures import safe_name
from lambent_relight.batch.journal import NAME as JOURNAL
from lambent_relight.batch.journal import Journal, Record, open_journal, record_from_json
from lambent_relight.batch.manifest import Manifest
from lambent_relight.batch.plan import Failure
from lambent_relight.batch.run import Result
from lambent_relight.batch.summary import TABLE, write_table

from lambent.batch_order import order_of
from lambent.cli.batch_report import report
from lambent.cli.jobs import follow_jobs
from lambent.cli.output import Output
from lambent.cli.rendering import relight_errors
from lambent.client import Client
from lambent.errors import LambentError
from lambent.manifest_file import Document
from lambent.models import Artifact, Batch, Event
from lambent.pictures import contact_sheets

_REPEATS = ("render.parts_failed", "render.all_failed")
"""Errors of the job that makes the contact sheet, which repeat those of the other jobs."""


def batch_on_server(
    manifest: Manifest, document: Document, folder: Path, output: Output, *, url: str, shards: int
) -> int:
    """Render a manifest on a server, fetch what it made into `folder`, and return the exit code.

    The same manifest is the same batch for a week: asked for again, its parts that failed or were cancelled
    are tried again and the rest is only fetched.
    """
    with Client(url) as client:
        with relight_errors():
            maps = {light.map for light in manifest.environments if light.map is not None}
            identifiers = {path: client.push_environment(path).id for path in sorted(maps)}
            order = order_of(manifest, identifiers) | {"shards": shards}
        key = hashlib.sha256(json.dumps(order, sort_keys=True).encode()).hexdigest()
        batch = client.submit_batch(order, idempotency_key=f"batch-{key}")
        if batch.state in ("failed", "cancelled"):
            batch = client.retry_batch(batch.id)
        output.note(f"{batch.id}: {batch.num_pictures} pictures in {len(batch.job_ids)} job(s)")
        code = follow_jobs(client, batch.job_ids, as_json=output.as_json, findings=False)
        if code == 130:
            return code
        batch = client.batch(batch.id)
        listed = client.batch_artifacts(batch.id)
        with relight_errors(), open_journal(folder) as journal:
            results = _fetch(client, batch, listed, manifest, folder, journal)
        results += _failures(client, batch)
        sheets = [client.download(sheet, folder / sheet.name) for sheet in contact_sheets(listed)]
    write_table(folder / TABLE, results)
    shown = report(results, folder, sheets, document, output)
    if not sheets:
        output.note("the job that makes the contact sheet has not succeeded; there is none")
    counts = shown["states"]
    text = (
        f"{folder}  ({counts['made']} fetched, {counts['kept']} kept, {counts['failed']} failed; {batch.id})"
    )
    output.result(text, {**shown, "batch_id": batch.id})
    return 1 if shown["failures"] or batch.state != "succeeded" else 0


def _fetch(
    client: Client,
    batch: Batch,
    listed: Iterable[Artifact],
    manifest: Manifest,
    folder: Path,
    journal: Journal,
) -> list[Result]:
    """Bring every picture that the jobs recorded here, under the names of the manifest's own pattern."""
    artifacts = {(each.job_id, each.name): each for each in listed}
    results = []
    for job_id in batch.job_ids:
        records = artifacts.get((job_id, JOURNAL))
        if records is None:
            continue
        for line in client.read_artifact(records).decode("utf-8").splitlines():
            record = record_from_json(json.loads(line))
            results.append(_bring(client, job_id, record, manifest, folder, journal, artifacts))
    return results


def _bring(
    client: Client,
    job_id: str,
    record: Record,
    manifest: Manifest,
    folder: Path,
    journal: Journal,
    artifacts: dict[tuple[str, str], Artifact],
) -> Result:
    path = manifest.output.path.format(
        asset=safe_name(record.asset),
        environment=safe_name(record.environment),
        quality=safe_name(record.quality),
        camera=safe_name(record.camera),
    )
    files, kept = {}, True
    for suffix, made in record.files.items():
        artifact = artifacts.get((job_id, made.path))
        if artifact is None or suffix not in ("png", "exr") or artifact.sha256 != made.sha256:
            raise LambentError(
                "batch.unexpected_answer",
                f"job {job_id} recorded {made.path}, which is not among its files",
                "check that client and server have the same version (`lambent doctor`)",
            )
        here = replace(made, path=f"{PurePosixPath(path)}.{suffix}")
        kept &= journal.is_whole(here)
        (folder / here.path).parent.mkdir(parents=True, exist_ok=True)
        client.download(artifact, folder / here.path)
        files[suffix] = here
    record = replace(record, path=path, files=files)
    journal.add(record)
    return Result(path=path, state="kept" if kept else "made", record=record)


def _failures(client: Client, batch: Batch) -> list[Result]:
    """Return what the jobs found that cannot be made, and jobs that ended badly."""
    results = []
    for job_id in batch.job_ids:
        job = client.job(job_id)
        findings = list(_findings(client, job_id))
        for event in findings:
            code, _, message = event.message.partition(": ")
            failure = Failure(path=event.name or job_id, code=code, message=message)
            results.append(Result(path=failure.path, state="failed", failure=failure))
        repeats = job.error is not None and job.error.code in _REPEATS
        if job.state != "succeeded" and not findings and not repeats:
            code, message = (job.error.code, job.error.message) if job.error else (f"job.{job.state}", "")
            failure = Failure(path=f"{job_id}/*", code=code, message=message)
            results.append(Result(path=failure.path, state="failed", failure=failure))
    return results


def _findings(client: Client, job_id: str) -> Iterator[Event]:
    """Yield what a job found that cannot be made; its history comes in pieces."""
    after = 0
    while page := client.events(job_id, after=after):
        yield from (event for event in page if event.type == "finding")
        after = page[-1].seq
