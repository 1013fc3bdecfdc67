"""Idempotency keys: a repeated request returns the result of the first one."""

from sqlalchemy import Connection

from lambent_server.api.problems import invalid
from lambent_server.core.clock import now
from lambent_server.database.schema import idempotency_keys
from lambent_server.database.tenancy import Tenant, add_if_absent, change, remove, rows


def made_before(
    connection: Connection, tenant: Tenant, key: str | None, digest: str, identifier: str
) -> str | None:
    """Return the id stored under this key; None if the request is new, which stores `identifier` as its id.

    `digest` is that of the request's body: another body under the same key is an error.
    """
    if key is None:
        return None
    values = {"key": key, "body_sha256": digest, "job_id": identifier, "created_at": now()}
    if add_if_absent(connection, tenant, idempotency_keys, **values):
        return None
    statement = rows(tenant, idempotency_keys).where(idempotency_keys.c.key == key)
    row = connection.execute(statement).one()
    if row.body_sha256 != digest:
        message = "this key was used with another body; use a new key for a new request"
        raise invalid("idempotency_key_reused", "#/header/Idempotency-Key", message)
    return str(row.job_id)


def point_to(connection: Connection, tenant: Tenant, key: str | None, identifier: str) -> None:
    """Replace the id stored under a new key, where it was not known before."""
    if key is not None:
        statement = change(tenant, idempotency_keys).where(idempotency_keys.c.key == key)
        connection.execute(statement.values(job_id=identifier))


def forget(connection: Connection, tenant: Tenant, identifier: str) -> None:
    """Forget the keys of something deleted: the same request makes a new one."""
    connection.execute(remove(tenant, idempotency_keys).where(idempotency_keys.c.job_id == identifier))
