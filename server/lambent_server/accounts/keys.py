"""Keys for programs: creating, listing, revoking and replacing them. Only their hashes are stored."""

from pathlib import Path
from typing import Annotated, Any

from lambent_core.pictures import Name
from pydantic import Field
from sqlalchemy import Connection, func

from lambent_server.accounts import audit
from lambent_server.accounts.makers import end_what_keys_made, keys_made_by, makers_of_key, pass_on
from lambent_server.accounts.scopes import ALL, ScopeName, joined, parsed
from lambent_server.accounts.who import Who, operator
from lambent_server.api.idempotency import made_before
from lambent_server.api.messages import Given, Shown
from lambent_server.api.problems import Problem, conflict, invalid
from lambent_server.api.resources import require
from lambent_server.cluster.membership import server_id
from lambent_server.cluster.shared_secrets import WORKER, lock
from lambent_server.core.clock import new_id, now, rfc3339
from lambent_server.core.secrets import new_secret, read_or_create, sha256_text, write_secret
from lambent_server.database.engine import Database
from lambent_server.database.model import KeyRow
from lambent_server.database.rows import one
from lambent_server.database.schema import api_keys, sessions
from lambent_server.database.tenancy import Tenant, across_tenants, add, change, find, remove, rows

FILE = "api.key"
PREFIX = "lk_"


class NewKey(Given):
    """A key to create."""

    name: Name
    expires_in_s: Annotated[float, Field(ge=60, le=10 * 365 * 86400)] | None = None
    """If omitted, the key is valid until it, or the one that makes it, is revoked or expires."""
    scopes: Annotated[list[ScopeName], Field(min_length=1, max_length=len(ALL))] | None = None
    """What the key may do; if omitted, everything that the one who makes it may do."""


class Key(Shown):
    """A key, without the secret itself."""

    id: str
    name: str
    created_at: str
    expires_at: str | None
    revoked_at: str | None
    last_used_at: str | None
    """Exact to a minute."""
    scopes: list[ScopeName]
    """What it may do."""
    user_id: str | None
    """Whose key it is; null: it belongs to no user."""
    made_by: str | None
    """The user or the key that made it, with whom it ends; null: the server, or an operator."""


class KeyList(Shown):
    """The keys of this tenant, newest first."""

    items: list[Key]
    next_cursor: str | None


class CreatedKey(Key):
    """A new key with its secret, which is shown only once."""

    key: str | None
    """Null if the request is a repeat with the same Idempotency-Key: secrets are not stored."""


def show(row: KeyRow) -> Key:
    """Return a key in the form of the REST interface."""
    made_by = row.maker_key_id or row.maker_user_id
    return Key.of(row, scopes=sorted(parsed(row.scopes)), made_by=made_by)


def create(
    connection: Connection,
    tenant: Tenant,
    order: NewKey,
    key: str | None = None,
    digest: str = "",
    user_id: str | None = None,
    maker: Who | None = None,
) -> CreatedKey:
    """Create a key, or return without its secret the one created earlier with this idempotency key.

    A key that another one makes belongs to the same person, may do no more than that one may now, is valid no
    longer, and ends with it. Without `maker` an operator makes it, for the person `user_id` or for nobody.
    Raises `scope_exceeded` and `expiry_exceeded`.
    """
    audit.lock(connection, tenant)
    identifier = new_id("key")
    known = made_before(connection, tenant, key, digest, identifier)
    if known is not None:
        return CreatedKey(**show(_require(connection, tenant, known)).model_dump(), key=None)
    if order.name.startswith(FILE):
        raise invalid("key_name_reserved", "#/name", f"names starting with {FILE} are those of key files")
    until = None if order.expires_in_s is None else now() + order.expires_in_s
    scopes = None if order.scopes is None else joined(order.scopes)
    row = {"id": identifier, "expires_at": until, "scopes": scopes, "user_id": user_id}
    if maker is not None:
        row |= _within(_require_working(connection, tenant, maker), maker, order, until)
    return _issue(connection, tenant, order.name, new_secret(PREFIX), **row)


def _within(own: KeyRow, maker: Who, order: NewKey, until: float | None) -> dict[str, Any]:
    """Return the columns of a key that the key `own` makes: nobody hands out more than they have."""
    wanted = maker.scopes if order.scopes is None else frozenset(order.scopes)
    if wanted - maker.scopes:
        more = ", ".join(sorted(wanted - maker.scopes))
        raise Problem(
            403,
            "scope_exceeded",
            f"this key may not do {more} itself, so it can give that to no other; ask an operator for one",
        )
    if until is not None and own.expires_at is not None and until > own.expires_at:
        raise invalid(
            "expiry_exceeded",
            "#/expires_in_s",
            f"the key that makes it ends at {rfc3339(own.expires_at)}; leave this out, or ask for less",
        )
    return {
        "scopes": joined(wanted),
        "expires_at": own.expires_at if until is None else until,
        "user_id": own.user_id,
        "maker_key_id": own.id,
        "maker_user_id": own.user_id,
    }


def _issue(connection: Connection, tenant: Tenant, name: str, secret: str, **values: Any) -> CreatedKey:
    identifier = values.pop("id", None) or new_id("key")
    hashed = {"key_sha256": sha256_text(secret), "created_at": now()}
    connection.execute(add(tenant, api_keys, id=identifier, name=name, **hashed, **values))
    return CreatedKey(**show(_require(connection, tenant, identifier)).model_dump(), key=secret)


def _require(connection: Connection, tenant: Tenant, key_id: str) -> KeyRow:
    return require(connection, tenant, KeyRow, "key", key_id, lock=True)


def end_of(connection: Connection, who: Who) -> float | None:
    """Return when the key ends that makes a request, or that made the link of its browser; None if never."""
    key_id = who.maker.key_id
    row = None if key_id is None else find(connection, who.tenant, KeyRow, key_id)
    return None if row is None else row.expires_at


def revoke(connection: Connection, tenant: Tenant, key_id: str) -> None:
    """Revoke a key with all that it has made: keys, and those that these made, share links, subscriptions.

    Every browser without a user is logged out: the key may have logged it in. Idempotent.
    """
    # One at a time, as all that makes keys: else a key that one of these is just making would outlive it.
    audit.lock(connection, tenant)
    if _require(connection, tenant, key_id).revoked_at is None:
        ended = [key_id, *keys_made_by(connection, tenant, key_id)]
        working = api_keys.c.id.in_(ended) & api_keys.c.revoked_at.is_(None)
        connection.execute(change(tenant, api_keys).where(working).values(revoked_at=now()))
        connection.execute(remove(tenant, sessions).where(sessions.c.user_id.is_(None)))
        end_what_keys_made(connection, tenant, ended)


def rotate(connection: Connection, tenant: Tenant, key_id: str, maker: Who | None = None) -> CreatedKey:
    """Replace a key, which is revoked, with a new one; `keep_in_file` must follow the transaction.

    Share links, subscriptions and webhooks of jobs pass to the new key; keys that the old one made end.
    Without `maker` an operator does it. Raises `key_of_another` unless `maker` is the key itself, or has made
    it: whoever replaces a key gets its secret, and so one that would not end with their own.
    """
    audit.lock(connection, tenant)
    row = _require(connection, tenant, key_id)
    if maker is not None:
        _require_working(connection, tenant, maker)
    if row.revoked_at is not None:
        raise conflict("key_revoked", f"key {key_id} is revoked permanently; create another one")
    if maker is not None and maker.id not in (key_id, *makers_of_key(connection, tenant, key_id)):
        raise Problem(
            403,
            "key_of_another",
            "whoever replaces a key gets its secret: that is for the key itself, for one that has made it, "
            "and for operators; revoke it, and let a new one be made",
        )
    names = ("expires_at", "scopes", "user_id", "maker_user_id", "maker_key_id")
    kept = {name: getattr(row, name) for name in names}
    fresh = _issue(connection, tenant, row.name, new_secret(PREFIX), **kept)
    pass_on(connection, tenant, key_id, fresh.id)
    revoke(connection, tenant, key_id)
    return fresh


def keep_in_file(data: Path, fresh: CreatedKey) -> None:
    """Write the key that replaces the data folder's one into its file.

    Only once its transaction has ended: one that is rolled back must leave the key that works in the file.
    If the server ends in between, the next start finds a revoked key in the file and makes another one.
    """
    if fresh.key is not None and fresh.name == _file_name(data):
        write_secret(data / FILE, fresh.key, replace=True)


def _require_working(connection: Connection, tenant: Tenant, maker: Who) -> KeyRow:
    """Return the row of the key that makes a request, locked: it may have ended since it was looked at."""
    row = _require(connection, tenant, maker.id)
    if row.revoked_at is not None:
        raise Problem(
            401,
            "not_authenticated",
            "this key has just been revoked; use another one",
            headers={"www-authenticate": 'Bearer realm="lambent"'},
        )
    return row


def last_revoked_at(connection: Connection, tenant: Tenant) -> float:
    """Return when a key of `tenant` was last revoked; 0.0 if never."""
    return connection.execute(rows(tenant, api_keys, func.max(api_keys.c.revoked_at))).scalar_one() or 0.0


def _file_name(data: Path) -> str:
    """Return the name of the key in a data folder, which tells it from those in others."""
    secret = data / WORKER
    of_folder = read_or_create(secret) if secret.exists() else server_id(data)
    return f"{FILE} {sha256_text(of_folder)[:8]}"


def accept_file(database: Database, tenant: Tenant, data: Path) -> bool:
    """Accept the key in `api.key` from now on, and none that the file contained earlier.

    A file that was removed, or whose key was revoked, is replaced by a new one. Returns False, and creates no
    file, if there was none and another server on the database has one: the first has the key of all.
    """
    name = _file_name(data)
    with database.write() as connection:
        lock(connection)
        if not (data / FILE).exists() and _is_elsewhere(connection, tenant, name):
            return False
        secret = read_or_create(data / FILE, lambda: new_secret(PREFIX))
        known_before = across_tenants(api_keys).where(api_keys.c.key_sha256 == sha256_text(secret))
        row = one(connection, known_before, KeyRow)
        if row is not None and row.revoked_at is not None:
            secret, row = new_secret(PREFIX), None
            write_secret(data / FILE, secret, replace=True)
        issued = _issue(connection, tenant, name, secret).id if row is None else ""
        of_file = rows(tenant, api_keys, api_keys.c.id).where(
            api_keys.c.name == name,
            api_keys.c.key_sha256 != sha256_text(secret),
            api_keys.c.revoked_at.is_(None),
        )
        ended = list(connection.execute(of_file).scalars())
        for key_id in ended:
            revoke(connection, tenant, key_id)
        if issued or ended:
            details = {"revoked": ended}
            audit.record(connection, operator(tenant), "serve key file", issued, details=details)
    return True


def _is_elsewhere(connection: Connection, tenant: Tenant, name: str) -> bool:
    """Return whether another data folder has a key that works, and that of the name never had one."""
    of_files = rows(tenant, api_keys, api_keys.c.name).where(api_keys.c.name.startswith(f"{FILE} "))
    working = of_files.where(api_keys.c.revoked_at.is_(None))
    had_one = connection.execute(of_files.where(api_keys.c.name == name)).first() is not None
    return not had_one and connection.execute(working).first() is not None
