"""Admission of people whom a provider or proxy vouches for, and the organisations they get into."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection

from lambent_server.accounts import organisations, users
from lambent_server.accounts.scopes import ROLES
from lambent_server.api.outside_text import plain
from lambent_server.core.clock import now
from lambent_server.core.settings import Settings
from lambent_server.database.model import MemberRow, UserRow
from lambent_server.database.people_schema import members
from lambent_server.database.rows import many
from lambent_server.database.tenancy import Tenant, across_tenants

PROXY = "proxy"
"""The issuer of people whom a proxy names."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Vouched:
    """A person, as far as the one who vouches knows."""

    issuer: str
    subject: str
    name: str
    email: str | None
    """Only if the issuer says that it was verified."""
    roles: Mapping[str, str] | None
    """Role in each organisation; None if the issuer says nothing about organisations."""


class RefusedError(Exception):
    """The server does not know this person, or knows them and does not let them in."""


def of_claims(claims: Mapping[str, Any], settings: Settings) -> Vouched:
    """Return whom the claims of an ID token describe."""
    email = claims.get("email") if claims.get("email_verified") is True else None
    roles = None
    if settings.oidc_organisation_claim is not None:
        role = role_of(_texts(claims.get(settings.oidc_role_claim or "")), settings)
        roles = roles_of(_texts(claims.get(settings.oidc_organisation_claim)), role)
    names = (claims.get(name) for name in ("name", "preferred_username", "email", "sub"))
    return Vouched(
        issuer=str(claims["iss"]),
        subject=str(claims["sub"]),
        # Shown, and never looked up: people choose it at their provider.
        name=plain(next(str(name) for name in names if name))[:200],
        email=str(email) if email else None,
        roles=roles,
    )


def of_proxy(name: str, groups: str | None, settings: Settings) -> Vouched:
    """Return whom the headers of a proxy describe: a name, and organisations separated by commas.

    Where the settings name a header for these, its absence says that there are none: a proxy leaves it out,
    or empty, for a person who has lost the last group.
    """
    roles = None
    if settings.login_organisations_header is not None:
        roles = roles_of([each.strip() for each in (groups or "").split(",")], settings.login_role)
    return Vouched(issuer=PROXY, subject=name, name=name, email=name if "@" in name else None, roles=roles)


_ORDER: list[str] = list(ROLES)
"""The roles, from the one that may least to the one that may most."""


def role_of(values: list[str], settings: Settings) -> str:
    """Return the most that a claim gives: by the table of the settings, else a role of that name."""
    known = [settings.oidc_roles.get(value, value) for value in values]
    given = [role for role in known if role in _ORDER]
    return max(given, key=_ORDER.index, default=settings.login_role)


def roles_of(values: list[str], role: str) -> dict[str, str]:
    """Return the role in each organisation that a claim names: "studio", or "studio:viewer".

    Where it names one with several roles, that which may most.
    """
    roles: dict[str, str] = {}
    for value in values:
        name, _, own = value.partition(":")
        if name and (not own or own in ROLES):
            roles[name] = max(roles.get(name, _ORDER[0]), own or role, key=_ORDER.index)
    return roles


def _texts(value: Any) -> list[str]:
    """Return a claim that is a text or a list of texts."""
    if isinstance(value, str):
        return [value]
    return [each for each in value if isinstance(each, str)] if isinstance(value, list) else []


def admit(connection: Connection, vouched: Vouched, settings: Settings) -> tuple[str, Tenant | None]:
    """Return the id of the user and the organisation to begin with; raises RefusedError for a stranger.

    The organisation is None for a user who belongs to none (any more): commit that, and refuse them.

    A user whom an operator has added by address is bound to whoever signs in first with that address
    verified, and from then on known by issuer and subject only: addresses are given to others later.
    """
    user = users.by_subject(connection, vouched.issuer, vouched.subject)
    if user is None and vouched.email is not None:
        user = users.by_email(connection, vouched.email)
        if user is not None and user.issuer is not None:
            raise RefusedError(f"the address of {vouched.subject!r} belongs to another user")
    claimed = _existing(connection, vouched.roles or {})
    if user is None:
        user = _create(connection, vouched, claimed, settings)
    user_id = user.id
    if user.disabled_at is not None:
        raise RefusedError(f"user {user_id} is disabled")
    users.change_user(
        connection,
        user_id,
        issuer=vouched.issuer,
        subject=vouched.subject,
        name=vouched.name,
        last_seen_at=now(),
    )
    if vouched.roles is not None:
        _follow_claims(connection, user_id, claimed)
    own = users.memberships(connection, user_id)
    return user_id, Tenant(own[0].tenant_id) if own else None


def _existing(connection: Connection, roles: Mapping[str, str]) -> dict[str, str]:
    # Closed ones too: who leaves one out would lose for good what an operator opens again.
    known = {row.tenant_id for row in organisations.all_of_them(connection)}
    return {name: role for name, role in roles.items() if name in known}


def _create(
    connection: Connection, vouched: Vouched, claimed: Mapping[str, str], settings: Settings
) -> UserRow:
    known = organisations.all_of_them(connection)
    is_claimed = any(row.tenant_id in claimed and row.closed_at is None for row in known)
    may = settings.login_create == "everybody" or (settings.login_create == "claimed" and is_claimed)
    if not may:
        raise RefusedError(f"there is no user {vouched.subject!r} of {vouched.issuer}")
    identity = {"issuer": vouched.issuer, "subject": vouched.subject}
    user = users.create(connection, name=vouched.name, email=vouched.email, **identity)
    if not claimed and vouched.roles is None:
        tenant = Tenant(settings.login_organisation)
        if organisations.find(connection, tenant) is None:
            raise RefusedError(f"there is no organisation {tenant.id!r}")
        users.join(connection, tenant, user.id, settings.login_role)
    return user


def _follow_claims(connection: Connection, user_id: str, claimed: Mapping[str, str]) -> None:
    """Let memberships be as claimed; those that an operator has given stay as they are."""
    statement = across_tenants(members).where(members.c.user_id == user_id)
    known = {row.tenant_id: row for row in many(connection, statement, MemberRow)}
    for name, row in known.items():
        if row.source == users.CLAIM and name not in claimed:
            users.leave(connection, Tenant(name), user_id)
    for name, role in claimed.items():
        if name not in known or known[name].source == users.CLAIM:
            users.join(connection, Tenant(name), user_id, role, users.CLAIM)
