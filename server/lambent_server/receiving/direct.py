"""Uploads that go directly to a bucket: a client gets addresses, sends the bytes there, and reports back.

Bytes first go to a name of the tenant's own (`uploads/<tenant>/<hash>`), because knowing a hash must not be
enough to read what another tenant has stored under it. Only when they are complete and match the hash are
they copied to the blob's name, inside the bucket. The bucket itself verifies files that are sent whole, if
it can; others are read once to compare their hash. The bucket knows which parts it has; the database only
knows what room was kept for them (`reservations`).
"""

import hashlib
from collections.abc import Mapping
from urllib.parse import quote

from sqlalchemy import Connection

from lambent_server.api.problems import Problem
from lambent_server.core.clock import now, rfc3339
from lambent_server.core.settings import Settings
from lambent_server.database.tenancy import Tenant
from lambent_server.storage.content_checks import Write
from lambent_server.storage.messages import FileUpload, UploadPart
from lambent_server.storage.s3 import MAX_COPY_BYTES, S3Bucket, Version
from lambent_server.storage.store import Admission, Blob, BlobStore, find_blob

FOLDER = "uploads"
MAX_PARTS = 10_000
# Added to the name of bytes whose hash the bucket has not verified.
_UNVERIFIED = ".unverified"


class DirectUploads:
    """Offers addresses for uploads of one server's tenants, and takes over what was sent there."""

    def __init__(self, store: BlobStore, bucket: S3Bucket, settings: Settings) -> None:
        self._store = store
        self._bucket = bucket
        self._settings = settings

    def offers(self, tenant: Tenant, wanted: Mapping[str, int]) -> list[FileUpload]:
        """Return an offer for each hash with its size in bytes; none for files that are too large."""
        fitting = {sha256: size for sha256, size in wanted.items() if size <= MAX_COPY_BYTES}
        if not fitting:
            return []
        sent = {key: size for key, size, _ in self._bucket.listed(f"{folder_of(tenant)}/")}
        return [self._offer(tenant, sha256, size, sent) for sha256, size in fitting.items()]

    def _is_verified(self, size_bytes: int) -> bool:
        """Return whether the bucket verifies the hash of a file of this size."""
        return self._bucket.verifies and size_bytes <= self._settings.store_whole_bytes

    def _key(self, tenant: Tenant, sha256: str, size_bytes: int) -> str:
        return f"{folder_of(tenant)}/{sha256}{'' if self._is_verified(size_bytes) else _UNVERIFIED}"

    def _offer(self, tenant: Tenant, sha256: str, size_bytes: int, sent: Mapping[str, int]) -> FileUpload:
        key, valid_s = self._key(tenant, sha256, size_bytes), self._settings.store_url_s
        parts: list[UploadPart] = []
        expires_at = rfc3339(now() + valid_s)
        if sent.get(key) != size_bytes:
            if size_bytes <= self._settings.store_whole_bytes:
                url, headers = self._bucket.sign_put(key, sha256, size_bytes, valid_s)
                parts = [UploadPart(number=0, offset=0, size_bytes=size_bytes, url=url, headers=headers)]
            else:
                parts = self._missing_parts(key, size_bytes)
        return FileUpload(sha256=sha256, size_bytes=size_bytes, parts=parts, expires_at=expires_at)

    def _missing_parts(self, key: str, size_bytes: int) -> list[UploadPart]:
        planned = self._planned(size_bytes)
        upload_id, parts = self._begun(key, planned)
        missing = {number: span for number, span in planned.items() if number not in parts}
        return [
            UploadPart(
                number=number,
                offset=offset,
                size_bytes=size,
                url=self._bucket.sign_part(key, upload_id, number, size, self._settings.store_url_s),
                headers={},
            )
            for number, (offset, size) in missing.items()
        ]

    def _planned(self, size_bytes: int) -> dict[int, tuple[int, int]]:
        """Return offset and size of each part of a file."""
        part_bytes = max(self._settings.store_part_bytes, -(-size_bytes // MAX_PARTS))
        offsets = range(0, size_bytes, part_bytes)
        return {
            number: (offset, min(part_bytes, size_bytes - offset)) for number, offset in enumerate(offsets, 1)
        }

    def _begun(self, key: str, planned: Mapping[int, tuple[int, int]]) -> tuple[str, dict[int, Version]]:
        """Return the upload in parts that is in progress and its parts, or a new one."""
        for upload_id in self._open(key):
            parts = self._bucket.parts(key, upload_id)
            if all(number in planned and planned[number][1] == p.size_bytes for number, p in parts.items()):
                return upload_id, parts
            # Begun with another size of parts.
            self._bucket.abort(key, upload_id)
        return self._bucket.begin(key), {}

    def _open(self, key: str) -> list[str]:
        """Return the open uploads of a key, the oldest first, so that all servers choose the same."""
        uploads = [(at, upload_id) for name, upload_id, at in self._bucket.uploads(key) if name == key]
        return [upload_id for _, upload_id in sorted(uploads)]

    def accept(self, write: Write, tenant: Tenant, blob: Blob, admission: Admission | None = None) -> bool:
        """Take over a file that was sent; return whether it is new to the tenant.

        Raises `upload_missing` if it was not sent, or not all of it, and `digest_mismatch` if it does not
        match its hash; then it is deleted. Repeating it changes nothing. `admission` is that of the store's
        `add`.
        """
        key = self._key(tenant, blob.sha256, blob.size_bytes)
        version = self._sent(key, blob.size_bytes)
        if version is None:
            with write() as connection:
                known = _is_known(connection, tenant, blob)
            if known and self._store.holds(blob.sha256, blob.size_bytes):
                return False
            raise _upload_missing(blob)
        self._verify(key, version, blob)

        def copy() -> None:
            try:
                self._bucket.copy(key, version, self._store.key(blob.sha256))
                self._store.checks.changed(blob.sha256)
            except FileNotFoundError as error:
                # Another request has taken it over at the same time, or it was sent again.
                if not self._store.holds(blob.sha256, blob.size_bytes):
                    raise _upload_missing(blob) from error

        try:
            created = self._store.add(write, tenant, blob, copy, admission)
        except Problem as problem:
            if problem.code == "quota_bytes":
                # It must not stay until something else was deleted.
                self._bucket.delete(key)
            raise
        self._bucket.delete(key)
        return created

    def discard(self, tenant: Tenant, sha256: str) -> None:
        """Delete what was sent of a file, whole or in parts, and not taken over."""
        name = f"{folder_of(tenant)}/{sha256}"
        for key, upload_id, _ in list(self._bucket.uploads(name)):
            self._bucket.abort(key, upload_id)
        for key in (name, name + _UNVERIFIED):
            self._bucket.delete(key)

    def _sent(self, key: str, size_bytes: int) -> Version | None:
        """Return what was sent, if it is complete; the parts of an upload are put together."""
        version = self._bucket.head(key)
        if version is not None or size_bytes <= self._settings.store_whole_bytes:
            return version
        planned = self._planned(size_bytes)
        for upload_id in self._open(key):
            parts = self._bucket.parts(key, upload_id)
            if {number: part.size_bytes for number, part in parts.items()} == {
                number: size for number, (_, size) in planned.items()
            }:
                self._bucket.complete(key, upload_id, parts)
                return self._bucket.head(key)
        return None

    def _verify(self, key: str, version: Version, blob: Blob) -> None:
        matches = version.size_bytes == blob.size_bytes
        if matches and not self._is_verified(blob.size_bytes):
            digest = hashlib.sha256()
            for piece in self._bucket.read(key, version):
                digest.update(piece)
            matches = digest.hexdigest() == blob.sha256
        if not matches:
            self._bucket.delete(key)
            raise Problem(422, "digest_mismatch", f"what was sent as {blob.sha256} has another hash or size")


def direct_uploads(store: BlobStore, settings: Settings) -> DirectUploads | None:
    """Return what offers addresses of the store, or None if all bytes go through the server."""
    if store.bucket is None or not settings.store_direct:
        return None
    return DirectUploads(store, store.bucket, settings)


def folder_of(tenant: Tenant) -> str:
    """Return where in the bucket a tenant's files are until they are taken over."""
    return f"{FOLDER}/{quote(tenant.id, safe='')}"


def _is_known(connection: Connection, tenant: Tenant, blob: Blob) -> bool:
    known = find_blob(connection, tenant, blob.sha256)
    return known is not None and known.size_bytes == blob.size_bytes


def _upload_missing(blob: Blob) -> Problem:
    return Problem(
        409,
        "upload_missing",
        f"{blob.sha256} was not sent completely; request addresses again and send what is missing",
        retryable=True,
    )
