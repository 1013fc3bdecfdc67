"""Bundles, artifacts and previews."""

import hashlib
import re
from collections.abc import AsyncIterator, Iterator
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import StreamingResponse
from starlette.concurrency import iterate_in_threadpool

from lambent_server.api.outside_text import sendable_media_type
from lambent_server.api.problems import Problem, not_found
from lambent_server.bundles.rows import require_bundle, show
from lambent_server.database.schema import bundle_files
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.http.blob_responses import RESPONSES, Asked, AskedOf, MatchHeader, matches, send_blob
from lambent_server.http.common import Id, ServicesOf, Sha, TenantOf, problems
from lambent_server.services import Services
from lambent_server.storage import zip_stream
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
        row = connection.execute(statement).mappings().one_or_none()
    if row is None:
        raise not_found("file", path)
    gzip_bytes = int(row["gzip_bytes"] or 0)
    media_type = media_type or sendable_media_type(row["media_type"])
    return Blob(row["sha256"], int(row["size_bytes"]), media_type, gzip_bytes)


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
    **problems(404, 410, 413),
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
        files = connection.execute(statement.order_by(bundle_files.c.path)).mappings().all()
    entries = [_entry(services, file) for file in files]
    if not zip_stream.fits(entries):
        raise Problem(
            413,
            "archive_too_large",
            "the bundle is above 4 GiB, the most that such an archive can hold; use `lambent fetch`",
        )
    etag = f'"{hashlib.sha256("".join(f["path"] + f["sha256"] for f in files).encode()).hexdigest()}"'
    headers = {
        "etag": etag,
        "cache-control": "private, max-age=31536000, immutable",
        "content-disposition": f"attachment; filename*=UTF-8''{_named(name)}",
        "content-length": str(zip_stream.length_of(entries)),
    }
    if matches(etag, if_none_match):
        del headers["content-length"]
        return Response(status_code=304, headers=headers)
    # Before the response begins: a missing file is a problem then, and a broken download later.
    lost = services.store.damaged({file["sha256"]: int(file["size_bytes"]) for file in files})
    if lost:
        raise damaged(lost[0])
    pieces = zip_stream.zip_pieces(entries, row["created_at"])
    return StreamingResponse(_sent(pieces), headers=headers, media_type="application/zip")


async def _sent(pieces: Iterator[bytes]) -> AsyncIterator[bytes]:
    """Yield pieces that are not empty; between any two steps the client may have gone."""
    async for piece in iterate_in_threadpool(pieces):
        if piece:
            yield piece


def _entry(services: Services, file: Any) -> zip_stream.Entry:
    size = int(file["size_bytes"])
    return zip_stream.Entry(file["path"], size, lambda: services.store.read(file["sha256"], size))


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
