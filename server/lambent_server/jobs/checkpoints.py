"""Removal of checkpoints: those of a job go when it ends, those kept with a scene when that is deleted."""

from sqlalchemy import ColumnElement, Connection

from lambent_server.database.schema import checkpoint_files, checkpoints
from lambent_server.database.tenancy import Tenant, remove, rows
from lambent_server.storage.store import discard


def drop_checkpoint(connection: Connection, tenant: Tenant, identifier: str) -> None:
    """Delete a checkpoint; its blobs are removed later."""
    mine = checkpoint_files.c.checkpoint_id == identifier
    files = rows(tenant, checkpoint_files, checkpoint_files.c.sha256).where(mine)
    for sha256 in list(connection.execute(files).scalars()):
        discard(connection, tenant, sha256)
    connection.execute(remove(tenant, checkpoint_files).where(mine))
    connection.execute(remove(tenant, checkpoints).where(checkpoints.c.id == identifier))


def drop_checkpoints(connection: Connection, tenant: Tenant, job_id: str) -> None:
    """Delete the checkpoints of a job that no longer needs any; those kept with its scene stay."""
    drop_where(connection, tenant, checkpoints.c.job_id == job_id, checkpoints.c.scene_id.is_(None))


def drop_checkpoints_of_scene(connection: Connection, tenant: Tenant, scene_id: str) -> None:
    """Delete the checkpoints that are kept with a scene."""
    drop_where(connection, tenant, checkpoints.c.scene_id == scene_id)


def drop_where(connection: Connection, tenant: Tenant, *conditions: ColumnElement[bool]) -> None:
    ids = connection.execute(rows(tenant, checkpoints, checkpoints.c.id).where(*conditions))
    for identifier in list(ids.scalars()):
        drop_checkpoint(connection, tenant, identifier)
