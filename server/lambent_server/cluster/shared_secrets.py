"""Secrets that all servers on a database share: in a folder, in the database, or in the data folder.

One server has its secrets as files in its data folder (SQLite). Several have them in the database, where the
first one puts them; files that a data folder has from before are accepted by all from then on. With
`Settings.secrets`, they are files in a folder that somebody provides to all.
"""

from collections.abc import Callable
from pathlib import Path

from sqlalchemy import Connection, func, insert, select

from lambent_server.core.secrets import SharedSecret, new_secret, read_or_create_secret
from lambent_server.core.settings import Settings
from lambent_server.database.cluster_schema import shared_secrets
from lambent_server.database.columns import clock_time
from lambent_server.database.engine import Database

WORKER = "worker.secret"
"""Authenticates run processes."""
SHARE = "share.secret"
"""Signs links to bundles."""
SERVER = "server.id"
"""Holds the name of the server with this data folder, which is no secret."""
_LOCK = 0x1A4BE48


def shared_secret(database: Database, settings: Settings, name: str) -> SharedSecret:
    """Return a secret, creating it if this is the first server; raises SecretError for an empty file."""
    if database.is_sqlite or settings.secrets is not None:
        return SharedSecret(read_or_create_secret((settings.secrets or settings.data) / name))
    own = settings.data / name
    return shared_value(database, name, read_or_create_secret(own) if own.exists() else None)


def shared_value(
    database: Database, name: str, own: str | None = None, make: Callable[[], str] = new_secret
) -> SharedSecret:
    """Return the values of a name in the database, the oldest of which counts.

    `own` becomes one of them; if there is none, `make` returns the first.
    """
    with database.write() as connection:
        lock(connection)
        known = _values(connection, name)
        value = own or (None if known else make())
        if value is not None and value not in known:
            connection.execute(
                insert(shared_secrets).values(name=name, value=value, created_at=clock_time(connection))
            )
            known = _values(connection, name)
    return SharedSecret(known[0], known[1:])


def lock(connection: Connection) -> None:
    """Wait until no other server is creating what only one must create."""
    if connection.dialect.name == "postgresql":
        connection.execute(select(func.pg_advisory_xact_lock(_LOCK)))


def _values(connection: Connection, name: str) -> list[str]:
    mine = select(shared_secrets.c.value).where(shared_secrets.c.name == name)
    return list(
        connection.execute(mine.order_by(shared_secrets.c.created_at, shared_secrets.c.value)).scalars()
    )


def is_data_folder(folder: Path) -> bool:
    """Return whether a server has used a folder as its data folder."""
    return any((folder / name).exists() for name in (WORKER, SERVER))
