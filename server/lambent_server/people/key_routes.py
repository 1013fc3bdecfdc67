"""Keys for programs; managing them requires a key."""

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from lambent_server.accounts import audit, keys
from lambent_server.accounts.keys import CreatedKey, KeyList, NewKey
from lambent_server.api.pagination import LongPageFilter, select_newest
from lambent_server.api.resources import IdempotencyKey, ResourceRoute, digest_of
from lambent_server.database.model import KeyRow
from lambent_server.http.common import Id, ServicesOf, TenantOf, WhoOf, problems, require_key

router = APIRouter(tags=["keys"], route_class=ResourceRoute)


_WHAT = "managing keys"


@router.post("/v1/keys", status_code=201, responses=problems(400, 403, 413, 422))
def create_key(
    services: ServicesOf,
    tenant: TenantOf,
    who: WhoOf,
    request: Request,
    body: NewKey,
    key: IdempotencyKey = None,
) -> CreatedKey:
    """Create a key that may do no more, and is valid no longer, than the one that makes it.

    Only this response contains its secret.
    """
    require_key(request, _WHAT)
    with services.database.write() as connection:
        made = keys.create(connection, tenant, body, key, digest_of("key", body), maker=who)
        audit.record(connection, who, "create_key", made.id, details={"scopes": list(made.scopes)})
        return made


@router.get("/v1/keys", responses=problems(403, 422))
def list_keys(
    services: ServicesOf, tenant: TenantOf, request: Request, given: Annotated[LongPageFilter, Query()]
) -> KeyList:
    """List the keys, newest first, including revoked ones."""
    require_key(request, _WHAT)
    with services.database.read() as connection:
        page, cursor = select_newest(connection, tenant, KeyRow, page=given)
    return KeyList(items=[keys.show(row) for row in page], next_cursor=cursor)


@router.delete("/v1/keys/{key_id:id}", status_code=204, response_class=Response, responses=problems(403, 404))
def revoke_key(services: ServicesOf, tenant: TenantOf, who: WhoOf, request: Request, key_id: Id) -> None:
    """Revoke a key permanently, with all that it has made, and log out every browser."""
    require_key(request, _WHAT)
    with audit.recorded(services.database, who, "revoke_key", key_id) as connection:
        keys.revoke(connection, tenant, key_id)


@router.post("/v1/keys/{key_id:id}:rotate", status_code=201, responses=problems(403, 404, 409))
def rotate_key(
    services: ServicesOf, tenant: TenantOf, who: WhoOf, request: Request, key_id: Id
) -> CreatedKey:
    """Replace this key with a new one; it is revoked at once, with the keys that it made."""
    require_key(request, _WHAT)
    with services.database.write() as connection:
        made = keys.rotate(connection, tenant, key_id, who)
        audit.record(connection, who, "rotate_key", key_id, details={"key": made.id})
    keys.keep_in_file(services.settings.data, made)
    return made
