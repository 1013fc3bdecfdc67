"""Contents of a store, compared with the hashes that they are named by.

A disk may return other bytes than it was given without saying so. So nothing is read from a store unless this
very version of it was compared since the server started, less than a day ago. Damaged bytes are moved to the
folder `damaged`: from then on they are missing, and are sent again as missing bytes are.
"""

import contextlib
import hashlib
import threading
import time
import zlib
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any

import obstore
import structlog
from obstore.exceptions import BaseError, NotFoundError
from sqlalchemy import Connection
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.cluster import claims
from lambent_server.core.metrics import BLOBS_DAMAGED, CHECKED_BYTES
from lambent_server.storage.outages import report
from lambent_server.storage.s3 import StoreUnavailableError, Version

log = structlog.get_logger()

BLOBS = "blobs"
GZIP = "gzip"
"""Folders of the store: blobs, and compressed copies of some of them under the blob's name."""
DAMAGED = "damaged"
"""Folder of bytes that do not match their name, for operators to look at; the server never reads it."""
FRESH_S = 86400.0
"""Age up to which a check counts."""
MOST_REMEMBERED = 200_000
CHUNK_BYTES = 1024 * 1024
_LOCKS = 64
_GZIP_WINDOW = 31

Write = Callable[[], AbstractContextManager[Connection]]
"""Opens a transaction."""
Pace = Callable[[int], None]
"""Is called with the number of bytes that were just read, and may wait."""


class ContentChecks:
    """Which contents are known to be right, and since when. Safe to use from several threads."""

    def __init__(self, store: Any, key: Callable[[str, str], str]) -> None:
        self._store = store
        self._key = key
        self.write: Write | None = None
        """Opens the transactions in which damaged bytes are set aside; without it they are only refused."""
        self.damaged: set[str] = set()
        """Hashes of blobs that this process has found damaged, and that were not sent again."""
        self._known: OrderedDict[tuple[str, str], tuple[Version, float]] = OrderedDict()
        self._lock = threading.Lock()
        self._reading = tuple(threading.Lock() for _ in range(_LOCKS))

    def version(self, sha256: str, folder: str = BLOBS) -> Version | None:
        """Return what the store has under a hash now, or None."""
        try:
            with as_os_error():
                return Version.of(obstore.head(self._store, self._key(sha256, folder)))
        except FileNotFoundError:
            return None

    def check(self, sha256: str, size_bytes: int, folder: str = BLOBS) -> Version | None:
        """Return the version whose content matches the hash; None if the bytes are missing or others.

        Reads all of them unless that was done lately; bytes that do not match are set aside.
        """
        version = self.version(sha256, folder)
        if version is None or version.size_bytes != size_bytes:
            return None
        if not self._is_known(sha256, folder, version):
            # Once, however many readers wait for it.
            with self._reading[hash((sha256, folder)) % _LOCKS]:
                if not self._is_known(sha256, folder, version):
                    return self._compare(sha256, folder, version, None)
        return version

    def scrub(self, sha256: str, size_bytes: int, folder: str, pace: Pace) -> bool:
        """Return whether the content matches, as `check` finds out, but slowly and without others waiting."""
        version = self.version(sha256, folder)
        if version is None or version.size_bytes != size_bytes:
            return False
        if self._is_known(sha256, folder, version):
            return True
        return self._compare(sha256, folder, version, pace) is not None

    def matches(self, sha256: str, folder: str = BLOBS, pace: Pace | None = None) -> bool:
        """Return whether the content matches; reads all of it, and changes nothing."""
        return self._digest(sha256, folder, pace) == sha256

    def set_aside(self, sha256: str) -> None:
        """Move the bytes of a hash out of the way if they do not match it, so that they can be sent again."""
        version = self.version(sha256)
        if version is not None:
            self._compare(sha256, BLOBS, version, None)

    def changed(self, sha256: str) -> None:
        """Note that the server has just written the bytes of a hash."""
        self.damaged.discard(sha256)

    def _is_known(self, sha256: str, folder: str, version: Version) -> bool:
        with self._lock:
            before, at = self._known.get((folder, sha256), (None, 0.0))
            return before == version and time.monotonic() - at < FRESH_S

    def _compare(self, sha256: str, folder: str, version: Version, pace: Pace | None) -> Version | None:
        # Twice, because an error on the way from the disk is none of the bytes there.
        if not any(self._digest(sha256, folder, pace) == sha256 for _ in range(2)):
            self._set_aside(sha256, folder, version)
            return None
        with self._lock:
            self._known[folder, sha256] = version, time.monotonic()
            self._known.move_to_end((folder, sha256))
            if len(self._known) > MOST_REMEMBERED:
                self._known.popitem(last=False)
        self.damaged.discard(sha256)
        return version

    def _digest(self, sha256: str, folder: str, pace: Pace | None) -> str | None:
        """Return the hash of the content; of a compressed copy that of what it unpacks to."""
        digest = hashlib.sha256()
        unpacker = zlib.decompressobj(_GZIP_WINDOW) if folder == GZIP else None
        try:
            with as_os_error():
                result = obstore.get(self._store, self._key(sha256, folder))
            for piece in pieces(result):
                CHECKED_BYTES.inc(len(piece))
                if unpacker is None:
                    digest.update(piece)
                else:
                    _unpack(unpacker, piece, digest)
                if pace is not None:
                    pace(len(piece))
        except (FileNotFoundError, zlib.error):
            return None
        if unpacker is not None and not unpacker.eof:
            return None
        return digest.hexdigest()

    def _set_aside(self, sha256: str, folder: str, version: Version) -> None:
        """Move bytes that do not match out of the way, unless others have taken their place."""
        BLOBS_DAMAGED.inc()
        log.error("blob_damaged", sha256=sha256, folder=folder, size_bytes=version.size_bytes)
        if folder == BLOBS:
            self.damaged.add(sha256)
        if self.write is None:
            return
        key = self._key(sha256, folder)
        try:
            if folder == BLOBS:
                with as_os_error():
                    obstore.copy(self._store, key, self._key(sha256, DAMAGED))
            with self.write() as connection:
                # Whoever is writing these bytes right now writes them again.
                claims.interrupt(connection, sha256)
                if self.version(sha256, folder) == version:
                    with as_os_error():
                        obstore.delete(self._store, key)
        except FileNotFoundError:
            return
        except (SQLAlchemyError, OSError) as error:
            # They are refused as long as they are there.
            report("damaged_blob_not_set_aside", error)


def _unpack(unpacker: Any, piece: bytes, digest: Any) -> None:
    """Add what a piece of a compressed copy unpacks to, a part at a time."""
    while piece:
        digest.update(unpacker.decompress(piece, CHUNK_BYTES))
        piece = unpacker.unconsumed_tail
    if unpacker.eof and unpacker.unused_data:
        raise zlib.error("bytes behind the end")


@contextlib.contextmanager
def as_os_error() -> Iterator[None]:
    """Convert a store's exceptions into OSError, which the rest of the server handles."""
    try:
        yield
    except NotFoundError as error:
        raise FileNotFoundError(str(error)) from error
    except BaseError as error:
        # Whatever it is, another attempt may succeed: the rights were checked at the start.
        raise StoreUnavailableError(str(error).splitlines()[0]) from error


def pieces(result: Any) -> Iterator[bytes]:
    """Yield the bytes of an answer of the store."""
    with as_os_error():
        for chunk in result.stream(CHUNK_BYTES):
            yield bytes(chunk)
