"""The identity of a client: bearer keys for programs, a cookie for a browser that opened a one-time link."""

import secrets
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie

from sqlalchemy import Connection, delete

from lambent_server.accounts.makers import (
    UsedKey,
    columns_of,
    keys_with_people,
    maker_of,
    scopes_of_key,
    scopes_of_maker,
    with_organisation,
    with_user,
)
from lambent_server.accounts.scopes import ADMIN, of_role
from lambent_server.accounts.shares import FoundShare, signed
from lambent_server.accounts.sign_in import PROXY
from lambent_server.accounts.who import NOBODY, Maker, Who
from lambent_server.core.clock import now
from lambent_server.core.secrets import sha256_text
from lambent_server.database.cluster_schema import login_codes
from lambent_server.database.engine import Database
from lambent_server.database.people_schema import members, users
from lambent_server.database.rows import one
from lambent_server.database.schema import api_keys, sessions
from lambent_server.database.tenancy import Tenant, across_tenants, add, remove
from lambent_server.services import Services

COOKIE = "lambent_session"


@dataclass(frozen=True, kw_only=True, slots=True)
class Redeemed:
    """The code of a one-time link that was used."""

    tenant: Tenant
    made_at: float
    """Unix seconds."""
    maker: Maker
    session: str | None
    """Hash of the token of the session in which the link was made, which has not ended."""
    until: float | None
    """When that session ends, Unix seconds."""


def issue_login_code(
    connection: Connection,
    tenant: Tenant,
    lifetime_s: float,
    maker: Maker = NOBODY,
    session: str | None = None,
) -> tuple[str, float]:
    """Return the code of a new one-time link and its expiry time (Unix seconds).

    Only its hash is stored, and any server on the database redeems it. `session` is the token of the session
    in which it is made: what the link opens ends with that.
    """
    code, at = secrets.token_urlsafe(32), now()
    values = {"code_sha256": sha256_text(code), "created_at": at, "expires_at": at + lifetime_s}
    connection.execute(delete(login_codes).where(login_codes.c.expires_at < at))
    within = {"maker_session": None if session is None else sha256_text(session)}
    connection.execute(add(tenant, login_codes, **values, **columns_of(maker), **within))
    return code, at + lifetime_s


def redeem_login_code(connection: Connection, code: str) -> Redeemed | None:
    """Return what a code stands for, and invalidate it; None if it is unknown, used or too old."""
    mine = delete(login_codes).where(login_codes.c.code_sha256 == sha256_text(code))
    row = connection.execute(mine.returning(login_codes)).one_or_none()
    if row is None or row.expires_at <= now():
        return None
    until = None
    if row.maker_session is not None:
        parent = across_tenants(sessions).where(sessions.c.token_sha256 == row.maker_session)
        # Locked: a logout now would not find the session that is opened with this link.
        session = connection.execute(parent.with_for_update()).one_or_none()
        until = None if session is None else session.expires_at
        if until is None or until <= now():
            return None
    return Redeemed(
        tenant=Tenant(row.tenant_id),
        made_at=row.created_at,
        maker=maker_of(row),
        session=row.maker_session,
        until=until,
    )


def open_session(
    connection: Connection,
    tenant: Tenant,
    lifetime_s: float,
    user_id: str | None = None,
    maker: Maker = NOBODY,
    within: str | None = None,
) -> str:
    """Return the token of a new browser session, of a user who has signed in or of a one-time link.

    `maker` is who made that link, and `within` the hash of the token of the session in which they did.
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
            maker_session=within,
            **columns_of(maker),
        )
    )
    return token


def end_session(connection: Connection, tenant: Tenant, token: str) -> float | None:
    """End a browser session and return until when it was valid; None if it has ended already.

    The one-time links that were made in it end too, with the sessions that they opened, and so on.
    """
    mine = sessions.c.token_sha256 == sha256_text(token)
    statement = remove(tenant, sessions).where(mine).returning(sessions.c.expires_at)
    until: float | None = connection.execute(statement).scalar_one_or_none()
    ended = [] if until is None else [sha256_text(token)]
    while ended:
        connection.execute(delete(login_codes).where(login_codes.c.maker_session.in_(ended)))
        opened = (
            delete(sessions).where(sessions.c.maker_session.in_(ended)).returning(sessions.c.token_sha256)
        )
        ended = list(connection.execute(opened).scalars())
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
        statement = keys_with_people().where(api_keys.c.key_sha256 == sha256_text(key))
        row = one(connection, statement, UsedKey)
    scopes = None if row is None else scopes_of_key(row)
    if row is None or scopes is None:
        return None
    services.key_uses[row.id] = now()
    return Who(tenant=Tenant(row.tenant_id), kind="key", id=row.id, scopes=scopes)


def who_of_session(database: Database, token: str, login_name: str | None = None) -> Who | None:
    """Return who uses a browser session, or None if it is invalid or no longer valid.

    `login_name` is the user whom a trusted proxy names in this request: a session that began by the proxy's
    word is valid only while the proxy names the same user. The role of a user is that of now: who has left
    the organisation is signed out at once, and so is every browser that opened a link of theirs.
    """
    columns = (members.c.role, users.c.disabled_at, users.c.issuer, users.c.subject)
    statement = with_user(with_organisation(sessions, *columns), sessions)
    with database.read() as connection:
        mine = sessions.c.token_sha256 == sha256_text(token)
        row = connection.execute(statement.where(mine)).one_or_none()
        if row is None or row.expires_at <= now() or row.closed_at is not None:
            return None
        tenant = Tenant(row.tenant_id)
        given = scopes_of_maker(connection, tenant, maker_of(row)) if row.user_id is None else frozenset()
    if row.user_id is None:
        # Only who may make such a link has ADMIN; without, its maker has lost that, or has left.
        if ADMIN not in given:
            return None
        return Who(tenant=tenant, kind="session", id="", scopes=given, link_maker=maker_of(row))
    if row.disabled_at is not None or row.role is None:
        return None
    if row.issuer == PROXY and row.subject != login_name:
        return None
    return Who(tenant=tenant, kind="user", id=row.user_id, scopes=of_role(row.role))


def share_of_token(database: Database, secret: str, token: str, bundle_id: str) -> FoundShare | None:
    """Return the link to a bundle that a token belongs to, active or ended; None for other tokens."""
    with database.read() as connection:
        share = signed(connection, secret, token)
    return share if share is not None and share.bundle_id == bundle_id else None
