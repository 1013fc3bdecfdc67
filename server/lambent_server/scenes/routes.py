"""Scenes: plan, upload missing files and commit, or upload one archive."""

import re
import tempfile
from pathlib import Path
from typing import Annotated, Any, Literal

from anyio import to_thread
from fastapi import APIRouter, Body, Query, Request, Response

from lambent_server.accounts import audit, quotas
from lambent_server.accounts.admission import Admission
from lambent_server.accounts.who import Who
from lambent_server.api.change_messages import SceneChange
from lambent_server.api.labels import having
from lambent_server.api.messages import NewScene, PlannedFile, Scene, SceneList, SceneReportAnswer
from lambent_server.api.pagination import LabelFilter, select_newest
from lambent_server.api.problems import Problem, invalid
from lambent_server.api.resources import IdempotencyKey, IfMatch, ResourceRoute, digest_of, require_match
from lambent_server.database.model import FiguresRow, SceneRow
from lambent_server.database.schema import scene_files, scenes
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.http.common import Id, ServicesOf, Sha, TenantOf, WhoOf, binary_body, problems
from lambent_server.receiving.uploads import ArchiveRoom, Upload, allowance_of, received, storing
from lambent_server.scenes import rows as scene_rows
from lambent_server.scenes.figures import find_figures
from lambent_server.scenes.rows import SceneFile
from lambent_server.scenes.upload_routes import offers
from lambent_server.services import Services
from lambent_server.storage.archives import unpack
from lambent_server.storage.disk_space import Allowance
from lambent_server.storage.messages import Plan
from lambent_server.storage.store import find_blob

router = APIRouter(tags=["scenes"], route_class=ResourceRoute)

FIRST_UPLOADS = 50
"""Files for which a plan has addresses of the store; `files:uploads` gives those of others."""


@router.post("/v1/scenes", status_code=201, responses=problems(400, 413, 422, 507))
def create_scene(
    services: ServicesOf, tenant: TenantOf, who: WhoOf, body: NewScene, key: IdempotencyKey = None
) -> Scene:
    """Create an empty scene."""
    services.require_disk()
    with services.database.write() as connection:
        scene = scene_rows.create(connection, tenant, body, key, digest_of("scene", body))
        audit.record(connection, who, "create_scene", scene.id)
        return scene_rows.show(scene)


@router.get("/v1/scenes", responses=problems(422))
def list_scenes(services: ServicesOf, tenant: TenantOf, given: Annotated[LabelFilter, Query()]) -> SceneList:
    """List scenes, newest first."""
    with services.database.read() as connection:
        page, cursor = select_newest(
            connection, tenant, SceneRow, *having(tenant, scenes.c.id, given.label), page=given
        )
    return SceneList(items=[scene_rows.show(row) for row in page], next_cursor=cursor)


@router.post("/v1/scenes/{scene_id:id}/files:plan", responses=problems(400, 404, 409, 413, 422))
def plan_files(
    services: ServicesOf,
    tenant: TenantOf,
    who: WhoOf,
    scene_id: Id,
    body: Annotated[list[PlannedFile], Body(max_length=1_000_000)],
) -> Plan:
    """Declare the files of the scene; the response lists those that the server lacks or that are damaged.

    A new plan replaces the previous one. If files can be sent directly to the store, the response has
    addresses for the first ones.
    """
    files = [SceneFile(file.path, file.sha256, file.size) for file in body]
    with services.database.write() as connection:
        scene = scene_rows.require_scene(connection, tenant, scene_id, lock=True)
        scene_rows.require_open(scene)
        scene_rows.check_files(files, services.settings)
        plan = scene_rows.plan(connection, tenant, scene, files)
        sizes = {file.sha256: file.size_bytes for file in files}
        new_bytes = sum(sizes[sha256] for sha256 in plan.missing)
        quotas.check_bytes(connection, tenant, services.settings, float(new_bytes), of=set(plan.missing))
        audit.record(connection, who, "plan_files", scene_id, details={"files": len(files)})
    missing = sorted({*plan.missing, *services.store.damaged(plan.known)})
    first = offers(services, tenant, {sha256: sizes[sha256] for sha256 in missing[:FIRST_UPLOADS]})
    return Plan(missing=missing, unsupported=plan.unsupported, uploads=first)


@router.put(
    "/v1/scenes/{scene_id:id}/files/{sha256}",
    status_code=204,
    response_class=Response,
    openapi_extra=binary_body("application/octet-stream"),
    responses=problems(400, 404, 408, 409, 413, 422, 507),
)
async def put_file(
    services: ServicesOf, tenant: TenantOf, who: WhoOf, scene_id: Id, sha256: Sha, request: Request
) -> None:
    """Upload a planned file under its hash; repeating it changes nothing."""
    size, allowance = await to_thread.run_sync(_planned_size, services, tenant, scene_id, sha256)
    async with received(services, request, tenant, size, allowance) as upload:
        if upload.sha256 != sha256:
            raise invalid(
                "digest_mismatch", "#", f"the body has the hash {upload.sha256}, the path says {sha256}"
            )
        await to_thread.run_sync(_store, services, who, upload.path, sha256, "put_file")


def _planned_size(
    services: Services, tenant: Tenant, scene_id: str, sha256: str
) -> tuple[int, Allowance | None]:
    """Return the size of a planned file, and what the quota allows: it ignores a file that is stored."""
    with services.database.read() as connection:
        scene_rows.require_open(scene_rows.require_scene(connection, tenant, scene_id))
        planned = rows(tenant, scene_files, scene_files.c.size_bytes).where(
            scene_files.c.scene_id == scene_id, scene_files.c.sha256 == sha256
        )
        size = connection.execute(planned.limit(1)).scalar_one_or_none()
        if size is None:
            raise invalid("file_not_planned", "#/path/sha256", "no planned file of this scene has this hash")
        if find_blob(connection, tenant, sha256) is not None:
            return int(size), None
        return int(size), allowance_of(connection, services, tenant, sha256)


def _store(services: Services, who: Who, path: Path, sha256: str, action: str) -> None:
    admission = Admission(who=who, settings=services.settings, action=action)
    write, media_type = services.database.write, "application/octet-stream"
    with storing(services, path):
        services.store.put_file(write, who.tenant, path, sha256, media_type, admission)


@router.put(
    "/v1/scenes/{scene_id:id}/archive",
    openapi_extra=binary_body(
        "application/zip", "application/x-tar", "application/gzip", "application/octet-stream"
    ),
    responses=problems(400, 404, 408, 409, 413, 422, 503, 507),
)
async def put_archive(
    services: ServicesOf, tenant: TenantOf, who: WhoOf, scene_id: Id, request: Request
) -> Scene:
    """Upload the scene as zip, tar or tar.gz; it is committed once the archive has passed all checks."""
    allowance = await to_thread.run_sync(_require_open, services, tenant, scene_id)
    async with received(services, request, tenant, services.settings.max_scene_bytes, allowance) as upload:
        return await services.decoders.run(
            tenant.id, who.client, _take_archive, services, who, scene_id, upload
        )


def _require_open(services: Services, tenant: Tenant, scene_id: str) -> Allowance | None:
    """Refuse a scene that takes no files any more, and return what the quota allows."""
    with services.database.read() as connection:
        scene_rows.require_open(scene_rows.require_scene(connection, tenant, scene_id))
        return allowance_of(connection, services, tenant)


def _take_archive(services: Services, who: Who, scene_id: str, upload: Upload) -> Scene:
    tenant = who.tenant
    with (
        tempfile.TemporaryDirectory(dir=services.settings.scratch) as name,
        services.space.body(tenant.id) as body,
    ):
        try:
            room = ArchiveRoom(services, tenant, body)
            members, left_out = unpack(upload.path, Path(name), services.settings, room)
        except Problem as problem:
            if problem.retryable:
                raise
            with services.database.write() as connection:
                scene = scene_rows.require_scene(connection, tenant, scene_id, lock=True)
                scene_rows.require_open(scene)
                subject = problem.errors[0].pointer.removeprefix("#").removeprefix("/")
                scene_rows.reject(connection, tenant, scene, problem.code, problem.detail, subject)
                audit.record(connection, who, "put_archive", scene_id, outcome=problem.code)
            raise
        for member in members:
            _store(services, who, member.file, member.sha256, "put_archive")
        with services.database.write() as connection:
            scene = scene_rows.require_scene(connection, tenant, scene_id, lock=True)
            files = [SceneFile(member.path, member.sha256, member.size_bytes) for member in members]
            extra = [SceneFile(path, "", 0) for path in left_out]
            scene_rows.plan(connection, tenant, scene, files + extra)
            committed = scene_rows.commit(connection, tenant, scene)
            audit.record(connection, who, "put_archive", scene_id, details={"files": len(files)})
            return scene_rows.show(committed)


@router.post("/v1/scenes/{scene_id:id}:commit", responses=problems(404, 409))
def commit_scene(services: ServicesOf, tenant: TenantOf, who: WhoOf, scene_id: Id) -> Scene:
    """Finish the upload; every planned file must have been sent. Repeating it changes nothing."""
    with audit.recorded(services.database, who, "commit_scene", scene_id) as connection:
        scene = scene_rows.require_scene(connection, tenant, scene_id, lock=True)
        committed = scene_rows.commit(connection, tenant, scene)
        return scene_rows.show(committed)


@router.get("/v1/scenes/{scene_id:id}", responses=problems(404))
def get_scene(services: ServicesOf, tenant: TenantOf, scene_id: Id) -> Scene:
    """Return a scene."""
    with services.database.read() as connection:
        return scene_rows.show(scene_rows.require_scene(connection, tenant, scene_id))


@router.patch("/v1/scenes/{scene_id:id}", responses=problems(400, 403, 404, 412, 413, 422))
def change_scene(
    services: ServicesOf,
    tenant: TenantOf,
    who: WhoOf,
    scene_id: Id,
    body: SceneChange,
    if_match: IfMatch = None,
) -> Scene:
    """Change the name or the labels of a scene."""
    with audit.recorded(services.database, who, "change_scene", scene_id) as connection:
        scene = scene_rows.require_scene(connection, tenant, scene_id, lock=True)
        require_match(if_match, scene_rows.show(scene))
        changed = scene_rows.change_scene(connection, tenant, scene, body)
        return scene_rows.show(changed)


@router.delete(
    "/v1/scenes/{scene_id:id}", status_code=204, response_class=Response, responses=problems(404, 409)
)
def delete_scene(services: ServicesOf, tenant: TenantOf, who: WhoOf, scene_id: Id) -> None:
    """Delete a scene and its files; bundles made from it stay."""
    with audit.recorded(services.database, who, "delete_scene", scene_id) as connection:
        scene_rows.delete(
            connection, tenant, scene_rows.require_scene(connection, tenant, scene_id, lock=True)
        )


_PAGE: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The report; as a page if requested.",
        "content": {"text/html": {"schema": {"type": "string"}}},
    }
}


@router.get(
    "/v1/scenes/{scene_id:id}/report",
    response_model=SceneReportAnswer,
    responses={**problems(404, 410, 422), **_PAGE},
)
def get_scene_report(
    services: ServicesOf,
    tenant: TenantOf,
    scene_id: Id,
    request: Request,
    response: Response,
    as_: Annotated[Literal["json", "html"] | None, Query(alias="format")] = None,
) -> Any:
    """Return the report of a scene: findings with what to fix, and measurements.

    `format=html`, or an Accept header that prefers text/html, asks for a page with thumbnails.
    """
    with services.database.read() as connection:
        scene = scene_rows.require_scene(connection, tenant, scene_id)
        figures = find_figures(connection, tenant, scene_id)
    if as_ == "html" or (as_ is None and prefers_html(request.headers.get("accept", ""))):
        return _page_of(services, scene, figures)
    response.headers["vary"] = "accept"
    return report_of(scene, figures)


def _page_of(services: Services, scene: SceneRow, figures: FiguresRow | None) -> Response:
    if figures is None or not figures.sha256:
        raise Problem(
            404,
            "report_page_not_found",
            f"scene {scene.id} has no page: it is {scene.state}, and pages are made of scenes that "
            "were looked at and can be used; ask for format=json",
        )
    page = services.store.read_all(figures.sha256)
    # A page made from untrusted content: no scripts, nothing from outside, no access to this site.
    policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox"
    headers = {"content-security-policy": policy, "vary": "accept", "cache-control": "private, no-cache"}
    return Response(page, media_type="text/html; charset=utf-8", headers=headers)


def prefers_html(accept: str) -> bool:
    """Return whether an Accept header names text/html and does not prefer JSON (RFC 9110, 12.5.1)."""
    weights: dict[str, float] = {}
    for item in accept.split(","):
        kind, *parameters = (part.strip().lower() for part in item.split(";"))
        quality = next((part[2:] for part in parameters if part.startswith("q=")), "1")
        weights[kind] = float(quality) if re.fullmatch(r"[01](\.\d{0,3})?", quality) else 0.0
    others = (weights.get(kind, 0.0) for kind in ("application/json", "application/*", "*/*"))
    return weights.get("text/html", 0.0) > next((weight for weight in others if weight), 0.0)


def report_of(scene: SceneRow, figures: FiguresRow | None) -> SceneReportAnswer:
    """Return the report of a scene's row and that of its figures."""
    report = scene.report or scene_rows.unchecked_report()
    return SceneReportAnswer(
        scene_id=scene.id,
        state=scene.state,
        checked=scene.state in ("ready", "rejected"),
        **{"figures": None if figures is None else figures.figures, **report},
    )
