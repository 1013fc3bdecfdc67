"""Bytes named by their SHA-256, in a local folder or any store that obstore knows."""

import contextlib
import hashlib
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import obstore
from obstore.exceptions import BaseError, NotFoundError
from obstore.store import LocalStore, from_url
from sqlalchemy import Connection

from lambent_server.clock import now
from lambent_server.database import schema
from lambent_server.database.tenancy import Tenant, add_if_absent, change, rows

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
    """Puts and reads blobs; which tenant may see which is a matter of rows, not of the store."""

    def __init__(self, folder: Path, url: str | None = None) -> None:
        if url is None:
            folder.mkdir(parents=True, exist_ok=True)
        self._store: Any = LocalStore(folder) if url is None else from_url(url)
        # Held while a blob appears or is swept away, so that neither sees half of the other.
        self.lock = threading.Lock()

    @staticmethod
    def _key(sha256: str) -> str:
        return f"blobs/{sha256[:2]}/{sha256}"

    def listed(self, digits: str) -> dict[str, tuple[int, float]]:
        """Return size and time of change (Unix seconds) of the blobs whose hashes begin with two digits."""
        found: dict[str, tuple[int, float]] = {}
        with _as_os_error():
            for batch in obstore.list(self._store, f"blobs/{digits}"):
                for each in batch:
                    name = each["path"].rpartition("/")[2]
                    found[name] = (each["size"], each["last_modified"].timestamp())
        return found

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
                with _as_os_error():
                    obstore.put(self._store, self._key(sha256), path)
            with write() as connection:
                add_if_absent(
                    connection,
                    tenant,
                    schema.blobs,
                    sha256=sha256,
                    size_bytes=float(path.stat().st_size),
                    media_type=media_type,
                    touched_at=now(),
                )
            return True

    def _exists(self, sha256: str) -> bool:
        try:
            with _as_os_error():
                obstore.head(self._store, self._key(sha256))
        except FileNotFoundError:
            return False
        return True

    def read(self, sha256: str, start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """Return the bytes from `start` up to (not including) `end`, in pieces.

        Raises OSError at once where the store does not have them, before anything is promised to a client.
        """
        if end is not None and end <= start:
            return iter(())
        whole = start == 0 and end is None
        options: Any = (
            None if whole else {"range": (start, end)} if end is not None else {"range": {"offset": start}}
        )
        with _as_os_error():
            result = obstore.get(self._store, self._key(sha256), options=options)
        return _pieces(result)

    def read_all(self, sha256: str) -> bytes:
        """Return the whole blob."""
        return b"".join(self.read(sha256))

    def delete(self, sha256: str) -> None:
        """Remove the bytes; the caller holds `lock` and has removed every row."""
        with contextlib.suppress(FileNotFoundError), _as_os_error():
            obstore.delete(self._store, self._key(sha256))


@contextlib.contextmanager
def _as_os_error() -> Iterator[None]:
    """Turn whatever a store raises into what the rest of the server handles."""
    try:
        yield
    except NotFoundError as error:
        raise FileNotFoundError(str(error)) from error
    except BaseError as error:
        raise OSError(str(error)) from error


def _pieces(result: Any) -> Iterator[bytes]:
    with _as_os_error():
        for chunk in result.stream(CHUNK_BYTES):
            yield bytes(chunk)


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
