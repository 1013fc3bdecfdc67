"""Files that run processes exchange with the store directly."""

import re

from lambent_proto.v1 import worker_pb2

from lambent_server import claims
from lambent_server.database.tenancy import Tenant
from lambent_server.direct import direct_uploads
from lambent_server.problems import Problem, invalid
from lambent_server.services import Services
from lambent_server.store import Blob, damaged, touch


class BrokenUploadError(Exception):
    """What was sent does not match its hash."""


def _checked(request: worker_pb2.PlanUploadRequest | worker_pb2.CompleteUploadRequest) -> int:
    """Return the size of the file, having checked it and the hash."""
    if not re.fullmatch("[0-9a-f]{64}", request.sha256):
        raise invalid("invalid_request", "#/sha256", "this is no SHA-256")
    if not 0 <= request.size_bytes < 2**53:
        raise invalid("invalid_request", "#/size_bytes", "this is no size of a file")
    return int(request.size_bytes)


def plan(
    services: Services, tenant: Tenant, request: worker_pb2.PlanUploadRequest
) -> worker_pb2.PlanUploadResponse:
    """Return where to send a file, or that there is nothing to send."""
    direct = direct_uploads(services.store, services.settings)
    if direct is None:
        return worker_pb2.PlanUploadResponse()
    size_bytes = _checked(request)
    with services.database.write() as connection:
        claims.claim(connection, tenant, request.sha256)
        known = touch(connection, tenant, request.sha256) == size_bytes
    if known and services.store.holds(request.sha256, size_bytes):
        return worker_pb2.PlanUploadResponse(stored=True, direct=True)
    offers = direct.offers(tenant, {request.sha256: size_bytes})
    return worker_pb2.PlanUploadResponse(
        direct=bool(offers),
        parts=[
            worker_pb2.UploadPart(
                offset=float(part.offset),
                size_bytes=float(part.size_bytes),
                url=part.url,
                headers=part.headers,
            )
            for offer in offers
            for part in offer.parts
        ],
    )


def complete(
    services: Services, tenant: Tenant, request: worker_pb2.CompleteUploadRequest
) -> worker_pb2.CompleteUploadResponse:
    """Take over a file that was sent; raises BrokenUploadError if it is another one."""
    direct = direct_uploads(services.store, services.settings)
    if direct is None:
        # The setting was changed meanwhile.
        return worker_pb2.CompleteUploadResponse(missing=True)
    media_type = request.media_type or "application/octet-stream"
    try:
        blob = Blob(request.sha256, _checked(request), media_type)
        direct.accept(services.database.write, tenant, blob)
    except Problem as problem:
        if problem.code == "upload_missing":
            return worker_pb2.CompleteUploadResponse(missing=True)
        if problem.code == "digest_mismatch":
            raise BrokenUploadError(problem.detail) from problem
        raise
    return worker_pb2.CompleteUploadResponse()


def locate(services: Services, blob: Blob) -> str:
    """Return where to read a blob; empty if only this server sends it."""
    if not services.settings.store_direct:
        return ""
    address = services.store.address(blob, services.settings.store_url_s)
    # Without an address it is found out when the bytes are read.
    if address is not None and not services.store.holds(blob.sha256, blob.size_bytes):
        raise damaged(blob.sha256)
    return address or ""
