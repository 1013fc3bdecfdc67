"""Files of scenes that clients send directly to the store: addresses for them, and their completion."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

from fastapi import APIRouter

from lambent_server.accounts import quotas
from lambent_server.accounts.admission import Admission
from lambent_server.api.json_bodies import StrictRoute
from lambent_server.api.problems import Problem, invalid
from lambent_server.core.metrics import DIRECT_BYTES
from lambent_server.database.schema import scene_files
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.http.common import Id, ServicesOf, TenantOf, WhoOf, problems
from lambent_server.receiving.direct import direct_uploads
from lambent_server.scenes import rows as scene_rows
from lambent_server.services import Services
from lambent_server.storage.messages import (
    FileUpload,
    RefusedFile,
    TakenFiles,
    UploadedFiles,
    UploadList,
)
from lambent_server.storage.store import Blob

router = APIRouter(tags=["scenes"], route_class=StrictRoute)

MEDIA_TYPE = "application/octet-stream"


def offers(services: Services, tenant: Tenant, wanted: Mapping[str, int]) -> list[FileUpload]:
    """Return where to send files, by hash and size in bytes; they count for the quota from now on."""
    direct = direct_uploads(services.store, services.settings)
    if direct is None or not wanted:
        return []
    with services.database.write() as connection:
        quotas.reserve_bytes(connection, tenant, services.settings, wanted, refuse=True)
    return direct.offers(tenant, wanted)


def _planned(services: Services, tenant: Tenant, scene_id: str, hashes: list[str]) -> dict[str, int]:
    """Return the sizes of planned files; raises `file_not_planned` for any other."""
    with services.database.read() as connection:
        scene_rows.require_open(scene_rows.require_scene(connection, tenant, scene_id))
        planned = rows(tenant, scene_files, scene_files.c.sha256, scene_files.c.size_bytes).where(
            scene_files.c.scene_id == scene_id, scene_files.c.sha256.in_(hashes)
        )
        sizes = {sha256: int(size) for sha256, size in connection.execute(planned)}
    for place, sha256 in enumerate(hashes):
        if sha256 not in sizes:
            pointer = f"#/sha256/{place}"
            raise invalid("file_not_planned", pointer, "no planned file of this scene has this hash")
    return sizes


@router.post("/v1/scenes/{scene_id:id}/files:uploads", responses=problems(400, 404, 409, 413, 422, 507))
def offer_uploads(services: ServicesOf, tenant: TenantOf, scene_id: Id, body: UploadedFiles) -> UploadList:
    """Return addresses of the store for planned files, or new ones instead of those that have expired.

    Parts of a large file that were sent before are left out.
    """
    return UploadList(items=offers(services, tenant, _planned(services, tenant, scene_id, body.sha256)))


@router.post("/v1/scenes/{scene_id:id}/files:complete", responses=problems(400, 404, 409, 413, 422))
def complete_uploads(
    services: ServicesOf, tenant: TenantOf, who: WhoOf, scene_id: Id, body: UploadedFiles
) -> TakenFiles:
    """Take over planned files that were sent to the store. Repeating it changes nothing."""
    with services.database.read() as connection:
        scene_rows.require_scene(connection, tenant, scene_id)
    direct = direct_uploads(services.store, services.settings)
    if direct is None:
        raise Problem(409, "not_direct", "this server takes files itself; PUT them to .../files/{sha256}")
    sizes = _planned(services, tenant, scene_id, body.sha256)
    admission = Admission(who=who, settings=services.settings, action="complete_uploads")

    def take(sha256: str) -> RefusedFile | None:
        try:
            blob = Blob(sha256, sizes[sha256], MEDIA_TYPE)
            if direct.accept(services.database.write, tenant, blob, admission):
                DIRECT_BYTES.inc(blob.size_bytes)
        except Problem as problem:
            return RefusedFile(sha256=sha256, code=problem.code, detail=problem.detail)
        return None

    with ThreadPoolExecutor(8) as pool:
        refused = [each for each in pool.map(take, sizes) if each is not None]
    failed = {each.sha256 for each in refused}
    return TakenFiles(stored=[sha256 for sha256 in sizes if sha256 not in failed], refused=refused)
