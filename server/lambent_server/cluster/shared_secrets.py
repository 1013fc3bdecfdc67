"""Secrets that all servers on a database share: in a folder, in the database, or in the data folder.

One server has its secrets as files in its data folder (SQLite). Several have them in the database, where the
first one puts them. With `Settings.secrets`, they are files in a folder that an operator provides to all.
"""

from collections.abc import Callable
from pathlib import Path

from sqlalchemy import Connection, func, insert, select

from lambent_server.core.secrets import new_secret, read_or_create
from lambent_server.core.settings import Settings
from lambent_server.database.cluster_schema import shared_secrets
from lambent_server.database.columns import clock_time
from lambent_server.database.engine import Database

WORKER = "worker.secret"
"""Authenticates run processes."""
SHARE = "share.secret"
"""Signs links to bundles."""
SERVER = "server.id"
"""Holds the name of the server with this data folder, which is not secret."""
_LOCK = 0x1A4BE48


def shared_secret(
    database: Database, settings: Settings, name: str, make: Callable[[], str] = new_secret
) -> str:
    """Return a secret; the first server makes it. Raises ServeError for an empty file."""
    if database.is_sqlite or settings.secrets is not None:
        return read_or_create((settings.secrets or settings.data) / name, make)
    with database.write() as connection:
        lock(connection)
        mine = select(shared_secrets.c.value).where(shared_secrets.c.name == name)
        value = connection.execute(mine).scalar_one_or_none()
        if value is None:
            value = make()
            row = {"name": name, "value": value, "created_at": clock_time(connection)}
            connection.execute(insert(shared_secrets).values(**row))
    return value


def lock(connection: Connection) -> None:
    """Wait until no other server is creating what only one must create."""
    if connection.dialect.name == "postgresql":
        connection.execute(select(func.pg_advisory_xact_lock(_LOCK)))


def is_data_folder(folder: Path) -> bool:
    """Return whether a server has used a folder as its data folder."""
    return any((folder / name).exists() for name in (WORKER, SERVER))
