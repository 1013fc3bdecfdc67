"""The password of the database, from a file."""

from pathlib import Path

import pytest
from lambent_server.core.settings import Settings
from pydantic import ValidationError

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
