"""Users, and the organisations that they belong to with a role."""

from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Connection, Table, delete, func, select, update

from lambent_server.accounts import audit
from lambent_server.accounts.makers import end_what_was_made
from lambent_server.accounts.scopes import ROLES, RoleName
from lambent_server.api.problems import conflict, invalid, not_found
from lambent_server.core.clock import new_id, now
from lambent_server.database.cluster_schema import login_codes
from lambent_server.database.model import UserRow
from lambent_server.database.people_schema import members, organisations, users
from lambent_server.database.rows import many, one
from lambent_server.database.schema import api_keys, sessions
from lambent_server.database.tenancy import Tenant, across_tenants, add, change, remove, rows

OPERATOR = "operator"
CLAIM = "claim"


@dataclass(frozen=True, kw_only=True, slots=True)
class Belonging:
    """An open organisation that a user belongs to, and their role there."""

    tenant_id: str
    name: str
    role: RoleName


def create(
    connection: Connection,
    *,
    name: str,
    email: str | None = None,
    issuer: str | None = None,
    subject: str | None = None,
) -> UserRow:
    """Add a user who belongs to no organisation yet; raises `user_exists` for a known address."""
    address = None if email is None else email.strip().lower()
    if address is not None and by_email(connection, address) is not None:
        raise conflict("user_exists", f"there is a user with the address {address!r} already")
    identifier = new_id("user")
    values = {"name": name.strip() or address or "", "email": address, "issuer": issuer, "subject": subject}
    connection.execute(users.insert().values(id=identifier, created_at=now(), **values))
    return require(connection, identifier)


def find(connection: Connection, user_id: str) -> UserRow | None:
    """Return a user, or None."""
    return _first(connection, users.c.id == user_id)


def by_email(connection: Connection, email: str) -> UserRow | None:
    """Return the user with an address, or None."""
    return _first(connection, users.c.email == email.strip().lower())


def by_subject(connection: Connection, issuer: str, subject: str) -> UserRow | None:
    """Return the user whom a provider knows by this name, or None."""
    return _first(connection, users.c.issuer == issuer, users.c.subject == subject)


def _first(connection: Connection, *conditions: Any) -> UserRow | None:
    return one(connection, select(users).where(*conditions), UserRow)


def require(connection: Connection, name: str) -> UserRow:
    """Return the user with this id or address; raises `user_not_found`."""
    row = find(connection, name) or by_email(connection, name)
    if row is None:
        raise not_found("user", name)
    return row


def change_user(connection: Connection, user_id: str, **values: Any) -> None:
    """Change columns of a user."""
    connection.execute(update(users).where(users.c.id == user_id).values(**values))


def join(connection: Connection, tenant: Tenant, user_id: str, role: str, source: str = OPERATOR) -> None:
    """Let a user belong to an organisation with a role, or change the role."""
    if role not in ROLES:
        raise invalid("role_unknown", "#/role", f"there is no role {role!r}; there are {', '.join(ROLES)}")
    mine = members.c.user_id == user_id
    known = connection.execute(change(tenant, members).where(mine).values(role=role, source=source))
    if known.rowcount == 0:
        values = {"user_id": user_id, "role": role, "source": source, "created_at": now()}
        connection.execute(add(tenant, members, **values))


def leave(connection: Connection, tenant: Tenant, user_id: str) -> bool:
    """Let a user no longer belong to an organisation; what they made there to get in, or out, ends."""
    # Before any row is locked, as whatever changes keys does it: a key of theirs may be making another one.
    audit.lock(connection, tenant)
    gone = connection.execute(remove(tenant, members).where(members.c.user_id == user_id)).rowcount > 0
    connection.execute(remove(tenant, sessions).where(_of_user(sessions, user_id)))
    connection.execute(remove(tenant, login_codes).where(_of_user(login_codes, user_id)))
    mine = (api_keys.c.user_id == user_id) & api_keys.c.revoked_at.is_(None)
    connection.execute(change(tenant, api_keys).where(mine).values(revoked_at=now()))
    end_what_was_made(connection, user_id, tenant)
    return gone


def memberships(connection: Connection, user_id: str) -> list[Belonging]:
    """Return the open organisations that a user belongs to, by name."""
    statement = (
        across_tenants(members, members.c.tenant_id, organisations.c.name, members.c.role)
        .join(organisations, organisations.c.tenant_id == members.c.tenant_id)
        .where(members.c.user_id == user_id, organisations.c.closed_at.is_(None))
    )
    return many(connection, statement.order_by(organisations.c.name), Belonging)


def num_members(connection: Connection, tenant: Tenant) -> int:
    """Return how many users belong to an organisation."""
    return int(connection.execute(rows(tenant, members, func.count())).scalar_one())


def everybody(connection: Connection) -> list[UserRow]:
    """Return all users, by name."""
    return many(connection, select(users).order_by(users.c.name), UserRow)


def end_sessions(connection: Connection, user_id: str) -> None:
    """Sign a user out everywhere, and every browser that has opened a login link of theirs."""
    for table in (sessions, login_codes):
        connection.execute(delete(table).where(_of_user(table, user_id)))


def _of_user(table: Table, user_id: str) -> ColumnElement[bool]:
    """Return the condition that a session or the code of a login link is of a user, or of a key of theirs."""
    own = select(api_keys.c.id).where(api_keys.c.user_id == user_id)
    made = (table.c.maker_user_id == user_id) | table.c.maker_key_id.in_(own)
    return made | (table.c.user_id == user_id) if "user_id" in table.c else made


def _lock_organisations(connection: Connection, user_id: str) -> None:
    """Let nobody change anything in the organisations of a user before this has ended."""
    own = select(members.c.tenant_id).where(members.c.user_id == user_id).order_by(members.c.tenant_id)
    for tenant_id in connection.execute(own).scalars().all():
        audit.lock(connection, Tenant(tenant_id))


def revoke_keys(connection: Connection, user_id: str) -> None:
    """Let no key of a user work any more, nor share links and subscriptions that they made."""
    _lock_organisations(connection, user_id)
    end_what_was_made(connection, user_id)
    mine = (api_keys.c.user_id == user_id) & api_keys.c.revoked_at.is_(None)
    connection.execute(update(api_keys).where(mine).values(revoked_at=now()))


def require_member(connection: Connection, tenant: Tenant, name: str) -> str:
    """Return the id of a member by id or address; raises `member_not_found`."""
    user_id = require(connection, name).id
    if connection.execute(rows(tenant, members).where(members.c.user_id == user_id)).first() is None:
        raise not_found("member", name)
    return user_id


def forget(connection: Connection, user_id: str) -> None:
    """Delete a user with sessions, memberships and keys; share links and subscriptions of theirs end.

    What they uploaded and trained stays with its organisation.
    """
    _lock_organisations(connection, user_id)
    end_sessions(connection, user_id)
    end_what_was_made(connection, user_id)
    connection.execute(delete(members).where(members.c.user_id == user_id))
    connection.execute(delete(api_keys).where(api_keys.c.user_id == user_id))
    connection.execute(delete(users).where(users.c.id == user_id))
