"""Keys for programs; managing them requires a key."""

from fastapi import APIRouter, Request, Response

from lambent_server import keys
from lambent_server.keys import CreatedKey, KeyList, NewKey
from lambent_server.problems import Problem
from lambent_server.routes.common import Id, ServicesOf, TenantOf, problems

router = APIRouter(tags=["keys"])


def _require_key(request: Request) -> None:
    """Refuse a browser session: taking one over briefly must not yield a lasting key."""
    if not request.state.by_key:
        raise Problem(403, "key_needed", "managing keys requires a key; a browser session is not enough")


@router.post("/v1/keys", status_code=201, responses=problems(400, 403, 413, 422))
def create_key(services: ServicesOf, tenant: TenantOf, request: Request, body: NewKey) -> CreatedKey:
    """Create a key; only this response contains its secret."""
    _require_key(request)
    with services.database.write() as connection:
        return keys.create(connection, tenant, body)


@router.get("/v1/keys", responses=problems(403))
def list_keys(services: ServicesOf, tenant: TenantOf, request: Request) -> KeyList:
    """List the keys, newest first, including revoked ones."""
    _require_key(request)
    with services.database.read() as connection:
        return KeyList(items=[keys.show(row) for row in keys.known(connection, tenant)])


@router.delete("/v1/keys/{key_id:id}", status_code=204, response_class=Response, responses=problems(403, 404))
def revoke_key(services: ServicesOf, tenant: TenantOf, request: Request, key_id: Id) -> Response:
    """Revoke a key permanently, and log out every browser."""
    _require_key(request)
    with services.database.write() as connection:
        keys.revoke(connection, tenant, key_id)
    return Response(status_code=204)


@router.post("/v1/keys/{key_id:id}:rotate", status_code=201, responses=problems(403, 404, 409))
def rotate_key(services: ServicesOf, tenant: TenantOf, request: Request, key_id: Id) -> CreatedKey:
    """Replace this key with a new one; it is revoked at once."""
    _require_key(request)
    with services.database.write() as connection:
        return keys.rotate(connection, tenant, key_id, services.settings.data)
