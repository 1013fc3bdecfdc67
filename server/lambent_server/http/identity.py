"""The identity of a client: bearer keys for programs, a cookie for a browser that opened a one-time link."""

import secrets
import threading
from http.cookies import CookieError, SimpleCookie
from typing import Any

from sqlalchemy import Connection

from lambent_server.clock import now
from lambent_server.database.engine import Database
from lambent_server.database.schema import api_keys, sessions
from lambent_server.database.tenancy import Tenant, across_tenants, add, remove
from lambent_server.secrets import sha256_text
from lambent_server.services import Services
from lambent_server.shares import Row, signed

COOKIE = "lambent_session"


class LoginCodes:
    """Codes of one-time links; they are lost when the server stops."""

    def __init__(self, lifetime_s: float) -> None:
        self._lifetime_s = lifetime_s
        self._lock = threading.Lock()
        self._valid_until: dict[str, tuple[Tenant, float]] = {}

    def issue(self, tenant: Tenant) -> tuple[str, float]:
        """Return a new code and its expiry time (Unix seconds)."""
        code, until = secrets.token_urlsafe(32), now() + self._lifetime_s
        with self._lock:
            self._valid_until = {key: value for key, value in self._valid_until.items() if value[1] > now()}
            self._valid_until[sha256_text(code)] = (tenant, until)
        return code, until

    def redeem(self, code: str) -> tuple[Tenant | None, float]:
        """Return the code's tenant and creation time, and invalidate it; None if unknown, used or too old."""
        with self._lock:
            tenant, until = self._valid_until.pop(sha256_text(code), (None, 0.0))
        return (tenant if until > now() else None), until - self._lifetime_s


def open_session(connection: Connection, tenant: Tenant, lifetime_s: float) -> str:
    """Return the token of a new browser session."""
    token = secrets.token_urlsafe(32)
    connection.execute(
        add(
            tenant,
            sessions,
            token_sha256=sha256_text(token),
            created_at=now(),
            expires_at=now() + lifetime_s,
        )
    )
    return token


def end_session(database: Database, tenant: Tenant, token: str) -> None:
    """End a browser session, if it has not ended already."""
    with database.write() as connection:
        mine = sessions.c.token_sha256 == sha256_text(token)
        connection.execute(remove(tenant, sessions).where(mine))


def cookie_token(header: str, name: str = COOKIE) -> str | None:
    """Return the token in a Cookie header: the session's, or the one named `name`."""
    jar: SimpleCookie = SimpleCookie()
    try:
        jar.load(header)
    except CookieError:
        return None
    return jar[name].value if name in jar else None


def tenant_of_key(services: Services, key: str) -> Tenant | None:
    """Return the tenant of a key, or None if it is invalid or no longer valid."""
    if not key:
        return None
    statement = across_tenants(api_keys).where(api_keys.c.key_sha256 == sha256_text(key))
    with services.database.read() as connection:
        row: Any = connection.execute(statement).mappings().one_or_none()
    if row is None or row["revoked_at"] is not None or (row["expires_at"] or now() + 1) < now():
        return None
    services.key_uses[row["id"]] = now()
    return Tenant(row["tenant_id"])


def tenant_of_session(database: Database, token: str) -> Tenant | None:
    """Return the tenant of a browser session, or None if it is invalid or no longer valid."""
    statement = across_tenants(sessions).where(sessions.c.token_sha256 == sha256_text(token))
    with database.read() as connection:
        row = connection.execute(statement).mappings().one_or_none()
    return Tenant(row["tenant_id"]) if row is not None and row["expires_at"] > now() else None


def share_of_token(database: Database, secret: str, token: str, bundle_id: str) -> Row | None:
    """Return the link to a bundle that a token belongs to, active or ended; None for other tokens."""
    with database.read() as connection:
        share = signed(connection, secret, token)
    return share if share is not None and share["bundle_id"] == bundle_id else None
