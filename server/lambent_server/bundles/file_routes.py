"""Bundles, artifacts and previews."""

import hashlib
import re
from collections.abc import Iterator
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import StreamingResponse
from lambent_pages import is_named
from zipstream import ZipStream

from lambent_server.api.problems import not_found
from lambent_server.bundles.rows import require_bundle, show
from lambent_server.database.model import BundleFileRow
from lambent_server.database.rows import many, one
from lambent_server.database.schema import bundle_files
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.http.blob_responses import RESPONSES, Asked, AskedOf, MatchHeader, send_blob
from lambent_server.http.common import Id, ServicesOf, Sha, TenantOf, problems
from lambent_server.services import Services
from lambent_server.storage.store import Blob, damaged, find_blob

router = APIRouter(tags=["files"])


def _send_from_bundle(services: Services, request: Request, blob: Blob, asked: Asked) -> Response:
    response = send_blob(services, blob, asked)
    if getattr(request.state, "by_share", False) and response.status_code != 307:
        # A link may be revoked: browsers must request its files again each time, which is then refused.
        response.headers["cache-control"] = "private, no-cache"
    return response


def _bundle_file(
    services: Services, tenant: Tenant, bundle_id: str, path: str, media_type: str | None = None
) -> Blob:
    with services.database.read() as connection:
        require_bundle(connection, tenant, bundle_id)
        statement = rows(tenant, bundle_files).where(
            bundle_files.c.bundle_id == bundle_id, bundle_files.c.path == path
        )
        row = one(connection, statement, BundleFileRow)
    if row is None:
        raise not_found("file", path)
    gzip_bytes = int(row.gzip_bytes or 0)
    return Blob(row.sha256, int(row.size_bytes), media_type or row.media_type, gzip_bytes)


@router.get("/v1/bundles/{bundle_id:id}/manifest", response_class=Response, responses=RESPONSES)
def get_manifest(
    services: ServicesOf, tenant: TenantOf, bundle_id: Id, request: Request, asked: AskedOf
) -> Response:
    """Return manifest.json of a bundle."""
    blob = _bundle_file(services, tenant, bundle_id, "manifest.json", "application/json")
    return _send_from_bundle(services, request, blob, asked)


@router.get("/v1/bundles/{bundle_id:id}/files/{path:path}", response_class=Response, responses=RESPONSES)
def get_bundle_file(
    services: ServicesOf,
    tenant: TenantOf,
    bundle_id: Id,
    path: Annotated[str, Path(min_length=1, max_length=240)],
    request: Request,
    asked: AskedOf,
) -> Response:
    """Return a file of a bundle, or a range of it."""
    return _send_from_bundle(services, request, _bundle_file(services, tenant, bundle_id, path), asked)


_ARCHIVE: dict[int | str, dict[str, Any]] = {
    **problems(404, 410),
    200: {
        "description": "The archive.",
        "content": {"application/zip": {"schema": {"type": "string", "format": "binary"}}},
    },
    304: {"description": "The client's copy is current."},
}


@router.get("/v1/bundles/{bundle_id:id}/archive", response_class=Response, responses=_ARCHIVE)
def get_bundle_archive(
    services: ServicesOf, tenant: TenantOf, bundle_id: Id, if_none_match: MatchHeader = None
) -> Response:
    """Return all files of a bundle as one zip archive, which every client opens as it is."""
    with services.database.read() as connection:
        row = require_bundle(connection, tenant, bundle_id)
        name = show(connection, tenant, row).scene_name or bundle_id
        statement = rows(tenant, bundle_files).where(bundle_files.c.bundle_id == bundle_id)
        files = many(connection, statement.order_by(bundle_files.c.path), BundleFileRow)
    archive = ZipStream(sized=True)
    for file in files:
        archive.add(_read_in_turn(services, file), file.path, size=int(file.size_bytes))
    etag = f'"{hashlib.sha256("".join(f.path + f.sha256 for f in files).encode()).hexdigest()}"'
    headers = {
        # Weak: entries carry the time at which they are sent.
        "etag": f"W/{etag}",
        "cache-control": "private, max-age=31536000, immutable",
        "content-disposition": f"attachment; filename*=UTF-8''{_named(name)}",
        "content-length": str(len(archive)),
    }
    if is_named(etag, if_none_match):
        del headers["content-length"]
        return Response(status_code=304, headers=headers)
    # Before the response begins: a missing file is a problem then, and a broken download later.
    lost = services.store.damaged({file.sha256: int(file.size_bytes) for file in files})
    if lost:
        raise damaged(lost[0])
    return StreamingResponse(archive, headers=headers, media_type="application/zip")


def _read_in_turn(services: Services, file: BundleFileRow) -> Iterator[bytes]:
    """Yield a file in pieces; it is opened when the archive comes to it."""
    yield from services.store.read(file.sha256, int(file.size_bytes))


def _named(name: str) -> str:
    """Return the file name of an archive, percent-encoded; without what file systems give a meaning."""
    return quote(re.sub(r'[\x00-\x1f\x7f/\\:*?"<>|]+', "_", name).strip(". ") or "bundle") + ".relight.zip"


@router.get("/v1/blobs/{sha256}", response_class=Response, responses=RESPONSES)
def get_blob(services: ServicesOf, tenant: TenantOf, sha256: Sha, asked: AskedOf) -> Response:
    """Return an artifact, a preview or an environment by its hash."""
    with services.database.read() as connection:
        blob = find_blob(connection, tenant, sha256)
    if blob is None:
        raise not_found("blob", sha256)
    return send_blob(services, blob, asked)
