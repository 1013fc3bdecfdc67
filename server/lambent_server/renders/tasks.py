"""The input of the runs of a picture order: their files and their task."""

import json
from collections.abc import Iterator, Sequence

from lambent_proto.v1 import render_pb2, worker_pb2
from sqlalchemy import Connection

from lambent_server.database.model import ArtifactRow, JobRow
from lambent_server.database.rows import many
from lambent_server.database.schema import artifacts, events
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.jobs.rows import SUCCEEDED, owner
from lambent_server.renders.rows import is_summary, newest_jobs, require_order
from lambent_server.storage.input_files import bundle_inputs, environment_input, input_file

PART_FILES = ("pictures.jsonl", "tiles.zip")
"""Artifacts of every part from which the summary job creates the table and the contact sheet."""


def describe_task(
    connection: Connection, job: JobRow
) -> tuple[list[worker_pb2.SceneFile], render_pb2.RenderTask]:
    """Return the input files of a run, and its task.

    Files are `bundles/<id>/...` and `environments/<id>.<format>`; the summary job gets `parts/<part>/...`
    instead of bundles.
    """
    tenant = owner(job)
    order_id, shard = job.part
    row = require_order(connection, tenant, order_id, job.kind)
    spec = row.spec
    task = render_pb2.RenderTask(spec=json.dumps(spec), shard=shard, num_shards=row.num_shards)
    files: list[worker_pb2.SceneFile] = []
    if is_summary(job, row.num_shards):
        parts = newest_jobs(connection, tenant, row.id)[: row.num_shards]
        files += _part_files(connection, tenant, parts)
        task.failures.extend(_failures(connection, tenant, parts))
    else:
        for bundle_id in sorted({asset["bundle_id"] for asset in spec["assets"]}):
            files += bundle_inputs(connection, tenant, bundle_id, f"bundles/{bundle_id}")
    for identifier in sorted({light["environment_id"] for light in spec["environments"]}):
        files += environment_input(connection, tenant, identifier, f"environments/{identifier}")
    return files, task


def _part_files(
    connection: Connection, tenant: Tenant, parts: Sequence[JobRow]
) -> Iterator[worker_pb2.SceneFile]:
    for part in parts:
        statement = rows(tenant, artifacts).where(
            artifacts.c.job_id == part.id, artifacts.c.name.in_(PART_FILES)
        )
        for row in many(connection, statement.order_by(artifacts.c.name), ArtifactRow):
            yield input_file(f"parts/{part.part[1]:03d}/{row.name}", row)


def _failures(
    connection: Connection, tenant: Tenant, parts: Sequence[JobRow]
) -> Iterator[render_pb2.RenderFailure]:
    """Yield the pictures that the parts could not render, and the parts that failed without a finding."""
    for part in parts:
        statement = rows(tenant, events, events.c.name, events.c.message).where(
            events.c.job_id == part.id, events.c.type == "finding"
        )
        # A run that was lost after reporting its findings has reported them twice.
        findings = dict.fromkeys(map(tuple, connection.execute(statement.order_by(events.c.seq))))
        for name, text in findings:
            code, _, message = text.partition(": ")
            yield render_pb2.RenderFailure(path=name or part.id, code=code, message=message)
        if part.state != SUCCEEDED and not findings:
            error = part.error or {"code": f"job.{part.state}", "message": ""}
            path = f"{part.id}/*"
            yield render_pb2.RenderFailure(path=path, code=error["code"], message=error["message"])
