"""The list of blobs that may have lost their last reference; `housekeeping` removes them."""

from sqlalchemy import Connection

from lambent_server.core.clock import now
from lambent_server.database.schema import garbage
from lambent_server.database.tenancy import Tenant, add_if_absent


def discard(connection: Connection, tenant: Tenant, sha256: str) -> None:
    """Record that a reference to a blob is gone; the blob is removed later if it was the last one."""
    add_if_absent(connection, tenant, garbage, sha256=sha256, at=now())
