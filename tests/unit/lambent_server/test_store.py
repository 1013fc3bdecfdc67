"""Bytes are safe before a row names them."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
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
