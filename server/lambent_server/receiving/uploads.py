"""File uploads: hashed while they are written to the scratch folder, and deleted if anything fails.

Room is looked for when a body is announced, and again before each piece of it is written: on the disk, and in
the quota of its organisation. An archive is looked at in the same way while it is unpacked.
"""

import errno
import hashlib
import os
import tempfile
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager, asynccontextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from fastapi import Request
from sqlalchemy import Connection
from starlette.requests import ClientDisconnect

from lambent_server.accounts import quotas
from lambent_server.api.outside_text import announced_bytes, refuse_form
from lambent_server.api.problems import Problem
from lambent_server.core.metrics import UPLOAD_BYTES
from lambent_server.database.schema import blobs
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.services import Services
from lambent_server.storage.archives import write_all
from lambent_server.storage.disk_space import Allowance, Body
from lambent_server.storage.s3 import StoreUnavailableError

_HASHES_AT_ONCE = 500


@dataclass(frozen=True, slots=True)
class Upload:
    """A complete body on disk."""

    path: Path
    sha256: str
    size_bytes: int


def allowance_of(
    connection: Connection, services: Services, tenant: Tenant, sha256: str | None = None
) -> Allowance | None:
    """Return how many bytes of bodies an organisation may have under way; None: as many as it likes.

    For a file, whose hash is given, it is what is left of the quota; for an archive, some of whose files may
    be stored already, it is the whole quota.
    """
    limit = quotas.quotas_of(connection, tenant, services.settings).bytes
    if limit is None:
        return None
    used = 0.0 if sha256 is None else quotas.used_bytes(connection, tenant, but=(sha256,))
    return Allowance(bytes=limit - used, refuse=lambda held: quotas.bytes_used_up(limit, used, held))


@asynccontextmanager
async def received(
    services: Services,
    request: Request,
    tenant: Tenant,
    max_bytes: int,
    allowance: Allowance | None = None,
) -> AsyncIterator[Upload]:
    """Yield the body as a file that exists inside the `with` block."""
    refuse_form(request.headers.get("content-type", ""))
    services.require_disk()
    descriptor, name = tempfile.mkstemp(dir=services.settings.scratch)
    path, digest, size = Path(name), hashlib.sha256(), 0
    try:
        with services.space.body(tenant.id, allowance=allowance) as body:
            with os.fdopen(descriptor, "wb", buffering=0) as file:
                _expect(body, request)
                try:
                    async for chunk in request.stream():
                        size += len(chunk)
                        if size > max_bytes:
                            detail = f"this file may have {max_bytes} bytes"
                            raise Problem(413, "body_too_large", detail, headers={"connection": "close"})
                        digest.update(chunk)
                        with body.writing(len(chunk)):
                            write_all(file.fileno(), chunk)
                except ClientDisconnect as error:
                    raise Problem(
                        400, "body_incomplete", "the connection closed before the end of the body"
                    ) from error
            UPLOAD_BYTES.inc(size)
            yield Upload(path, digest.hexdigest(), size)
    except StoreUnavailableError:
        raise
    except OSError as error:
        if error.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
            # A disk that became read-only, for example.
            raise StoreUnavailableError(str(error.strerror)) from error
        raise Problem(507, "disk_full", "the file could not be written", retryable=True) from error
    finally:
        path.unlink(missing_ok=True)


def storing(services: Services, path: Path, floor_part: float = 1.0) -> AbstractContextManager[None]:
    """Return the context in which a file is copied to the store: on this disk it is there twice meanwhile."""
    if services.settings.store is not None:
        return nullcontext()
    return services.space.taking(path.stat().st_size, floor_part)


def _expect(body: Body, request: Request) -> None:
    """Refuse a body before its first byte if there is no room for as much as is announced."""
    body.expect(announced_bytes(request.headers))


class ArchiveRoom:
    """Looks for room while an archive is unpacked: before each entry, and before each piece of it.

    Files that the organisation has stored already take no room of its quota.
    """

    def __init__(self, services: Services, tenant: Tenant, body: Body) -> None:
        self._services = services
        self._tenant = tenant
        self._body = body
        with services.database.read() as connection:
            self._limit = quotas.quotas_of(connection, tenant, services.settings).bytes
            self._used = quotas.used_bytes(connection, tenant)
        self._new = 0
        self._looked_up: set[str] = set()
        self._unknown: dict[str, int] = {}
        self._unknown_bytes = 0
        self._stored_sizes: set[float] | None = None

    def entry(self, size: int) -> None:
        """Refuse an entry of so many bytes, before any of them is read, for which the quota has no room."""
        if self._limit is None or self._fits(size):
            return
        self._look_up()
        if not self._fits(size) and not self._may_be_stored(size):
            raise self._refusal(size)

    def writing(self, size: int) -> AbstractContextManager[None]:
        """Return the context in which so many bytes are written."""
        return self._body.writing(size)

    def kept(self, sha256: str, size: int) -> None:
        """Count a file that was unpacked; refuse it if it is a new one that does not fit."""
        if self._limit is None or sha256 in self._unknown or sha256 in self._looked_up:
            return
        self._unknown[sha256] = size
        self._unknown_bytes += size
        if not self._fits(0):
            self._look_up()
            if not self._fits(0):
                raise self._refusal(0)

    def _fits(self, more: int) -> bool:
        assert self._limit is not None
        return self._used + self._new + self._unknown_bytes + more <= self._limit

    def _refusal(self, more: int) -> Problem:
        assert self._limit is not None
        return quotas.bytes_used_up(self._limit, self._used, self._new + self._unknown_bytes + more)

    def _look_up(self) -> None:
        """Find out which of the files are new to the organisation."""
        hashes, known = list(self._unknown), set[str]()
        stored = rows(self._tenant, blobs, blobs.c.sha256)
        with self._services.database.read() as connection:
            for start in range(0, len(hashes), _HASHES_AT_ONCE):
                some = blobs.c.sha256.in_(hashes[start : start + _HASHES_AT_ONCE])
                known |= set(connection.execute(stored.where(some)).scalars())
        new = {sha256: size for sha256, size in self._unknown.items() if sha256 not in known}
        self._new += sum(new.values())
        self._looked_up |= set(hashes)
        self._unknown, self._unknown_bytes = {}, 0

    def _may_be_stored(self, size: int) -> bool:
        """Return whether a stored file has this size: the entry may be that one, as its hash will tell."""
        if self._stored_sizes is None:
            sizes = rows(self._tenant, blobs, blobs.c.size_bytes).distinct()
            with self._services.database.read() as connection:
                self._stored_sizes = set(connection.execute(sizes).scalars())
        return size in self._stored_sizes
