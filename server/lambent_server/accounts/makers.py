"""The makers of keys, links, subscriptions and webhooks of jobs, which end with them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, Table, select, update

from lambent_server.accounts.scopes import ALL, ScopeName, of_role, parsed
from lambent_server.accounts.who import Maker
from lambent_server.core.clock import now
from lambent_server.database.model import JobRow, KeyRow, ShareRow, WebhookRow
from lambent_server.database.people_schema import members, organisations, users
from lambent_server.database.rows import one
from lambent_server.database.schema import api_keys, jobs, shares
from lambent_server.database.service_schema import webhook_deliveries, webhooks
from lambent_server.database.tenancy import Tenant, across_tenants, change, rows

LEFT = "maker_left"
"""Why a subscription is disabled whose maker has left."""
NOTHING: frozenset[ScopeName] = frozenset()


@dataclass(frozen=True, kw_only=True, slots=True)
class UsedKey(KeyRow):
    """A key with its organisation, and with whose it is."""

    closed_at: float | None
    role: str | None
    disabled_at: float | None


def columns_of(maker: Maker) -> dict[str, str | None]:
    """Return the columns that a thing's maker is stored in."""
    return {"maker_user_id": maker.user_id, "maker_key_id": maker.key_id}


def maker_of(row: JobRow | ShareRow | WebhookRow | Row[Any]) -> Maker:
    """Return who made the thing of a row."""
    return Maker(user_id=row.maker_user_id, key_id=row.maker_key_id)


def scopes_of_maker(connection: Connection, tenant: Tenant, maker: Maker) -> frozenset[ScopeName]:
    """Return what a maker may do in an organisation now; nothing once they have left, or their key has ended.

    The server itself, which stores no maker, may do everything.
    """
    if maker.key_id is not None:
        mine = (api_keys.c.id == maker.key_id) & (api_keys.c.tenant_id == tenant.id)
        row = one(connection, keys_with_people().where(mine), UsedKey)
        return NOTHING if row is None else scopes_of_key(row) or NOTHING
    if maker.user_id is not None:
        roles = (
            rows(tenant, members, members.c.role)
            .join(users, users.c.id == members.c.user_id)
            .where(members.c.user_id == maker.user_id, users.c.disabled_at.is_(None))
        )
        role = connection.execute(roles).scalar_one_or_none()
        return NOTHING if role is None else of_role(role)
    return ALL


def keys_with_people() -> Select[Any]:
    """Return a SELECT of keys, with their organisations and with those whose keys they are."""
    return with_user(with_organisation(api_keys, members.c.role, users.c.disabled_at), api_keys)


def scopes_of_key(row: UsedKey) -> frozenset[ScopeName] | None:
    """Return what a key may do now: of a person's key, no more than the person; None if it is invalid."""
    ended = row.revoked_at is not None or (row.expires_at or now() + 1) < now()
    if ended or row.closed_at is not None:
        return None
    scopes = parsed(row.scopes)
    if row.user_id is None:
        return scopes
    if row.disabled_at is not None or row.role is None:
        return None
    return scopes & of_role(row.role)


def with_organisation(table: Table, *columns: Any) -> Select[Any]:
    """Return a SELECT of rows of a table, with when their organisation was closed.

    Rows of an organisation that does not exist (any more) are none of them.
    """
    organisation = organisations.c.tenant_id == table.c.tenant_id
    statement = across_tenants(table, *table.c, organisations.c.closed_at, *columns)
    return statement.select_from(table).join(organisations, organisation)


def with_user(statement: Select[Any], table: Table) -> Select[Any]:
    """Return a SELECT with the user of each row and the user's membership, as far as there are these."""
    member = (members.c.user_id == table.c.user_id) & (members.c.tenant_id == table.c.tenant_id)
    return statement.outerjoin(users, users.c.id == table.c.user_id).outerjoin(members, member)


def keys_made_by(connection: Connection, tenant: Tenant, key_id: str) -> list[str]:
    """Return the ids of the keys that a key has made, those that these have made, and so on."""
    made_keys: list[str] = []
    last = [key_id]
    while last:
        made = rows(tenant, api_keys, api_keys.c.id).where(
            api_keys.c.maker_key_id.in_(last), api_keys.c.id.not_in([key_id, *made_keys])
        )
        last = list(connection.execute(made).scalars())
        made_keys += last
    return made_keys


def makers_of_key(connection: Connection, tenant: Tenant, key_id: str) -> list[str]:
    """Return the ids of the key that made a key, of the one that made that, and so on."""
    makers: list[str] = []
    current: str | None = key_id
    while current is not None and current not in makers:
        makers.append(current)
        maker = rows(tenant, api_keys, api_keys.c.maker_key_id).where(api_keys.c.id == current)
        current = connection.execute(maker).scalar_one_or_none()
    return makers[1:]


def end_what_was_made(connection: Connection, user_id: str, tenant: Tenant | None = None) -> None:
    """End share links and subscriptions that a user made, or keys of theirs; in one organisation, or all."""
    own = select(api_keys.c.id).where(api_keys.c.user_id == user_id)
    for table in (shares, webhooks):
        made = (table.c.maker_user_id == user_id) | table.c.maker_key_id.in_(own)
        if tenant is not None:
            made &= table.c.tenant_id == tenant.id
        _end(connection, table, made)


def end_what_keys_made(connection: Connection, tenant: Tenant, keys: Sequence[str]) -> None:
    """End share links and subscriptions that some keys have made."""
    for table in (shares, webhooks):
        _end(connection, table, table.c.maker_key_id.in_(keys) & (table.c.tenant_id == tenant.id))


def pass_on(connection: Connection, tenant: Tenant, old: str, new: str) -> None:
    """Let what a key made be of the one that replaces it: share links, subscriptions, webhooks of jobs."""
    for table in (shares, webhooks, jobs):
        mine = change(tenant, table).where(table.c.maker_key_id == old)
        connection.execute(mine.values(maker_key_id=new))


def _end(connection: Connection, table: Table, made: ColumnElement[bool]) -> None:
    made &= table.c["revoked_at" if table is shares else "disabled_at"].is_(None)
    if table is shares:
        connection.execute(update(shares).where(made).values(revoked_at=now()))
        return
    # As if a person had disabled it: deliveries that wait have failed.
    waiting = webhook_deliveries.c.webhook_id.in_(select(webhooks.c.id).where(made))
    failed = {"state": "failed", "next_at": None, "claim": None, "ended_at": now()}
    connection.execute(
        update(webhook_deliveries).where(waiting, webhook_deliveries.c.next_at.is_not(None)).values(**failed)
    )
    connection.execute(update(webhooks).where(made).values(disabled_at=now(), disabled_reason=LEFT))
