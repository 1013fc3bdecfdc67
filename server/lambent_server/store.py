"""Bytes named by their SHA-256, in a local folder or any store that obstore knows."""

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
            (folder / "blobs").mkdir(parents=True, exist_ok=True)
            _sync(folder)
        self._store: Any = LocalStore(folder) if url is None else from_url(url)
        # Where the files of a local store are; other stores see to the safety of their bytes themselves.
        self._folder = Path(self._store.prefix or "/") if isinstance(self._store, LocalStore) else None
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

        `write` opens a database transaction. The bytes are complete and on the disk before the row names
        them; bytes that are there and are not those of the file are written anew.
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
            # The bytes, their name, and the name of a folder that may be new.
            for each in (file, file.parent, file.parent.parent):
                _sync(each)

    def size(self, sha256: str) -> int | None:
        """Return how many bytes the store has under this hash, None where there are none."""
        try:
            with _as_os_error():
                return int(obstore.head(self._store, self._key(sha256))["size"])
        except FileNotFoundError:
            return None

    def damaged(self, expected: Mapping[str, int]) -> list[str]:
        """Return which blobs, of hashes with their sizes, the store does not have in that size."""
        with ThreadPoolExecutor(16) as pool:
            sizes = pool.map(self.size, expected)
            return [sha256 for sha256, size in zip(expected, sizes, strict=True) if size != expected[sha256]]

    def read(self, sha256: str, size_bytes: int, start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """Return the bytes from `start` up to (not including) `end`, in pieces.

        Raises `blob_damaged` at once where the store has not all `size_bytes` of them, OSError where it is
        away, before anything is promised to a client.
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
        """Return the whole blob; raises `blob_damaged` where its bytes are not those of its hash."""
        data = b"".join(self.read(sha256, self.size(sha256) or 0))
        if hashlib.sha256(data).hexdigest() != sha256:
            raise damaged(sha256)
        return data

    def delete(self, sha256: str) -> None:
        """Remove the bytes; the caller holds `lock` and has removed every row."""
        with contextlib.suppress(FileNotFoundError), _as_os_error():
            obstore.delete(self._store, self._key(sha256))


def damaged(sha256: str) -> Problem:
    """Return the answer to a request for bytes that were lost."""
    return Problem(
        410,
        "blob_damaged",
        f"the bytes of blob {sha256} are gone from the server's store, or not whole; send the file again, or "
        "run the job again that made it",
        headers={"cache-control": "no-store"},
    )


def _sync(path: Path) -> None:
    """Wait until what was written to a file or folder is on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


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


def touch(connection: Connection, tenant: Tenant, sha256: str) -> int | None:
    """Return the size of the tenant's blob, None where it has none; it is not swept away for a while."""
    statement = change(tenant, schema.blobs).where(schema.blobs.c.sha256 == sha256).values(touched_at=now())
    size = connection.execute(statement.returning(schema.blobs.c.size_bytes)).scalar_one_or_none()
    return None if size is None else int(size)


def find_blob(connection: Connection, tenant: Tenant, sha256: str) -> Blob | None:
    """Return what is known of a blob, or None where the tenant has none of this name."""
    row = (
        connection.execute(rows(tenant, schema.blobs).where(schema.blobs.c.sha256 == sha256))
        .mappings()
        .one_or_none()
    )
    return Blob(sha256, int(row["size_bytes"]), row["media_type"]) if row else None
