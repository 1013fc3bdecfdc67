"""The identity of a client: bearer keys for programs, a cookie for a browser that opened a one-time link."""

import secrets
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any

from sqlalchemy import Connection, Select, Table, delete

from lambent_server.accounts.scopes import ADMIN, ALL, ScopeName, of_role, parsed
from lambent_server.accounts.sign_in import PROXY
from lambent_server.accounts.who import NOBODY, Maker, Who
from lambent_server.clock import now
from lambent_server.database.cluster_schema import login_codes
from lambent_server.database.engine import Database
from lambent_server.database.people_schema import members, organisations, users
from lambent_server.database.schema import api_keys, sessions
from lambent_server.database.tenancy import Tenant, across_tenants, add, remove, rows
from lambent_server.secrets import sha256_text
from lambent_server.services import Services
from lambent_server.shares import Row, signed

COOKIE = "lambent_session"


@dataclass(frozen=True, kw_only=True, slots=True)
class Redeemed:
    """The code of a one-time link that was used."""

    tenant: Tenant
    made_at: float
    """Unix seconds."""
    maker: Maker


def issue_login_code(
    connection: Connection, tenant: Tenant, lifetime_s: float, maker: Maker = NOBODY
) -> tuple[str, float]:
    """Return the code of a new one-time link and its expiry time (Unix seconds).

    Only its hash is stored, and any server on the database redeems it.
    """
    code, at = secrets.token_urlsafe(32), now()
    values = {"code_sha256": sha256_text(code), "created_at": at, "expires_at": at + lifetime_s}
    connection.execute(delete(login_codes).where(login_codes.c.expires_at < at))
    connection.execute(add(tenant, login_codes, **values, **_columns(maker)))
    return code, at + lifetime_s


def redeem_login_code(connection: Connection, code: str) -> Redeemed | None:
    """Return what a code stands for, and invalidate it; None if it is unknown, used or too old."""
    mine = delete(login_codes).where(login_codes.c.code_sha256 == sha256_text(code))
    row = connection.execute(mine.returning(login_codes)).mappings().one_or_none()
    if row is None or row["expires_at"] <= now():
        return None
    return Redeemed(tenant=Tenant(row["tenant_id"]), made_at=row["created_at"], maker=_maker(row))


def open_session(
    connection: Connection,
    tenant: Tenant,
    lifetime_s: float,
    user_id: str | None = None,
    maker: Maker = NOBODY,
) -> str:
    """Return the token of a new browser session, of a user who has signed in or of a one-time link.

    `maker` is who made that link.
    """
    token = secrets.token_urlsafe(32)
    connection.execute(
        add(
            tenant,
            sessions,
            token_sha256=sha256_text(token),
            created_at=now(),
            expires_at=now() + lifetime_s,
            user_id=user_id,
            **_columns(maker),
        )
    )
    return token


def _columns(maker: Maker) -> dict[str, str | None]:
    return {"maker_user_id": maker.user_id, "maker_key_id": maker.key_id}


def _maker(row: Any) -> Maker:
    return Maker(user_id=row["maker_user_id"], key_id=row["maker_key_id"])


def is_trusted(connection: Connection, tenant: Tenant, maker: Maker) -> bool:
    """Return whether a one-time link holds: whoever made it could make another one now.

    That of the server itself, and those from before makers were stored, always do.
    """
    if maker.key_id is not None:
        mine = (api_keys.c.id == maker.key_id) & (api_keys.c.tenant_id == tenant.id)
        row: Any = connection.execute(_keys().where(mine)).mappings().one_or_none()
        return row is not None and ADMIN in (_scopes_of_key(row) or ())
    if maker.user_id is not None:
        roles = (
            rows(tenant, members, members.c.role)
            .join(users, users.c.id == members.c.user_id)
            .where(members.c.user_id == maker.user_id, users.c.disabled_at.is_(None))
        )
        role = connection.execute(roles).scalar_one_or_none()
        return role is not None and ADMIN in of_role(role)
    return True


def end_session(connection: Connection, tenant: Tenant, token: str) -> float | None:
    """End a browser session and return until when it was valid; None if it has ended already."""
    mine = sessions.c.token_sha256 == sha256_text(token)
    statement = remove(tenant, sessions).where(mine).returning(sessions.c.expires_at)
    until: float | None = connection.execute(statement).scalar_one_or_none()
    return until


def cookie_token(header: str, name: str = COOKIE) -> str | None:
    """Return the token in a Cookie header: the session's, or the one named `name`."""
    jar: SimpleCookie = SimpleCookie()
    try:
        jar.load(header)
    except CookieError:
        return None
    return jar[name].value if name in jar else None


def who_of_key(services: Services, key: str) -> Who | None:
    """Return whose a key is; None if it is invalid or no longer valid, or its organisation is closed."""
    if not key:
        return None
    with services.database.read() as connection:
        statement = _keys().where(api_keys.c.key_sha256 == sha256_text(key))
        row: Any = connection.execute(statement).mappings().one_or_none()
    scopes = None if row is None else _scopes_of_key(row)
    if scopes is None:
        return None
    services.key_uses[row["id"]] = now()
    return Who(tenant=Tenant(row["tenant_id"]), kind="key", id=row["id"], scopes=scopes)


def _keys() -> Select[Any]:
    """Return a SELECT of keys, with their organisations and with those whose keys they are."""
    return _with_user(_with_organisation(api_keys, members.c.role, users.c.disabled_at), api_keys)


def _scopes_of_key(row: Any) -> frozenset[ScopeName] | None:
    """Return what a key may do now: of a person's key, no more than the person; None if it is invalid."""
    ended = row["revoked_at"] is not None or (row["expires_at"] or now() + 1) < now()
    if ended or row["closed_at"] is not None:
        return None
    scopes = parsed(row["scopes"])
    if row["user_id"] is None:
        return scopes
    if row["disabled_at"] is not None or row["role"] is None:
        return None
    return scopes & of_role(row["role"])


def who_of_session(database: Database, token: str, login_name: str | None = None) -> Who | None:
    """Return who uses a browser session, or None if it is invalid or no longer valid.

    `login_name` is whom a trusted proxy names in this request: a session of somebody whom the proxy has
    vouched for is valid only while it names them. The role of a user is that of now: who has left the
    organisation is signed out of it at once, and so is every browser that opened a link of theirs.
    """
    columns = (members.c.role, users.c.disabled_at, users.c.issuer, users.c.subject)
    statement = _with_user(_with_organisation(sessions, *columns), sessions)
    with database.read() as connection:
        mine = sessions.c.token_sha256 == sha256_text(token)
        row: Any = connection.execute(statement.where(mine)).mappings().one_or_none()
        by_link = row is not None and row["user_id"] is None
        trusted = not by_link or is_trusted(connection, Tenant(row["tenant_id"]), _maker(row))
    if row is None or row["expires_at"] <= now() or row["closed_at"] is not None:
        return None
    tenant = Tenant(row["tenant_id"])
    if not trusted:
        return None
    if by_link:
        return Who(tenant=tenant, kind="session", id="", scopes=ALL, link_maker=_maker(row))
    if row["disabled_at"] is not None or row["role"] is None:
        return None
    if row["issuer"] == PROXY and row["subject"] != login_name:
        return None
    return Who(tenant=tenant, kind="user", id=row["user_id"], scopes=of_role(row["role"]))


def _with_organisation(table: Table, *columns: Any) -> Select[Any]:
    """Return a SELECT of rows of a table, with when their organisation was closed.

    Rows of an organisation that does not exist (any more) are none of them.
    """
    organisation = organisations.c.tenant_id == table.c.tenant_id
    statement = across_tenants(table, *table.c, organisations.c.closed_at, *columns)
    return statement.select_from(table).join(organisations, organisation)


def _with_user(statement: Select[Any], table: Table) -> Select[Any]:
    """Return a SELECT with the user of each row and the user's membership, as far as there are these."""
    member = (members.c.user_id == table.c.user_id) & (members.c.tenant_id == table.c.tenant_id)
    return statement.outerjoin(users, users.c.id == table.c.user_id).outerjoin(members, member)


def share_of_token(database: Database, secret: str, token: str, bundle_id: str) -> Row | None:
    """Return the link to a bundle that a token belongs to, active or ended; None for other tokens."""
    with database.read() as connection:
        share = signed(connection, secret, token)
    return share if share is not None and share["bundle_id"] == bundle_id else None
