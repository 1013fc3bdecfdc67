"""Blobs named by their SHA-256, in a local folder or any store that obstore supports."""

import contextlib
import hashlib
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
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
from lambent_server.problems import Problem

CHUNK_BYTES = 1024 * 1024


@dataclass(frozen=True, slots=True)
class Blob:
    """Metadata of bytes that a tenant may read."""

    sha256: str
    size_bytes: int
    media_type: str


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file, lower-case hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class BlobStore:
    """Writes and reads blobs; rows, not the store, decide which tenant may read which."""

    def __init__(self, folder: Path, url: str | None = None) -> None:
        if url is None:
            (folder / "blobs").mkdir(parents=True, exist_ok=True)
            _sync(folder)
        self._store: Any = LocalStore(folder) if url is None else from_url(url)
        # Folder of a local store; other stores ensure the durability of their bytes themselves.
        self._folder = Path(self._store.prefix or "/") if isinstance(self._store, LocalStore) else None
        # Held while a blob is added or swept, so that neither sees the other half done.
        self.lock = threading.Lock()

    @staticmethod
    def _key(sha256: str) -> str:
        return f"blobs/{sha256[:2]}/{sha256}"

    def listed(self, digits: str) -> dict[str, tuple[int, float]]:
        """Return size and modification time (Unix seconds) of blobs whose hashes begin with `digits`."""
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

        `write` opens a database transaction. The bytes are complete and on the disk before the row refers to
        them; existing bytes that differ from the file are rewritten.
        """
        with self.lock:
            with write() as connection:
                known = touch(connection, tenant, sha256) is not None
            if not self._has(sha256, path.stat().st_size):
                self._put(sha256, path)
            if known:
                return False
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

    def _has(self, sha256: str, size_bytes: int) -> bool:
        if self.size(sha256) != size_bytes:
            return False
        digest = hashlib.sha256()
        for piece in self.read(sha256, size_bytes):
            digest.update(piece)
        return digest.hexdigest() == sha256

    def _put(self, sha256: str, path: Path) -> None:
        with _as_os_error():
            obstore.put(self._store, self._key(sha256), path)
        if self._folder is not None:
            file = self._folder / self._key(sha256)
            # The bytes, their directory entry, and that of a folder that may be new.
            for each in (file, file.parent, file.parent.parent):
                _sync(each)

    def size(self, sha256: str) -> int | None:
        """Return the size of the blob in the store, or None if it does not exist."""
        try:
            with _as_os_error():
                return int(obstore.head(self._store, self._key(sha256))["size"])
        except FileNotFoundError:
            return None

    def damaged(self, expected: Mapping[str, int]) -> list[str]:
        """Return the expected hashes whose blobs are missing or have another size."""
        with ThreadPoolExecutor(16) as pool:
            sizes = pool.map(self.size, expected)
            return [sha256 for sha256, size in zip(expected, sizes, strict=True) if size != expected[sha256]]

    def read(self, sha256: str, size_bytes: int, start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """Return the bytes from `start` up to (not including) `end`, in pieces.

        Raises `blob_damaged` if the store does not have all `size_bytes` of them, and OSError if it is
        unavailable, both before the response to a client begins.
        """
        if self.size(sha256) != size_bytes:
            raise damaged(sha256)
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
        """Return the whole blob; raises `blob_damaged` if its bytes do not match its hash."""
        data = b"".join(self.read(sha256, self.size(sha256) or 0))
        if hashlib.sha256(data).hexdigest() != sha256:
            raise damaged(sha256)
        return data

    def delete(self, sha256: str) -> None:
        """Delete the bytes; the caller holds `lock` and has deleted every row."""
        with contextlib.suppress(FileNotFoundError), _as_os_error():
            obstore.delete(self._store, self._key(sha256))


def damaged(sha256: str) -> Problem:
    """Return the problem for a request for bytes that were lost."""
    return Problem(
        410,
        "blob_damaged",
        f"the bytes of blob {sha256} are missing from the server's store or incomplete; send the file "
        "again, or rerun the job that produced it",
        headers={"cache-control": "no-store"},
    )


def _sync(path: Path) -> None:
    """Flush a file or folder to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def _as_os_error() -> Iterator[None]:
    """Convert a store's exceptions into OSError, which the rest of the server handles."""
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


def touch(connection: Connection, tenant: Tenant, sha256: str) -> int | None:
    """Return the size of the tenant's blob, None if there is none; keeps the sweeper off it for a while."""
    statement = change(tenant, schema.blobs).where(schema.blobs.c.sha256 == sha256).values(touched_at=now())
    size = connection.execute(statement.returning(schema.blobs.c.size_bytes)).scalar_one_or_none()
    return None if size is None else int(size)


def blob_url(sha256: str | None) -> str | None:
    """Return the address of a blob; None without a hash."""
    return f"/v1/blobs/{sha256}" if sha256 else None


def find_blob(connection: Connection, tenant: Tenant, sha256: str) -> Blob | None:
    """Return a blob's metadata, or None if the tenant has no blob of this hash."""
    row = (
        connection.execute(rows(tenant, schema.blobs).where(schema.blobs.c.sha256 == sha256))
        .mappings()
        .one_or_none()
    )
    return Blob(sha256, int(row["size_bytes"]), row["media_type"]) if row else None
