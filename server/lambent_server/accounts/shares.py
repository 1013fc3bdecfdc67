"""Links to one bundle: signed, read-only, with an expiry time, and revocable at any time."""

import hmac
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from sqlalchemy import ColumnElement, Connection

from lambent_server.accounts.makers import columns_of, maker_of, scopes_of_maker
from lambent_server.accounts.scopes import SUBMIT
from lambent_server.accounts.who import NOBODY, Maker
from lambent_server.api import resources
from lambent_server.api.origins import joined
from lambent_server.core.clock import new_id, now
from lambent_server.database.model import ShareRow
from lambent_server.database.people_schema import organisations
from lambent_server.database.rows import many, one
from lambent_server.database.schema import shares
from lambent_server.database.tenancy import Tenant, across_tenants, add, change

_READS = re.compile(r"/v1/bundles/([^/:]+)(/manifest|/files/.+)")
_TOKEN = re.compile(r"(share_[a-z0-9]{1,40})\.([0-9a-f]{64})")


@dataclass(frozen=True, kw_only=True, slots=True)
class FoundShare(ShareRow):
    """A link with when its organisation was closed, and whether its maker may still share."""

    closed_at: float | None
    maker_may: bool = False


def page_path(share_id: str) -> str:
    """Return the path of the page of a link; the secret follows it as fragment."""
    return f"/embed/{share_id}"


def bundle_read(method: str, path: str) -> str | None:
    """Return the bundle whose files a request reads, or None for any other request."""
    match = _READS.fullmatch(path)
    return match.group(1) if match is not None and method in ("GET", "HEAD") else None


def sign(secret: str, row: ShareRow) -> str:
    """Return the secret part of a link: the share's id and a signature of all that it grants."""
    parts = ("share", row.id, row.tenant_id, row.bundle_id, repr(float(row.expires_at)))
    digest = hmac.new(secret.encode(), "\n".join(parts).encode(), "sha256").hexdigest()
    return f"{row.id}.{digest}"


def create(
    connection: Connection,
    tenant: Tenant,
    bundle_id: str,
    lifetime_s: float,
    frame_ancestors: Sequence[str] = (),
    share_id: str | None = None,
    maker: Maker = NOBODY,
) -> ShareRow:
    """Add a link to a bundle of `tenant`; pages of the origins `frame_ancestors` may show it.

    It works while its `maker` may share. Raises ValueError unless each of these is an origin.
    """
    identifier = share_id or new_id("share")
    values = {"id": identifier, "bundle_id": bundle_id, "created_at": now(), "expires_at": now() + lifetime_s}
    values |= columns_of(maker)
    connection.execute(add(tenant, shares, frame_ancestors=joined(frame_ancestors), **values))
    return require(connection, tenant, identifier)


def working(bundle_id: str) -> tuple[ColumnElement[bool], ...]:
    """Return the conditions that a link is of a bundle and has neither expired nor been revoked."""
    return shares.c.bundle_id == bundle_id, shares.c.revoked_at.is_(None), shares.c.expires_at > now()


def require(connection: Connection, tenant: Tenant, share_id: str) -> ShareRow:
    """Return a link's row, revoked or not."""
    return resources.require(connection, tenant, ShareRow, "share", share_id)


def revoke(connection: Connection, tenant: Tenant, share_id: str) -> None:
    """Revoke a link; repeating it changes nothing."""
    require(connection, tenant, share_id)
    statement = change(tenant, shares).where(shares.c.id == share_id, shares.c.revoked_at.is_(None))
    connection.execute(statement.values(revoked_at=now()))


def signed(connection: Connection, secret: str, token: str) -> FoundShare | None:
    """Return the share of a token, active or ended, or None if the token is forged or long forgotten."""
    match = _TOKEN.fullmatch(token)
    if match is None:
        return None
    row = find_any(connection, match.group(1))
    if row is None:
        return None
    return row if hmac.compare_digest(sign(secret, row), token) else None


def find_any(connection: Connection, share_id: str) -> FoundShare | None:
    """Return a share of any tenant, active or not, with when its organisation was closed, or None.

    Its id without the secret grants no read.
    """
    organisation = organisations.c.tenant_id == shares.c.tenant_id
    statement = (
        across_tenants(shares, *shares.c, organisations.c.closed_at)
        .select_from(shares)
        .join(organisations, organisation)
        .where(shares.c.id == share_id)
    )
    row = one(connection, statement, FoundShare)
    if row is None:
        return None
    scopes = scopes_of_maker(connection, Tenant(row.tenant_id), maker_of(row))
    return replace(row, maker_may=SUBMIT in scopes)


def is_active(row: FoundShare) -> bool:
    """Return whether a link of `find_any` works.

    It has not ended, its organisation is not closed, and whoever made it could make another one now.
    """
    has_ended = row.revoked_at is not None or row.expires_at <= now()
    return not has_ended and row.closed_at is None and row.maker_may


def is_token(text: str) -> bool:
    """Return whether a bearer token has the form of a link's secret; keys have another."""
    return _TOKEN.fullmatch(text) is not None


def frame_ancestors(row: ShareRow) -> list[str]:
    """Return the origins whose pages may show the bundle of a link."""
    return (row.frame_ancestors or "").split()


def is_named_by_a_link(connection: Connection, bundle_id: str, origin: str) -> bool:
    """Return whether a link, active or ended, names an origin whose pages may show a bundle."""
    links = many(connection, across_tenants(shares).where(shares.c.bundle_id == bundle_id), ShareRow)
    return any(origin in frame_ancestors(row) for row in links)
