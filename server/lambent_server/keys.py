"""Keys for programs: creating, listing, revoking and replacing them. Only their hashes are stored."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from sqlalchemy import Connection, func

from lambent_server.clock import new_id, now, rfc3339
from lambent_server.database.engine import Database
from lambent_server.database.schema import api_keys, sessions
from lambent_server.database.tenancy import Tenant, across_tenants, add, change, find, remove, rows
from lambent_server.messages import Given, Name, Shown
from lambent_server.problems import conflict, invalid, not_found
from lambent_server.secrets import new_secret, read_or_create_secret, sha256_text, write_secret

FILE = "api.key"
PREFIX = "lk_"
Row = Mapping[str, Any]


class NewKey(Given):
    """A key to create."""

    name: Name
    expires_in_s: Annotated[float, Field(ge=60, le=10 * 365 * 86400)] | None = None
    """If omitted, the key is valid until it is revoked."""


class Key(Shown):
    """A key, without the secret itself."""

    id: str
    name: str
    created_at: str
    expires_at: str | None
    revoked_at: str | None
    last_used_at: str | None
    """Exact to a minute."""


class KeyList(Shown):
    """The keys of this tenant, newest first."""

    items: list[Key]


class CreatedKey(Key):
    """A new key with its secret, which is shown only once."""

    key: str


def show(row: Row) -> Key:
    """Return a key in the form of the REST interface."""
    times = ("expires_at", "revoked_at", "last_used_at")
    optional = {name: None if row[name] is None else rfc3339(row[name]) for name in times}
    return Key(id=row["id"], name=row["name"], created_at=rfc3339(row["created_at"]), **optional)


def known(connection: Connection, tenant: Tenant) -> list[Row]:
    """Return the keys of `tenant`, newest first, including revoked ones."""
    statement = rows(tenant, api_keys).order_by(api_keys.c.id.desc()).limit(1000)
    return [dict(row) for row in connection.execute(statement).mappings()]


def create(connection: Connection, tenant: Tenant, order: NewKey) -> CreatedKey:
    """Create a key."""
    if order.name.startswith(FILE):
        raise invalid("key_name_reserved", "#/name", f"names starting with {FILE} are those of key files")
    until = None if order.expires_in_s is None else now() + order.expires_in_s
    return _issue(connection, tenant, order.name, new_secret(PREFIX), until)


def _issue(
    connection: Connection, tenant: Tenant, name: str, secret: str, expires_at: float | None
) -> CreatedKey:
    row = {"id": new_id("key"), "name": name, "created_at": now(), "expires_at": expires_at}
    connection.execute(add(tenant, api_keys, key_sha256=sha256_text(secret), **row))
    shown = show({**row, "revoked_at": None, "last_used_at": None})
    return CreatedKey(**shown.model_dump(), key=secret)


def _require(connection: Connection, tenant: Tenant, key_id: str) -> Row:
    row = find(connection, tenant, api_keys, key_id, lock=True)
    if row is None:
        raise not_found("key", key_id)
    return dict(row)


def revoke(connection: Connection, tenant: Tenant, key_id: str) -> None:
    """Revoke a key, and log out every browser, because the key may have logged one in. Idempotent."""
    if _require(connection, tenant, key_id)["revoked_at"] is None:
        connection.execute(change(tenant, api_keys).where(api_keys.c.id == key_id).values(revoked_at=now()))
        connection.execute(remove(tenant, sessions))


def rotate(connection: Connection, tenant: Tenant, key_id: str, data: Path) -> CreatedKey:
    """Replace a key, which is revoked, with a new one; for the data folder's key, rewrite its file."""
    row = _require(connection, tenant, key_id)
    if row["revoked_at"] is not None:
        raise conflict("key_revoked", f"key {key_id} is revoked permanently; create another one")
    fresh = _issue(connection, tenant, row["name"], new_secret(PREFIX), row["expires_at"])
    if row["name"] == _file_name(data):
        write_secret(data / FILE, fresh.key, replace=True)
    revoke(connection, tenant, key_id)
    return fresh


def last_revoked_at(connection: Connection, tenant: Tenant) -> float:
    """Return when a key of `tenant` was last revoked; 0.0 if never."""
    return connection.execute(rows(tenant, api_keys, func.max(api_keys.c.revoked_at))).scalar_one() or 0.0


def _file_name(data: Path) -> str:
    """Return the name of the key in a data folder; servers that share a database have one each."""
    return f"{FILE} {sha256_text(read_or_create_secret(data / 'worker.secret'))[:8]}"


def accept_file(database: Database, tenant: Tenant, data: Path) -> None:
    """Accept the key in `api.key` from now on, and none that the file contained earlier.

    A file that was removed, or whose key was revoked, is replaced by a new one.
    """
    name, secret = _file_name(data), read_or_create_secret(data / FILE, PREFIX)
    with database.write() as connection:
        known_before = across_tenants(api_keys).where(api_keys.c.key_sha256 == sha256_text(secret))
        row = connection.execute(known_before).mappings().one_or_none()
        if row is not None and row["revoked_at"] is not None:
            secret, row = new_secret(PREFIX), None
            write_secret(data / FILE, secret, replace=True)
        if row is None:
            _issue(connection, tenant, name, secret, None)
        of_file = rows(tenant, api_keys, api_keys.c.id).where(
            api_keys.c.name == name,
            api_keys.c.key_sha256 != sha256_text(secret),
            api_keys.c.revoked_at.is_(None),
        )
        for key_id in list(connection.execute(of_file).scalars()):
            revoke(connection, tenant, key_id)
