"""Secrets in files: never empty, never half written."""

import os
from pathlib import Path

import pytest
from lambent_server.core.secrets import (
    is_run_token,
    read_or_create,
    run_token,
    write_secret,
)
from lambent_server.core.settings import ServeError


@pytest.mark.parametrize("content", [b"", b" \n", b"\xff\xfe"])
def test_a_file_without_a_secret_is_refused_with_what_to_do(tmp_path: Path, content: bytes):
    (tmp_path / "api.key").write_bytes(content)
    with pytest.raises(ServeError, match=r"^serve\.secret_invalid: .*api\.key .*remove it and start again"):
        read_or_create(tmp_path / "api.key")


def test_a_secret_is_made_once_and_readable_by_its_owner_only(tmp_path: Path):
    path = tmp_path / "api.key"
    first = read_or_create(path)
    assert len(first) > 40
    assert path.stat().st_mode & 0o777 == 0o600
    assert read_or_create(path) == first
    assert list(tmp_path.iterdir()) == [path]


def test_a_secret_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    seen: list[list[str]] = []
    monkeypatch.setattr(os, "fsync", lambda _: seen.append(sorted(path.name for path in tmp_path.iterdir())))
    write_secret(tmp_path / "api.key", "one")
    write_secret(tmp_path / "api.key", "two", replace=True)
    partial = f"api.key.{os.getpid()}.tmp"
    # The file before it is named, the folder after.
    assert seen == [[partial], ["api.key"], ["api.key", partial], ["api.key"]]
    assert (tmp_path / "api.key").read_text() == "two\n"
    assert (tmp_path / "api.key").stat().st_mode & 0o777 == 0o600


def test_the_token_of_one_run_cannot_be_rewritten_for_another():
    token = run_token("secret", "job_x", 1)
    assert is_run_token("secret", token)
    assert not is_run_token("secret", token.replace(".1.", ".2."))
    assert not is_run_token("other", token)
