"""Bundles, artifacts and previews: immutable bytes, so their hash is their ETag."""

import hashlib
import re
from collections.abc import AsyncIterator, Iterator
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import APIRouter, Header, Path, Request, Response
from fastapi.responses import StreamingResponse
from starlette.concurrency import iterate_in_threadpool

from lambent_server import zip_stream
from lambent_server.bundle_rows import require_bundle, show
from lambent_server.database.schema import bundle_files
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.problems import Problem, not_found
from lambent_server.routes.common import Id, ServicesOf, Sha, TenantOf, problems
from lambent_server.services import Services
from lambent_server.store import Blob, damaged, find_blob

router = APIRouter(tags=["files"])

RangeHeader = Annotated[str | None, Header(alias="Range", max_length=200)]
MatchHeader = Annotated[str | None, Header(alias="If-None-Match", max_length=2000)]
IfRangeHeader = Annotated[str | None, Header(alias="If-Range", max_length=200)]

_BINARY: dict[str, Any] = {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
_RESPONSES: dict[int | str, dict[str, Any]] = {
    **problems(404, 410, 416, 422),
    200: {"description": "The whole file.", "content": _BINARY},
    206: {"description": "The requested range.", "content": _BINARY},
    304: {"description": "The client's copy is current."},
}
_RANGE = re.compile(r"bytes=(\d*)-(\d*)")


def parse_range(header: str, size: int) -> tuple[int, int] | None:
    """Return (first byte, one past the last), or None if the header is to be ignored (RFC 9110, 14.2).

    Raises `range_not_satisfiable` for a range outside the file.
    """
    match = _RANGE.fullmatch(header.strip())
    if match is None or match.groups() == ("", ""):
        return None
    first, last = match.groups()
    if first and last and int(last) < int(first):
        return None
    if not first:
        start, end = max(size - int(last), 0), size
        satisfiable = int(last) > 0 and size > 0
    else:
        start, end = int(first), min(int(last) + 1, size) if last else size
        satisfiable = start < size
    if not satisfiable:
        raise Problem(
            416,
            "range_not_satisfiable",
            f"the file has {size} bytes",
            headers={"content-range": f"bytes */{size}"},
        )
    return start, end


def send_blob(
    services: Services, blob: Blob, range_: str | None, if_none_match: str | None, if_range: str | None
) -> Response:
    """Return the response with a blob, or with the requested range of it."""
    etag = f'"{blob.sha256}"'
    headers = {
        "etag": etag,
        "accept-ranges": "bytes",
        "cache-control": "private, max-age=31536000, immutable",
        # Files of scenes and runs are data, never pages of this site.
        "content-security-policy": "default-src 'none'; sandbox",
    }
    if _matches(etag, if_none_match):
        return Response(status_code=304, headers=headers)
    part = parse_range(range_, blob.size_bytes) if range_ and if_range in (None, etag) else None
    start, end = part or (0, blob.size_bytes)
    headers["content-length"] = str(end - start)
    if part is not None:
        headers["content-range"] = f"bytes {start}-{end - 1}/{blob.size_bytes}"
    content = services.store.read(blob.sha256, blob.size_bytes, *(part or ()))
    return StreamingResponse(
        content, status_code=206 if part else 200, headers=headers, media_type=blob.media_type
    )


def _matches(etag: str, if_none_match: str | None) -> bool:
    tags = {tag.strip().removeprefix("W/") for tag in (if_none_match or "").split(",")}
    return etag in tags or "*" in tags


def _send_from_bundle(
    services: Services,
    request: Request,
    blob: Blob,
    range_: str | None,
    match: str | None,
    if_range: str | None,
) -> Response:
    response = send_blob(services, blob, range_, match, if_range)
    if getattr(request.state, "by_share", False):
        # A link may be revoked: browsers must request its files again each time, which is then refused.
        response.headers["cache-control"] = "private, no-cache"
    return response


def _bundle_file(services: Services, tenant: Tenant, bundle_id: str, path: str) -> Blob:
    with services.database.read() as connection:
        require_bundle(connection, tenant, bundle_id)
        statement = rows(tenant, bundle_files).where(
            bundle_files.c.bundle_id == bundle_id, bundle_files.c.path == path
        )
        row = connection.execute(statement).mappings().one_or_none()
    if row is None:
        raise not_found("file", path)
    return Blob(row["sha256"], int(row["size_bytes"]), row["media_type"])


@router.get("/v1/bundles/{bundle_id:id}/manifest", response_class=Response, responses=_RESPONSES)
def get_manifest(
    services: ServicesOf,
    tenant: TenantOf,
    bundle_id: Id,
    request: Request,
    if_none_match: MatchHeader = None,
) -> Response:
    """Return manifest.json of a bundle."""
    blob = _bundle_file(services, tenant, bundle_id, "manifest.json")
    blob = Blob(blob.sha256, blob.size_bytes, "application/json")
    return _send_from_bundle(services, request, blob, None, if_none_match, None)


@router.get("/v1/bundles/{bundle_id:id}/files/{path:path}", response_class=Response, responses=_RESPONSES)
def get_bundle_file(
    services: ServicesOf,
    tenant: TenantOf,
    bundle_id: Id,
    path: Annotated[str, Path(min_length=1, max_length=240)],
    request: Request,
    range_: RangeHeader = None,
    if_none_match: MatchHeader = None,
    if_range: IfRangeHeader = None,
) -> Response:
    """Return a file of a bundle, or a range of it."""
    blob = _bundle_file(services, tenant, bundle_id, path)
    return _send_from_bundle(services, request, blob, range_, if_none_match, if_range)


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
    if _matches(etag, if_none_match):
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


@router.get("/v1/blobs/{sha256}", response_class=Response, responses=_RESPONSES)
def get_blob(
    services: ServicesOf,
    tenant: TenantOf,
    sha256: Sha,
    range_: RangeHeader = None,
    if_none_match: MatchHeader = None,
    if_range: IfRangeHeader = None,
) -> Response:
    """Return an artifact, a preview or an environment by its hash."""
    with services.database.read() as connection:
        blob = find_blob(connection, tenant, sha256)
    if blob is None:
        raise not_found("blob", sha256)
    return send_blob(services, blob, range_, if_none_match, if_range)
