"""Bytes named by their SHA-256, in a local folder or any store that obstore knows."""

import hashlib
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import obstore
from obstore.exceptions import NotFoundError
from obstore.store import LocalStore, from_url
from sqlalchemy import Connection

from lambent_server.clock import now
from lambent_server.database import schema
from lambent_server.database.tenancy import Tenant, add, change, rows

CHUNK_BYTES = 1024 * 1024


@dataclass(frozen=True, slots=True)
class Blob:
    """What is known of the bytes a tenant may read."""

    sha256: str
    size_bytes: int
    media_type: str


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file, lower-case hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class BlobStore:
    """Puts and reads blobs. Which tenant may see which is a row in the database, not a matter of the store."""

    def __init__(self, folder: Path, url: str | None = None) -> None:
        if url is None:
            folder.mkdir(parents=True, exist_ok=True)
        self._store: Any = LocalStore(folder) if url is None else from_url(url)
        # Held while a blob appears or is swept away, so that neither sees half of the other.
        self.lock = threading.Lock()

    @staticmethod
    def _key(sha256: str) -> str:
        return f"blobs/{sha256[:2]}/{sha256}"

    def put_file(
        self, write: Callable[[], Any], tenant: Tenant, path: Path, sha256: str, media_type: str
    ) -> bool:
        """Store the file and make it visible to `tenant`; return whether it is new to the tenant.

        `write` opens a database transaction. The bytes are complete in the store before the row names them.
        """
        with self.lock:
            with write() as connection:
                if touch(connection, tenant, sha256):
                    return False
            if not self._exists(sha256):
                obstore.put(self._store, self._key(sha256), path)
            with write() as connection:
                connection.execute(
                    add(
                        tenant,
                        schema.blobs,
                        sha256=sha256,
                        size_bytes=float(path.stat().st_size),
                        media_type=media_type,
                        touched_at=now(),
                    )
                )
            return True

    def _exists(self, sha256: str) -> bool:
        try:
            obstore.head(self._store, self._key(sha256))
        except (NotFoundError, FileNotFoundError):
            return False
        return True

    def read(self, sha256: str, start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """Yield the bytes from `start` up to (not including) `end`."""
        if end is not None and end <= start:
            return
        options: Any = {"range": (start, end)} if end is not None else {"range": {"offset": start}}
        if start == 0 and end is None:
            options = None
        for chunk in obstore.get(self._store, self._key(sha256), options=options).stream(CHUNK_BYTES):
            yield bytes(chunk)

    def read_all(self, sha256: str) -> bytes:
        """Return the whole blob."""
        return b"".join(self.read(sha256))

    def delete(self, sha256: str) -> None:
        """Remove the bytes; the caller holds `lock` and has removed every row."""
        try:
            obstore.delete(self._store, self._key(sha256))
        except (NotFoundError, FileNotFoundError):
            return


def touch(connection: Connection, tenant: Tenant, sha256: str) -> bool:
    """Return whether the tenant has the blob, and keep it from being swept away for a while."""
    statement = change(tenant, schema.blobs).where(schema.blobs.c.sha256 == sha256).values(touched_at=now())
    return connection.execute(statement).rowcount > 0


def find_blob(connection: Connection, tenant: Tenant, sha256: str) -> Blob | None:
    """Return what is known of a blob, or None where the tenant has none of this name."""
    row = (
        connection.execute(rows(tenant, schema.blobs).where(schema.blobs.c.sha256 == sha256))
        .mappings()
        .one_or_none()
    )
    return Blob(sha256, int(row["size_bytes"]), row["media_type"]) if row else None
