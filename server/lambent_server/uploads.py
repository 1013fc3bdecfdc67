"""File uploads: hashed while they are written to the scratch folder, and deleted if anything fails."""

import errno
import hashlib
import os
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from fastapi import Request
from starlette.requests import ClientDisconnect

from lambent_server.metrics import UPLOAD_BYTES
from lambent_server.outside_text import refuse_form
from lambent_server.problems import Problem
from lambent_server.s3 import StoreUnavailableError
from lambent_server.services import Services


@dataclass(frozen=True, slots=True)
class Upload:
    """A complete body on disk."""

    path: Path
    sha256: str
    size_bytes: int


@asynccontextmanager
async def received(services: Services, request: Request, max_bytes: int) -> AsyncIterator[Upload]:
    """Yield the body as a file that exists inside the `with` block."""
    refuse_form(request.headers.get("content-type", ""))
    services.require_disk()
    descriptor, name = tempfile.mkstemp(dir=services.settings.scratch)
    path, digest, size = Path(name), hashlib.sha256(), 0
    try:
        with os.fdopen(descriptor, "wb") as file:
            try:
                async for chunk in request.stream():
                    size += len(chunk)
                    if size > max_bytes:
                        detail = f"this file may have {max_bytes} bytes"
                        raise Problem(413, "body_too_large", detail, headers={"connection": "close"})
                    digest.update(chunk)
                    file.write(chunk)
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
