"""Removal of checkpoints."""

from sqlalchemy import Connection

from lambent_server.database.schema import checkpoint_files, checkpoints
from lambent_server.database.tenancy import Tenant, remove, rows
from lambent_server.garbage import discard


def drop_checkpoint(connection: Connection, tenant: Tenant, identifier: str) -> None:
    """Delete a checkpoint; its blobs are removed later."""
    mine = checkpoint_files.c.checkpoint_id == identifier
    files = rows(tenant, checkpoint_files, checkpoint_files.c.sha256).where(mine)
    for sha256 in list(connection.execute(files).scalars()):
        discard(connection, tenant, sha256)
    connection.execute(remove(tenant, checkpoint_files).where(mine))
    connection.execute(remove(tenant, checkpoints).where(checkpoints.c.id == identifier))


def drop_checkpoints(connection: Connection, tenant: Tenant, job_id: str) -> None:
    """Delete every checkpoint of a job that no longer needs any."""
    mine = rows(tenant, checkpoints, checkpoints.c.id).where(checkpoints.c.job_id == job_id)
    for identifier in list(connection.execute(mine).scalars()):
        drop_checkpoint(connection, tenant, identifier)
