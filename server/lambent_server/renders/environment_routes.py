"""Environments: light from all directions, as OpenEXR or Radiance HDR."""

from typing import Annotated

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response
from sqlalchemy import Connection

from lambent_server.accounts import audit
from lambent_server.accounts.admission import Admission
from lambent_server.accounts.who import Who
from lambent_server.api.idempotency import made_before
from lambent_server.api.messages import Environment, EnvironmentList
from lambent_server.api.pagination import LongPageFilter, select_newest
from lambent_server.api.resources import IdempotencyKey, ResourceRoute, digest_of, require
from lambent_server.core.clock import new_id, now
from lambent_server.database.model import EnvironmentRow
from lambent_server.database.schema import environments
from lambent_server.database.tenancy import Tenant, add
from lambent_server.http.common import Id, ServicesOf, TenantOf, WhoOf, binary_body, problems
from lambent_server.jobs import removals
from lambent_server.receiving.uploads import Upload, allowance_of, received, storing
from lambent_server.services import Services
from lambent_server.storage.decoding import environment_head
from lambent_server.storage.disk_space import Allowance
from lambent_server.storage.environment_files import MEDIA_TYPES

router = APIRouter(tags=["environments"], route_class=ResourceRoute)


def _show(row: EnvironmentRow) -> Environment:
    return Environment.of(row, url=f"/v1/blobs/{row.sha256}")


@router.post(
    "/v1/environments",
    status_code=201,
    openapi_extra=binary_body("image/x-exr", "image/vnd.radiance", "application/octet-stream"),
    responses=problems(400, 408, 413, 422, 503, 507),
)
async def create_environment(
    services: ServicesOf,
    tenant: TenantOf,
    who: WhoOf,
    request: Request,
    name: Annotated[str, Query(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f]+$")],
    key: IdempotencyKey = None,
) -> Environment:
    """Upload an environment map; only its header is checked before a job reads its pixels.

    Light probes and cubes are converted to latitude-longitude by the job, which may state the layout.
    """
    allowance = await to_thread.run_sync(_allowance, services, tenant)
    max_bytes = services.settings.max_environment_bytes
    async with received(services, request, tenant, max_bytes, allowance) as upload:
        return await services.decoders.run(tenant.id, who.client, _take, services, who, name, upload, key)


def _allowance(services: Services, tenant: Tenant) -> Allowance | None:
    with services.database.read() as connection:
        return allowance_of(connection, services, tenant)


def _take(services: Services, who: Who, name: str, upload: Upload, key: str | None) -> Environment:
    head, tenant = environment_head(upload.path, services.settings), who.tenant
    admission = Admission(who=who, settings=services.settings, action="create_environment")
    sent = (upload.path, upload.sha256, MEDIA_TYPES[head.format], admission)
    with storing(services, upload.path):
        services.store.put_file(services.database.write, tenant, *sent)
    identifier, digest = new_id("env"), digest_of("environment", name, upload.sha256)
    with services.database.write() as connection:
        known = made_before(connection, tenant, key, digest, identifier)
        if known is not None:
            return _show(_require(connection, tenant, known))
        connection.execute(
            add(
                tenant,
                environments,
                id=identifier,
                name=name,
                format=head.format,
                width=head.width,
                height=head.height,
                sha256=upload.sha256,
                size_bytes=float(upload.size_bytes),
                created_at=now(),
            )
        )
        audit.record(connection, who, "create_environment", identifier)
        return _show(_require(connection, tenant, identifier))


def _require(connection: Connection, tenant: Tenant, environment_id: str) -> EnvironmentRow:
    return require(connection, tenant, EnvironmentRow, "environment", environment_id)


@router.get("/v1/environments", responses=problems(422))
def list_environments(
    services: ServicesOf, tenant: TenantOf, given: Annotated[LongPageFilter, Query()]
) -> EnvironmentList:
    """List the environments, newest first."""
    with services.database.read() as connection:
        page, cursor = select_newest(connection, tenant, EnvironmentRow, page=given)
    return EnvironmentList(items=[_show(row) for row in page], next_cursor=cursor)


@router.get("/v1/environments/{environment_id:id}", responses=problems(404))
def get_environment(services: ServicesOf, tenant: TenantOf, environment_id: Id) -> Environment:
    """Return an environment."""
    with services.database.read() as connection:
        return _show(_require(connection, tenant, environment_id))


@router.delete(
    "/v1/environments/{environment_id:id}",
    status_code=204,
    response_class=Response,
    responses=problems(403, 404, 409),
)
def delete_environment(services: ServicesOf, tenant: TenantOf, who: WhoOf, environment_id: Id) -> None:
    """Delete an environment; pictures that were rendered with it stay."""
    with audit.recorded(services.database, who, "delete_environment", environment_id) as connection:
        removals.delete_environment(connection, tenant, environment_id)
