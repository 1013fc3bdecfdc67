"""Environments: light from all directions, as OpenEXR or Radiance HDR."""

from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response

from lambent_server import removals
from lambent_server.clock import new_id, now, rfc3339
from lambent_server.database.schema import environments
from lambent_server.database.tenancy import Tenant, add, find, rows
from lambent_server.environment_files import read_head
from lambent_server.messages import Environment, EnvironmentList
from lambent_server.routes.common import Id, ServicesOf, TenantOf, binary_body, problems
from lambent_server.services import Services
from lambent_server.uploads import Upload, received

router = APIRouter(tags=["environments"])


def _show(row: Any) -> Environment:
    names = ["id", "name", "format", "width", "height", "sha256", "size_bytes"]
    return Environment(
        **{name: row[name] for name in names},
        created_at=rfc3339(row["created_at"]),
        url=f"/v1/blobs/{row['sha256']}",
    )


@router.post(
    "/v1/environments",
    status_code=201,
    openapi_extra=binary_body("image/x-exr", "image/vnd.radiance", "application/octet-stream"),
    responses=problems(400, 408, 413, 422, 507),
)
async def create_environment(
    services: ServicesOf,
    tenant: TenantOf,
    request: Request,
    name: Annotated[str, Query(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f]+$")],
) -> Environment:
    """Upload a latitude-longitude picture; only its header is checked before a job reads its pixels."""
    async with received(services, request, services.settings.max_environment_bytes) as upload:
        return await to_thread.run_sync(_take, services, tenant, name, upload)


def _take(services: Services, tenant: Tenant, name: str, upload: Upload) -> Environment:
    head = read_head(upload.path, services.settings.max_environment_pixels)
    services.store.put_file(services.database.write, tenant, upload.path, upload.sha256, head.media_type)
    identifier = new_id("env")
    with services.database.write() as connection:
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
        return _show(find(connection, tenant, environments, identifier))


@router.get("/v1/environments", responses=problems())
def list_environments(services: ServicesOf, tenant: TenantOf) -> EnvironmentList:
    """List the environments, newest first."""
    with services.database.read() as connection:
        statement = rows(tenant, environments).order_by(environments.c.id.desc()).limit(1000)
        return EnvironmentList(items=[_show(row) for row in connection.execute(statement).mappings()])


@router.delete(
    "/v1/environments/{environment_id:id}",
    status_code=204,
    response_class=Response,
    responses=problems(403, 404, 409),
)
def delete_environment(services: ServicesOf, tenant: TenantOf, environment_id: Id) -> Response:
    """Delete an environment; pictures that were rendered with it stay."""
    with services.database.write() as connection:
        removals.delete_environment(connection, tenant, environment_id)
    return Response(status_code=204)
