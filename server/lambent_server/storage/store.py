"""Blobs named by their SHA-256, in a local folder or any store that obstore supports."""

import contextlib
import errno
import hashlib
import os
import secrets
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import obstore
from obstore.exceptions import BaseError, PermissionDeniedError
from obstore.store import LocalStore, from_url
from sqlalchemy import Connection

from lambent_server.api.problems import Problem
from lambent_server.cluster import claims
from lambent_server.core.clock import now
from lambent_server.database import schema
from lambent_server.database.tenancy import Tenant, add_if_absent, change, rows
from lambent_server.storage.content_checks import (
    BLOBS,
    DAMAGED,
    GZIP,
    ContentChecks,
    Write,
    as_os_error,
    pieces,
)
from lambent_server.storage.s3 import S3Bucket, S3Options, Version

_TOUCHED_AT_ONCE = 500
READ_TIMEOUT_S = 120.0
"""Longest time that a request to a store may take."""
COMPARED_S = 20.0
"""How long the contents of many files are compared before a client gets its answer."""


class Admission(Protocol):
    """Decides whether a tenant may store a blob; raises the problem if not, and then nothing stays."""

    def expected(self, connection: Connection, sha256: str, size_bytes: float) -> None:
        """Check before bytes that are new to the tenant are written."""

    def added(self, connection: Connection, sha256: str) -> None:
        """Check in the transaction that has added the blob."""


PROBES = "uploads/probe"
PROBE_BYTES = 4096
LOST = -1
"""In place of a copy's size where the blob's bytes are gone; the reconciler forgets it once they are back."""


@dataclass(frozen=True, slots=True)
class Blob:
    """Metadata of bytes that a tenant may read."""

    sha256: str
    size_bytes: int
    media_type: str
    gzip_bytes: int = 0
    """Size of its compressed copy; 0 if it has none."""


class BlobStore:
    """Writes and reads blobs; rows, not the store, decide which tenant may read which."""

    def __init__(self, folder: Path, url: str | None = None, s3: S3Options | None = None) -> None:
        self.bucket = None if s3 is None else S3Bucket(s3)
        if self.bucket is not None:
            self.bucket.check()
            self._store: Any = self.bucket.obstore(timeout_s=READ_TIMEOUT_S, num_retries=3)
        elif url is not None:
            self._store = from_url(url)
        else:
            for name in (BLOBS, GZIP):
                (folder / name).mkdir(parents=True, exist_ok=True)
            _sync(folder)
            self._store = LocalStore(folder)
        self.checks = ContentChecks(self._store, self.key)
        # A transaction waits for deletions, so these must not take long.
        self._deleter = (
            self._store if self.bucket is None else self.bucket.obstore(timeout_s=5, num_retries=0)
        )
        # Folder of a local store; other stores ensure the durability of their bytes themselves.
        self._folder = Path(self._store.prefix or "/") if isinstance(self._store, LocalStore) else None

    def file_time(self) -> float:
        """Return the time by which the store says when something was written (Unix seconds)."""
        return time.time() if self._folder is None else file_time(self._folder)

    def probe(self) -> str:
        """Return "ok" if the store takes a few bytes; "full", "read-only" or "unavailable" if it does not."""
        if self._folder is not None:
            return probe_folder(self._folder)
        name = f"{PROBES}/{secrets.token_hex(8)}"
        try:
            obstore.put(self._deleter, name, b"probe")
            obstore.delete(self._deleter, name)
        except PermissionDeniedError:
            return "read-only"
        except BaseError:
            return "unavailable"
        return "ok"

    @staticmethod
    def key(sha256: str, folder: str = BLOBS) -> str:
        """Return the name of a blob in the store, or of its copy."""
        return f"{folder}/{sha256[:2]}/{sha256}"

    def address(self, blob: Blob, valid_s: float) -> str | None:
        """Return an address at which the blob can be read for a while; None if the store has no addresses."""
        if self.bucket is None:
            return None
        return self.bucket.sign_get(self.key(blob.sha256), blob.media_type, valid_s)

    def listed(self, digits: str, folder: str = BLOBS) -> dict[str, tuple[int, float]]:
        """Return size and modification time (Unix seconds) of blobs whose hashes begin with `digits`."""
        sizes: dict[str, tuple[int, float]] = {}
        with as_os_error():
            for batch in obstore.list(self._store, f"{folder}/{digits}"):
                for each in batch:
                    name = each["path"].rpartition("/")[2]
                    sizes[name] = (each["size"], each["last_modified"].timestamp())
        return sizes

    def put_file(
        self,
        write: Write,
        tenant: Tenant,
        path: Path,
        sha256: str,
        media_type: str,
        admission: Admission | None = None,
    ) -> bool:
        """Store the file and make it visible to `tenant`; return whether it is new to the tenant.

        `write` opens a database transaction. The bytes are complete and on the disk before the row refers to
        them; existing bytes that differ from the file are rewritten.
        """
        size_bytes = path.stat().st_size

        def write_bytes() -> None:
            if not self._has(sha256, size_bytes):
                self._put(sha256, path)

        return self.add(write, tenant, Blob(sha256, size_bytes, media_type), write_bytes, admission)

    def add(
        self,
        write: Write,
        tenant: Tenant,
        blob: Blob,
        write_bytes: Callable[[], None],
        admission: Admission | None = None,
    ) -> bool:
        """Make a blob visible to `tenant`; return whether it is new to the tenant.

        `write_bytes` ensures that its bytes are whole in the store; it runs outside of transactions, and
        again if they were deleted meanwhile. Nothing stays of what `admission` refuses.
        """
        while True:
            with write() as connection:
                token = claims.claim(connection, tenant, blob.sha256)
                known = touch(connection, tenant, blob.sha256) is not None
                if admission is not None and not known:
                    admission.expected(connection, blob.sha256, float(blob.size_bytes))
            write_bytes()
            try:
                with write() as connection:
                    if not claims.still_held(connection, blob.sha256, token):
                        continue
                    if known and touch(connection, tenant, blob.sha256) is not None:
                        return False
                    values = {"size_bytes": float(blob.size_bytes), "media_type": blob.media_type}
                    values |= {"sha256": blob.sha256, "touched_at": now()}
                    added = add_if_absent(connection, tenant, schema.blobs, **values)
                    if admission is not None and added:
                        admission.added(connection, blob.sha256)
                    return added
            except Problem:
                self._withdraw(write, blob.sha256)
                raise

    def _withdraw(self, write: Write, sha256: str) -> None:
        """Delete bytes that were just written, unless some tenant has the blob."""
        with write() as connection:
            claims.lock(connection, sha256)
            token = claims.announce_deletion(connection, sha256)
        if token is not None:
            self.delete(write, sha256, token)

    def _has(self, sha256: str, size_bytes: int) -> bool:
        if self.bucket is not None:
            return self.holds(sha256, size_bytes)
        # Whoever sends a file again may know that its bytes have changed just now.
        return self.size(sha256) == size_bytes and self.checks.matches(sha256)

    def put_copy(self, sha256: str, path: Path) -> None:
        """Store a blob's compressed copy, which a row names afterwards."""
        self._put(sha256, path, GZIP)

    def _put(self, sha256: str, path: Path, folder: str = BLOBS) -> None:
        with as_os_error():
            obstore.put(self._store, self.key(sha256, folder), path)
        self.checks.changed(sha256)
        if self._folder is not None:
            file = self._folder / self.key(sha256, folder)
            # The bytes, their directory entry, and that of a folder that may be new.
            for each in (file, file.parent, file.parent.parent):
                _sync(each)

    def size(self, sha256: str, folder: str = BLOBS) -> int | None:
        """Return the size of the blob in the store, or of its copy, or None if it does not exist."""
        version = self.checks.version(sha256, folder)
        return None if version is None else version.size_bytes

    def holds(self, sha256: str, size_bytes: int, folder: str = BLOBS) -> bool:
        """Return whether the store has the bytes of a hash, or of its copy: all of them, and unchanged."""
        return self.checks.check(sha256, size_bytes, folder) is not None

    def damaged(self, expected: Mapping[str, int]) -> list[str]:
        """Return the expected hashes whose blobs are missing, have another size, or other bytes.

        After `COMPARED_S` seconds only sizes are looked at: reading looks at the bytes as well.
        """
        until = time.monotonic() + COMPARED_S

        def is_damaged(sha256: str) -> bool:
            if time.monotonic() > until:
                return self.size(sha256) != expected[sha256]
            return not self.holds(sha256, expected[sha256])

        with ThreadPoolExecutor(16) as pool:
            return [
                sha256 for sha256, lost in zip(expected, pool.map(is_damaged, expected), strict=True) if lost
            ]

    def read(
        self,
        sha256: str,
        size_bytes: int,
        start: int = 0,
        end: int | None = None,
        *,
        folder: str = BLOBS,
    ) -> Iterator[bytes]:
        """Return the bytes from `start` up to (not including) `end`, in pieces; in `GZIP` those of the copy.

        Raises `blob_damaged` if the store does not have all `size_bytes` of them or if they do not match the
        hash, and OSError if it is unavailable, both before the response to a client begins.
        """
        version = self.checks.check(sha256, size_bytes, folder)
        if version is None:
            raise damaged(sha256)
        if end is not None and end <= start:
            return iter(())
        part: Any = (start, end) if end is not None else {"offset": start}
        options: Any = {"range": part} if start or end is not None else None
        with as_os_error():
            result = obstore.get(self._store, self.key(sha256, folder), options=options)
        if Version.of(result.meta) != version:
            # Others have taken the place of the bytes that were looked at.
            return self.read(sha256, size_bytes, start, end, folder=folder)
        return pieces(result)

    def read_all(self, sha256: str) -> bytes:
        """Return the whole blob; raises `blob_damaged` if its bytes do not match its hash."""
        data = b"".join(self.read(sha256, self.size(sha256) or 0))
        if hashlib.sha256(data).hexdigest() != sha256:
            raise damaged(sha256)
        return data

    def delete(self, write: Write, sha256: str, token: str) -> bool:
        """Carry out an announced deletion; return False if the bytes are wanted again.

        The lock is held meanwhile, so that nobody writes bytes that this would then delete.
        """
        with write() as connection:
            if not claims.lock_deletion(connection, sha256, token):
                return False
            self.delete_bytes(sha256)
            claims.end_deletion(connection, sha256)
        return True

    def delete_bytes(self, sha256: str) -> None:
        """Delete the bytes, their copy and what was set aside of them, whoever may need them."""
        # The copy first: without the bytes, nothing would say that it exists.
        self.delete_copy(sha256)
        # A user's file, though with other bytes: it is deleted with the rest.
        self._delete(sha256, DAMAGED)
        self._delete(sha256, BLOBS)

    def delete_copy(self, sha256: str) -> None:
        """Delete a blob's compressed copy, if it has one."""
        self._delete(sha256, GZIP)

    def _delete(self, sha256: str, folder: str) -> None:
        with contextlib.suppress(FileNotFoundError), as_os_error():
            obstore.delete(self._deleter, self.key(sha256, folder))


def damaged(sha256: str) -> Problem:
    """Return the problem for a request for bytes that were lost."""
    return Problem(
        410,
        "blob_damaged",
        f"the bytes of blob {sha256} are missing from the server's store, incomplete or damaged; send the "
        "file again, or rerun the job that produced it",
        headers={"cache-control": "no-store"},
    )


def file_time(folder: Path) -> float:
    """Return the time that a file which is written into a folder now gets (Unix seconds)."""
    with tempfile.TemporaryFile(dir=folder) as file:
        file.write(b"0")
        file.flush()
        return os.fstat(file.fileno()).st_mtime


def probe_folder(folder: Path) -> str:
    """Return "ok" if a file can be written in a folder; "full", "read-only" or "unwritable" if it cannot."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(PROBE_BYTES))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return "full"
        return "read-only" if error.errno == errno.EROFS else "unwritable"
    return "ok"


def _sync(path: Path) -> None:
    """Flush a file or folder to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def touch(connection: Connection, tenant: Tenant, sha256: str) -> int | None:
    """Return the size of the tenant's blob, None if there is none; keeps the sweeper off it for a while.

    The row stays locked until the end of the transaction, so a reference that is added in it is seen by a
    sweep.
    """
    statement = change(tenant, schema.blobs).where(schema.blobs.c.sha256 == sha256).values(touched_at=now())
    size = connection.execute(statement.returning(schema.blobs.c.size_bytes)).scalar_one_or_none()
    return None if size is None else int(size)


def blob_url(sha256: str | None) -> str | None:
    """Return the address of a blob; None without a hash."""
    return f"/v1/blobs/{sha256}" if sha256 else None


def touch_all(connection: Connection, tenant: Tenant, hashes: Iterable[str]) -> dict[str, int]:
    """Return the sizes of those of the tenant's blobs that there are, as `touch` does for one of them."""
    sizes: dict[str, int] = {}
    # In one order, so that two transactions never wait for each other.
    wanted = sorted(set(hashes))
    for start in range(0, len(wanted), _TOUCHED_AT_ONCE):
        some = schema.blobs.c.sha256.in_(wanted[start : start + _TOUCHED_AT_ONCE])
        columns = (schema.blobs.c.sha256, schema.blobs.c.size_bytes)
        locked = rows(tenant, schema.blobs, *columns).where(some).order_by(schema.blobs.c.sha256)
        sizes |= {sha256: int(size) for sha256, size in connection.execute(locked.with_for_update())}
        connection.execute(change(tenant, schema.blobs).where(some).values(touched_at=now()))
    return sizes


def find_blob(connection: Connection, tenant: Tenant, sha256: str) -> Blob | None:
    """Return a blob's metadata, or None if the tenant has no blob of this hash."""
    row = (
        connection.execute(rows(tenant, schema.blobs).where(schema.blobs.c.sha256 == sha256))
        .mappings()
        .one_or_none()
    )
    return Blob(sha256, int(row["size_bytes"]), row["media_type"]) if row else None


def discard(connection: Connection, tenant: Tenant, sha256: str) -> None:
    """Record that a reference to a blob is gone; housekeeping removes the blob later if it was the last."""
    add_if_absent(connection, tenant, schema.garbage, sha256=sha256, at=now())
