"""Responses with blobs: immutable bytes, so their hash is their ETag.

A blob may have a compressed copy, which is another representation with an ETag of its own. Ranges are of the
uncompressed bytes.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import structlog
from fastapi import Depends, Header, Request, Response
from fastapi.responses import StreamingResponse
from lambent_pages import accepted_encodings, is_named

from lambent_server.api.problems import Problem
from lambent_server.http.common import problems
from lambent_server.http.heads import HEAD
from lambent_server.services import Services
from lambent_server.storage.content_checks import BLOBS, GZIP
from lambent_server.storage.store import Blob, damaged

log = structlog.get_logger()

MatchHeader = Annotated[str | None, Header(alias="If-None-Match", max_length=2000)]

_BINARY: dict[str, Any] = {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
_TEXT = {"schema": {"type": "string"}}
_ENCODED: dict[str, Any] = {
    "Content-Encoding": {"description": "gzip, or absent if the bytes are the file's own.", **_TEXT},
    "ETag": {"description": "The SHA-256 of the file, with -gzip behind it if it is compressed.", **_TEXT},
    "Vary": {"description": "accept-encoding", **_TEXT},
}
RESPONSES: dict[int | str, dict[str, Any]] = {
    **problems(404, 410, 416, 422),
    200: {
        "description": "The whole file; compressed if there is a compressed copy and the client accepts it.",
        "content": _BINARY,
        "headers": _ENCODED,
    },
    206: {"description": "The requested range, which is never compressed.", "content": _BINARY},
    304: {"description": "The client's copy is current."},
    307: {"description": "The file is at this address of the store, for a while."},
}
_RANGE = re.compile(r"bytes=(\d*)-(\d*)")


@dataclass(frozen=True, slots=True)
class Asked:
    """What a request says about the bytes it wants."""

    head: bool = False
    range: str | None = None
    if_range: str | None = None
    if_none_match: str | None = None
    accept_encoding: str | None = None
    redirect: bool = False
    """Whether the client wants the address of the store, if it has one."""


def _asked(
    request: Request,
    range_: Annotated[str | None, Header(alias="Range", max_length=200)] = None,
    if_none_match: MatchHeader = None,
    if_range: Annotated[str | None, Header(alias="If-Range", max_length=200)] = None,
    accept_encoding: Annotated[str | None, Header(alias="Accept-Encoding", max_length=2000)] = None,
    redirect: Annotated[str | None, Header(alias="X-Lambent-Redirect", max_length=10)] = None,
) -> Asked:
    head = getattr(request.state, HEAD, False)
    return Asked(head, range_, if_range, if_none_match, accept_encoding, redirect == "1")


AskedOf = Annotated[Asked, Depends(_asked)]


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


def send_blob(services: Services, blob: Blob, asked: Asked) -> Response:
    """Return the response with a blob, with its compressed copy, or with the requested range of it."""
    own, packed = f'"{blob.sha256}"', f'"{blob.sha256}-gzip"'
    takes_packed = blob.gzip_bytes > 0 and "gzip" in accepted_encodings(asked.accept_encoding)
    headers = {
        "accept-ranges": "bytes",
        "vary": "accept-encoding",
        "cache-control": "private, max-age=31536000, immutable",
        # Files of scenes and runs are data, never pages of this site.
        "content-security-policy": "default-src 'none'; sandbox",
    }
    # A client that has read the file before there was a compressed copy need not read it again.
    for etag in (packed, own) if takes_packed else (own,):
        if is_named(etag, asked.if_none_match):
            return Response(status_code=304, headers={"etag": etag, **headers})
    if (asked.redirect or services.settings.store_redirect == "always") and services.settings.store_direct:
        address = services.store.address(blob, services.settings.store_url_s)
        if address is not None:
            # What the store sends itself nobody compares on the way.
            if not services.store.holds(blob.sha256, blob.size_bytes):
                raise damaged(blob.sha256)
            headers |= {"etag": own, "location": address, "cache-control": "no-store"}
            return Response(status_code=307, headers=headers)
    part = _part(blob, asked, own)
    if takes_packed and part is None:
        try:
            content = _read(services, blob, asked, None, GZIP)
        except Problem:
            # Until the reconciler has noticed it, and another one is made.
            log.warning("copy_damaged", sha256=blob.sha256)
        else:
            length = str(blob.gzip_bytes)
            headers |= {"etag": packed, "content-encoding": "gzip", "content-length": length}
            return _response(content, 200, headers, blob)
    start, end = part or (0, blob.size_bytes)
    headers |= {"etag": own, "content-length": str(end - start)}
    if part is not None:
        headers["content-range"] = f"bytes {start}-{end - 1}/{blob.size_bytes}"
    content = _read(services, blob, asked, part, BLOBS)
    return _response(content, 200 if part is None else 206, headers, blob)


def _part(blob: Blob, asked: Asked, own: str) -> tuple[int, int] | None:
    """Return the range that is asked for, if one is; only a GET can ask for any (RFC 9110, 14.2)."""
    if asked.range is None or asked.head or asked.if_range not in (None, own):
        return None
    return parse_range(asked.range, blob.size_bytes)


def _read(
    services: Services, blob: Blob, asked: Asked, part: tuple[int, int] | None, folder: str
) -> Iterator[bytes] | None:
    """Return the bytes of a blob or of its copy, None for a HEAD; raises `blob_damaged` if they are lost."""
    size_bytes = blob.gzip_bytes if folder == GZIP else blob.size_bytes
    if not asked.head:
        return services.store.read(blob.sha256, size_bytes, *(part or ()), folder=folder)
    if not services.store.holds(blob.sha256, size_bytes, folder):
        raise damaged(blob.sha256)
    return None


def _response(content: Iterator[bytes] | None, status: int, headers: dict[str, str], blob: Blob) -> Response:
    if content is None:
        return Response(status_code=status, headers=headers, media_type=blob.media_type)
    return StreamingResponse(content, status_code=status, headers=headers, media_type=blob.media_type)
