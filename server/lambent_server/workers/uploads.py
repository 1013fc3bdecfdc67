"""Files of run processes: what they send to this server, and what they exchange with the store."""

import hashlib
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lambent_proto.v1 import worker_pb2

from lambent_server.accounts import quotas
from lambent_server.api.problems import Problem, invalid
from lambent_server.cluster import claims
from lambent_server.database.tenancy import Tenant
from lambent_server.receiving.direct import direct_uploads
from lambent_server.receiving.uploads import storing
from lambent_server.services import Services
from lambent_server.storage import reservations
from lambent_server.storage.archives import write_all
from lambent_server.storage.disk_space import RUNS_PART
from lambent_server.storage.store import Blob, damaged, touch


class BrokenUploadError(Exception):
    """What was sent does not match its hash."""


def receive(
    services: Services, tenant: Tenant, header: worker_pb2.BlobHeader, messages: Iterator[Any]
) -> bool:
    """Store a file that a run sends, and return whether it is new to the tenant.

    Raises BrokenUploadError if it does not match its hash, and `disk_floor` where uploads of people have long
    been refused: runs may use half of what those leave free.
    """
    settings = services.settings
    announced = _checked(header)
    most = min(announced, settings.run_file_bytes or announced)
    digest, size = hashlib.sha256(), 0
    with (
        tempfile.NamedTemporaryFile(dir=settings.scratch, buffering=0) as file,
        services.space.body(tenant.id, floor_part=RUNS_PART) as body,
    ):
        body.expect(most)
        for message in messages:
            size += len(message.data)
            if size > most:
                detail = f"{announced} bytes were announced and {most} are allowed, but more came"
                raise Problem(413, "body_too_large", detail)
            digest.update(message.data)
            with body.writing(len(message.data)):
                write_all(file.fileno(), message.data)
        if digest.hexdigest() != header.sha256:
            raise BrokenUploadError("the bytes do not match the announced hash")
        path, media_type = Path(file.name), header.media_type or "application/octet-stream"
        with storing(services, path, RUNS_PART):
            return services.store.put_file(services.database.write, tenant, path, header.sha256, media_type)


def _checked(
    request: worker_pb2.PlanUploadRequest | worker_pb2.CompleteUploadRequest | worker_pb2.BlobHeader,
) -> int:
    """Return the size of the file, having checked it and the hash."""
    if not re.fullmatch("[0-9a-f]{64}", request.sha256):
        raise invalid("invalid_request", "#/sha256", "this is not a SHA-256")
    if not 0 <= request.size_bytes < 2**53:
        raise invalid("invalid_request", "#/size_bytes", "this is not the size of a file")
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
    wanted = {request.sha256: size_bytes}
    with services.database.write() as connection:
        # What runs store is counted and not refused.
        quotas.reserve_bytes(connection, tenant, services.settings, wanted, refuse=False)
    offers = direct.offers(tenant, wanted)
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
        with services.database.write() as connection:
            reservations.use(connection, tenant, request.sha256, services.settings)
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
