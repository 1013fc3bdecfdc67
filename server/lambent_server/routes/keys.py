"""Keys for programs; only who has a key may make, see and revoke keys."""

from fastapi import APIRouter, Request, Response

from lambent_server import keys
from lambent_server.keys import CreatedKey, KeyList, NewKey
from lambent_server.problems import Problem
from lambent_server.routes.common import Id, ServicesOf, TenantOf, problems

router = APIRouter(tags=["keys"])


def _require_key(request: Request) -> None:
    """Refuse a browser: who takes over a session for a moment must not leave with a key that lasts."""
    if not request.state.by_key:
        raise Problem(403, "key_needed", "keys are managed with a key, not with a browser's session")


@router.post("/v1/keys", status_code=201, responses=problems(400, 403, 413, 422))
def create_key(services: ServicesOf, tenant: TenantOf, request: Request, body: NewKey) -> CreatedKey:
    """Make a key; the answer is the only one that shows it."""
    _require_key(request)
    with services.database.write() as connection:
        return keys.create(connection, tenant, body)


@router.get("/v1/keys", responses=problems(403))
def list_keys(services: ServicesOf, tenant: TenantOf, request: Request) -> KeyList:
    """List the keys, the newest first, with those that are revoked."""
    _require_key(request)
    with services.database.read() as connection:
        return KeyList(items=[keys.show(row) for row in keys.known(connection, tenant)])


@router.delete("/v1/keys/{key_id:id}", status_code=204, response_class=Response, responses=problems(403, 404))
def revoke_key(services: ServicesOf, tenant: TenantOf, request: Request, key_id: Id) -> Response:
    """Take a key back for good, and log every browser out."""
    _require_key(request)
    with services.database.write() as connection:
        keys.revoke(connection, tenant, key_id)
    return Response(status_code=204)


@router.post("/v1/keys/{key_id:id}:rotate", status_code=201, responses=problems(403, 404, 409))
def rotate_key(services: ServicesOf, tenant: TenantOf, request: Request, key_id: Id) -> CreatedKey:
    """Make a key in place of this one, which is revoked at once."""
    _require_key(request)
    with services.database.write() as connection:
        return keys.rotate(connection, tenant, key_id, services.settings.data)
