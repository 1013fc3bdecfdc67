"""Bytes are safe before a row names them."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.cluster import claims
from lambent_server.storage.store import Blob
from support.api import TENANT, opened, sha256


def test_bytes_and_their_names_are_on_the_disk_before_a_row_names_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    source = tmp_path / "x"
    source.write_bytes(b"bytes")
    done: list[str] = []
    real = os.fsync

    def fsync(descriptor: int) -> None:
        done.append(Path(f"/proc/self/fd/{descriptor}").readlink().name)
        real(descriptor)

    with opened(tmp_path / "data") as api:

        @contextlib.contextmanager
        def write() -> Iterator[object]:
            with api.services.database.write() as connection:
                yield connection
            done.append("row")

        monkeypatch.setattr(os, "fsync", fsync)
        digest = sha256(b"bytes")
        assert api.services.store.put_file(write, TENANT, source, digest, "text/plain")
    # The first row is the question whether the tenant has it.
    assert done[:5] == ["row", digest, digest[:2], "blobs", "row"]


def test_bytes_that_are_deleted_while_they_are_sent_are_sent_again(tmp_path: Path):
    source = tmp_path / "x"
    source.write_bytes(b"bytes")
    digest, sent = sha256(b"bytes"), []
    with opened(tmp_path / "data") as api:
        store, write = api.services.store, api.services.database.write

        def write_bytes() -> None:
            store._put(digest, source)
            sent.append(digest)
            if len(sent) == 1:
                with write() as connection:
                    token = claims.announce_deletion(connection, digest)
                assert token is not None
                assert store.delete(write, digest, token)

        assert store.add(write, TENANT, Blob(digest, 5, "text/plain"), write_bytes)
        assert len(sent) == 2
        assert store.read_all(digest) == b"bytes"


def test_a_deletion_that_was_announced_spares_bytes_that_are_sent_again(tmp_path: Path):
    source = tmp_path / "x"
    source.write_bytes(b"bytes")
    digest = sha256(b"bytes")
    with opened(tmp_path / "data") as api:
        store, write = api.services.store, api.services.database.write
        with write() as connection:
            assert claims.lock(connection, digest) < 1.0
            token = claims.announce_deletion(connection, digest)
        assert token is not None
        assert store.put_file(write, TENANT, source, digest, "text/plain")
        assert not store.delete(write, digest, token)
        assert store.read_all(digest) == b"bytes"
