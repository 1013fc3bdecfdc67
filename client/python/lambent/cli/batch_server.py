"""batch --server: the same pictures, made by the jobs of a server and fetched when they are done."""

import hashlib
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path, PurePosixPath

from lambent_relight.batch.journal import NAME as JOURNAL
from lambent_relight.batch.journal import Journal, Record, open_journal, record_from_json
from lambent_relight.batch.manifest import Manifest
from lambent_relight.batch.plan import Failure
from lambent_relight.batch.reading import safe_name
from lambent_relight.batch.run import Result
from lambent_relight.batch.sheet_lights import light_pictures
from lambent_relight.batch.summary import TABLE, write_sheets, write_table

from lambent.batch_order import order_of
from lambent.cli.jobs import follow_jobs
from lambent.cli.output import Output
from lambent.cli.rendering import relight_errors
from lambent.client import Client
from lambent.errors import LambentError
from lambent.models import Artifact, Batch, Event

SHOWN_FAILURES = 50


def batch_on_server(manifest: Manifest, folder: Path, output: Output, *, url: str, shards: int) -> int:
    """Render a manifest on a server, fetch what it made into `folder`, and return the exit code.

    The same manifest is the same batch for a week: asked for again, its parts that failed or were cancelled
    are tried again and the rest is only fetched.
    """
    with Client(url) as client:
        with relight_errors():
            maps = {light.path for light in manifest.environments if light.path is not None}
            identifiers = {path: client.push_environment(path).id for path in sorted(maps)}
            order = order_of(manifest, identifiers) | {"shards": shards}
        key = hashlib.sha256(json.dumps(order, sort_keys=True).encode()).hexdigest()
        batch = client.submit_batch(order, idempotency_key=f"batch-{key}")
        if batch.state in ("failed", "cancelled"):
            batch = client.retry_batch(batch.id)
        output.note(f"{batch.id}: {batch.num_pictures} pictures in {len(batch.job_ids)} job(s)")
        code = follow_jobs(client, batch.job_ids, as_json=output.as_json)
        if code == 130:
            return code
        batch = client.batch(batch.id)
        with relight_errors(), open_journal(folder) as journal:
            results = _fetch(client, batch, manifest, folder, journal)
        results += _failures(client, batch)
    write_table(folder / TABLE, results)
    write_sheets(folder, results, title=manifest.name, lights=light_pictures(manifest))
    failures = [result.failure for result in results if result.failure is not None]
    for failure in failures[:SHOWN_FAILURES]:
        output.note(f"failed {failure.path}: {failure.code}: {failure.message}")
    counts = Counter(result.state for result in results)
    text = (
        f"{folder}  ({counts['made']} fetched, {counts['kept']} kept, {counts['failed']} failed; {batch.id})"
    )
    output.result(text, {"path": str(folder), "batch_id": batch.id, "states": dict(counts)})
    return 1 if failures or batch.state != "succeeded" else 0


def _fetch(client: Client, batch: Batch, manifest: Manifest, folder: Path, journal: Journal) -> list[Result]:
    """Bring every picture that the jobs recorded here, under the names of the manifest's own pattern."""
    artifacts = {(each.job_id, each.name): each for each in client.batch_artifacts(batch.id)}
    results = []
    for job_id in batch.job_ids:
        listed = artifacts.get((job_id, JOURNAL))
        if listed is None:
            continue
        for line in client.read_artifact(listed).decode("utf-8").splitlines():
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
    path = manifest.files.path.format(
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
        found = list(_findings(client, job_id))
        for event in found:
            code, _, message = event.message.partition(": ")
            failure = Failure(path=event.name or job_id, code=code, message=message)
            results.append(Result(path=failure.path, state="failed", failure=failure))
        if job.state != "succeeded" and not found:
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
