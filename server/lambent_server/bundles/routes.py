"""Bundles: lists, and links that share one of them."""

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from lambent_server.accounts import audit, keys, shares
from lambent_server.api.change_messages import BundleChange
from lambent_server.api.idempotency import made_before
from lambent_server.api.labels import having
from lambent_server.api.pagination import LabelFilter, LongPageFilter, select_newest
from lambent_server.api.resources import IdempotencyKey, IfMatch, ResourceRoute, digest_of, require_match
from lambent_server.bundles import rows as bundle_rows
from lambent_server.bundles.messages import BundleDetail, BundleList, NewShare, Share, ShareList
from lambent_server.core.clock import new_id, now
from lambent_server.database.model import BundleRow, ShareRow
from lambent_server.database.schema import bundles
from lambent_server.http.common import Id, ServicesOf, TenantOf, WhoOf, problems
from lambent_server.jobs import removals

router = APIRouter(tags=["bundles"], route_class=ResourceRoute)


@router.get("/v1/bundles", responses=problems(422))
def list_bundles(
    services: ServicesOf, tenant: TenantOf, given: Annotated[LabelFilter, Query()]
) -> BundleList:
    """List bundles, newest first."""
    with services.database.read() as connection:
        page, cursor = select_newest(
            connection, tenant, BundleRow, *having(tenant, bundles.c.id, given.label), page=given
        )
        items = bundle_rows.show_all(connection, tenant, page)
    return BundleList(items=items, next_cursor=cursor)


@router.get("/v1/bundles/{bundle_id:id}", responses=problems(404))
def get_bundle(services: ServicesOf, tenant: TenantOf, bundle_id: Id) -> BundleDetail:
    """Return a bundle with its files."""
    with services.database.read() as connection:
        row = bundle_rows.require_bundle(connection, tenant, bundle_id)
        return bundle_rows.show_files(connection, tenant, row)


@router.patch("/v1/bundles/{bundle_id:id}", responses=problems(400, 403, 404, 412, 413, 422))
def change_bundle(
    services: ServicesOf,
    tenant: TenantOf,
    who: WhoOf,
    bundle_id: Id,
    body: BundleChange,
    if_match: IfMatch = None,
) -> BundleDetail:
    """Change the labels of a bundle."""
    with audit.recorded(services.database, who, "change_bundle", bundle_id) as connection:
        row = bundle_rows.require_bundle(connection, tenant, bundle_id, lock=True)
        require_match(if_match, bundle_rows.show_files(connection, tenant, row))
        changed = bundle_rows.change_bundle(connection, tenant, row, body)
        return bundle_rows.show_files(connection, tenant, changed)


@router.delete(
    "/v1/bundles/{bundle_id:id}", status_code=204, response_class=Response, responses=problems(403, 404, 409)
)
def delete_bundle(services: ServicesOf, tenant: TenantOf, who: WhoOf, bundle_id: Id) -> None:
    """Delete a bundle with its files and the links to it; the job that made it stays."""
    with audit.recorded(services.database, who, "delete_bundle", bundle_id) as connection:
        removals.delete_bundle(connection, tenant, bundle_id)


def _secret(request: Request) -> str:
    secret: str = request.app.state.share_secret
    return secret


def _show(request: Request, row: ShareRow) -> Share:
    base = str(request.base_url).rstrip("/")
    url = f"{base}{shares.page_path(row.id)}#{shares.sign(_secret(request), row)}"
    return Share.of(row, url=url, frame_ancestors=shares.frame_ancestors(row))


@router.post(
    "/v1/bundles/{bundle_id:id}/shares", status_code=201, responses=problems(400, 403, 404, 413, 422)
)
def create_share(
    services: ServicesOf,
    tenant: TenantOf,
    who: WhoOf,
    bundle_id: Id,
    request: Request,
    body: NewShare,
    key: IdempotencyKey = None,
) -> Share:
    """Create a link that gives everyone who has it read access to this bundle only, until it expires."""
    with services.database.write() as connection:
        bundle_rows.require_bundle(connection, tenant, bundle_id)
        identifier, digest = new_id("share"), digest_of("share", bundle_id, body)
        known = made_before(connection, tenant, key, digest, identifier)
        if known is not None:
            return _show(request, shares.require(connection, tenant, known))
        lifetime_s: float = body.expires_in_s
        if (until := keys.end_of(connection, who)) is not None:
            # A link lasts no longer than the key that makes it.
            lifetime_s = min(lifetime_s, until - now())
        order = (lifetime_s, body.frame_ancestors, identifier)
        made = shares.create(connection, tenant, bundle_id, *order, maker=who.maker)
        audit.record(connection, who, "create_share", bundle_id, details={"share": identifier})
        return _show(request, made)


@router.get("/v1/bundles/{bundle_id:id}/shares", responses=problems(404, 422))
def list_shares(
    services: ServicesOf,
    tenant: TenantOf,
    bundle_id: Id,
    request: Request,
    given: Annotated[LongPageFilter, Query()],
) -> ShareList:
    """List the active links of a bundle, newest first."""
    with services.database.read() as connection:
        bundle_rows.require_bundle(connection, tenant, bundle_id)
        page, cursor = select_newest(connection, tenant, ShareRow, *shares.working(bundle_id), page=given)
    return ShareList(items=[_show(request, row) for row in page], next_cursor=cursor)


@router.delete(
    "/v1/shares/{share_id:id}", status_code=204, response_class=Response, responses=problems(403, 404)
)
def revoke_share(services: ServicesOf, tenant: TenantOf, who: WhoOf, share_id: Id) -> None:
    """Revoke a link, with immediate effect for everyone who has opened it."""
    with audit.recorded(services.database, who, "revoke_share", share_id) as connection:
        shares.revoke(connection, tenant, share_id)
