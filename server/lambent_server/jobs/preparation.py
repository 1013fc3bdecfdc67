"""Checkpoints that are kept, and those that a run is offered: cameras and masks stay with their scene."""

from sqlalchemy import Connection

from lambent_server.database.model import CheckpointRow, JobRow
from lambent_server.database.rows import many
from lambent_server.database.schema import checkpoints, jobs
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.jobs.checkpoints import drop_checkpoint, drop_where
from lambent_server.jobs.rows import is_unfinished

KEPT_CHECKPOINTS = 2
KEPT_WITH_SCENE = frozenset({"cameras", "masks"})
"""Stages whose checkpoints outlive the job: they depend on the scene, hardly on the job's settings."""
PREPARES = frozenset({"train", "prepare"})
"""Kinds of jobs that have these stages."""

BY_NUMBER = (checkpoints.c.number, checkpoints.c.id)
"""The order in which checkpoints were committed: clocks differ, and are set back."""


def scene_of_checkpoint(job: JobRow, stage: str) -> str | None:
    """Return the scene that a job's checkpoint of `stage` is kept with, or None if it is the job's own."""
    return job.scene_id if stage in KEPT_WITH_SCENE and job.kind in PREPARES else None


def offered_checkpoints(connection: Connection, tenant: Tenant, job: JobRow) -> list[CheckpointRow]:
    """Return the checkpoints that a run of the job may continue from, oldest first.

    Those of the job, and of each stage that is kept with the scene the newest one of an earlier job, unless
    this one has one of its own. The run finds out whether they fit its settings.
    """
    mine = checkpoints.c.job_id == job.id
    if job.kind in PREPARES:
        mine |= checkpoints.c.scene_id == job.scene_id
    own: list[CheckpointRow] = []
    kept: dict[str, CheckpointRow] = {}
    for row in many(connection, rows(tenant, checkpoints).where(mine).order_by(*BY_NUMBER), CheckpointRow):
        if row.job_id == job.id:
            own.append(row)
        else:
            kept[row.stage] = row
    stages = {row.stage for row in own}
    return [row for stage, row in kept.items() if stage not in stages] + own


def drop_superseded(connection: Connection, tenant: Tenant, job: JobRow, newest: str, stage: str) -> None:
    """Delete the checkpoints that no later run would use, now that the job has one more, `newest`."""
    own = rows(tenant, checkpoints).where(checkpoints.c.job_id == job.id, checkpoints.c.scene_id.is_(None))
    newest_of_stage: set[str] = set()
    kept = many(connection, own.order_by(*(column.desc() for column in BY_NUMBER)), CheckpointRow)
    for place, row in enumerate(kept):
        if place >= KEPT_CHECKPOINTS and row.stage in newest_of_stage:
            drop_checkpoint(connection, tenant, row.id)
        newest_of_stage.add(row.stage)
    scene_id = scene_of_checkpoint(job, stage)
    if scene_id is not None:
        # An unfinished job with other settings may still need its own.
        going_on = rows(tenant, jobs, jobs.c.id).where(jobs.c.id != job.id, is_unfinished())
        drop_where(
            connection,
            tenant,
            checkpoints.c.scene_id == scene_id,
            checkpoints.c.stage == stage,
            checkpoints.c.id != newest,
            checkpoints.c.job_id.not_in(going_on),
        )
