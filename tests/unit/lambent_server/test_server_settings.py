"""Settings of a server: what they refuse, and what they make of relative paths."""

from pathlib import Path
from typing import get_args

import pytest
from lambent_server.core.settings import Settings


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
