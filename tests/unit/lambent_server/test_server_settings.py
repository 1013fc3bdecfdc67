"""Settings of a server: what they refuse, and what they make of relative paths."""

from pathlib import Path
from typing import get_args

import pytest
from lambent_server.core.settings import Settings
from pydantic import ValidationError


def _is_path(annotation):
    """Return whether values of this type are paths."""
    return annotation is Path or any(map(_is_path, get_args(annotation)))


PATHS = sorted(
    name
    for name, field in Settings.model_fields.items()
    # The folder on the nodes of a cluster is relative to where Ray starts actors there.
    if _is_path(field.annotation) and name != "ray_folder"
)


@pytest.mark.parametrize("name", PATHS)
def test_a_relative_path_is_made_absolute_where_it_is_given(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "given").write_text("a secret")
    settings = Settings(**{"data": tmp_path, name: "given"})
    monkeypatch.chdir("/")
    assert getattr(settings, name) == tmp_path / "given"


def test_a_relative_path_in_the_environment_is_made_absolute_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LAMBENT_DATA", "served")
    assert Settings().runs == tmp_path / "served" / "runs"
    assert Settings().database_url == f"sqlite:///{tmp_path / 'served' / 'lambent.sqlite'}"


URL = "postgresql://lambent@db:5432/lambent"


def test_the_password_is_that_in_the_file_for_both_addresses(tmp_path: Path):
    file = tmp_path / "password"
    file.write_text("p@ss/w:rd\n")
    settings = Settings(database=URL, database_direct=f"{URL}2", database_password_file=file)
    assert settings.database_url == "postgresql+psycopg://lambent:p%40ss%2Fw%3Ard@db:5432/lambent"
    assert settings.listening_url == "postgresql+psycopg://lambent:p%40ss%2Fw%3Ard@db:5432/lambent2"


def test_a_file_without_which_there_is_no_password_is_missed_at_once(tmp_path: Path):
    with pytest.raises(ValidationError, match="not a file that this user can read"):
        Settings(database=URL, database_password_file=tmp_path / "password")


def test_without_a_file_the_address_is_as_given():
    url = "postgresql://lambent:word@db/lambent"
    assert Settings(database=url).database_url == url.replace("postgresql:", "postgresql+psycopg:")


def test_hosts_are_given_with_commas(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("LAMBENT_ALLOWED_HOSTS", "render.example, 10.0.0.7")
    assert Settings().allowed_hosts == ("render.example", "10.0.0.7")
